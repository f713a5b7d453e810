"""`e3pose train`: teach the attention-LSTM predictor the motion of recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from e3pose.cli.options import Whole
from e3pose.errors import InputError


def train(
    recordings: list[Path],
    /,
    *,
    out: Path = Path("predictor"),
    validate: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None,
    hold_out: float = 0.2,
    history: Whole = 10,
    leads: Whole = 15,
    hidden: Whole = 96,
    steps: Whole = 12_000,
    minutes: float | None = None,
    batch: Whole = 128,
    seed: Whole = 0,
) -> None:
    """Train the attention-LSTM predictor on the true motion of recordings.

    Writes attention-lstm.onnx, model-card.md, log.csv and checkpoint.pt. A training that was killed
    goes on from its checkpoint when the same command is given again.

    Example: e3pose train recordings/a recordings/b --validate recordings/c --out predictor

    Parameters
    ----------
    recordings
        Recordings with truth to learn from.
    out
        The folder for the results.
    validate
        Recordings that are never learned from and tell when to stop; repeatable.
    hold_out
        Share of the end of every stretch of a minute or more that is for validation too.
    history
        M, how many slots the network looks back.
    leads
        How many slots ahead it is trained to look; it can look further, less well.
    hidden
        Width of the network.
    steps
        Batches to learn from at most.
    minutes
        Stop learning in this time.
    batch
        Windows a batch.
    seed
        Another seed gives other weights and windows.
    """
    import math

    _check(
        ("hold-out", hold_out, 0.0, 0.9),
        ("history", history, 4, 100),
        ("leads", leads, 1, 60),
        ("hidden", hidden, 8, 1024),
        ("steps", steps, 1, 10_000_000),
        ("minutes", math.inf if minutes is None else minutes, 0.01, math.inf),
        ("batch", batch, 2, 4096),
        ("seed", seed, 0, 2**31 - 1),
    )
    from rich.console import Console
    from rich.progress import Progress

    from e3pose.recording import load_recording
    from e3pose.train.attention_lstm import TrainSettings
    from e3pose.train.attention_lstm import train as run
    from e3pose.train.clips import gather
    from e3pose.train.network import NetworkSettings

    learned, held_out = gather(
        [load_recording(path) for path in recordings],
        [load_recording(path) for path in validate or []],
        hold_out,
        history + leads,
    )
    settings = TrainSettings(
        network=NetworkSettings(history_slots=history, hidden=hidden),
        num_leads=leads,
        steps=steps,
        minutes=math.inf if minutes is None else minutes,
        batch=batch,
        seed=seed,
    )
    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task("train", total=1.0)
        weights = run(
            learned,
            held_out,
            out,
            settings,
            lambda share, text: bar.update(task, completed=share, description=f"train, {text}"),
        )
    print(f"{weights}: trained; figures on held-out motion are in {out / 'model-card.md'}")


def _check(*numbers: tuple[str, float, float, float]) -> None:
    for name, value, low, high in numbers:
        if not low <= value <= high:
            raise InputError(f"--{name}: found {value:g}, expected {low:g} to {high:g}")
