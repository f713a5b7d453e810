"""`e3pose train`: train the attention-LSTM predictor on recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from e3pose.cli.options import Whole
from e3pose.errors import InputError

if TYPE_CHECKING:
    from rich.progress import Progress

    from e3pose.learn.train.attention_lstm import TrainSettings
    from e3pose.learn.train.lessons import LessonSettings
    from e3pose.learn.train.network import AttentionLstm
    from e3pose.learn.train.windows import Clip
    from e3pose.recording import Recording
    from e3pose.runtime.workers import Workers

SHIPPED_NAME = "shipped"


def train(
    recordings: Annotated[list[Path], Parameter(name="RECORDING", negative="")],
    /,
    *,
    out: Path = Path("predictor"),
    start: Path | None = None,
    validate: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None,
    hold_out: float = 0.2,
    target: Literal["auto", "truth", "estimates"] = "auto",
    include_scored: Annotated[bool, Parameter(negative="")] = False,
    combinations: Whole = 32,
    replays: Whole = 0,
    history: Whole = 10,
    leads: Whole = 15,
    hidden: Whole = 96,
    dropout: float | None = None,
    published: Annotated[bool, Parameter(negative="")] = False,
    steps: Whole = 12_000,
    minutes: float | None = None,
    batch: Whole = 128,
    seed: Whole = 0,
    jobs: Whole = 1,
    dask: str | None = None,
) -> None:
    """Train the attention-LSTM predictor on recordings.

    Example: `e3pose train recordings/a recordings/b --validate recordings/c --out predictor`

    Fine-tune the shipped weights: `e3pose train my-room --start shipped --minutes 10`

    The target motion is the truth of a recording or, without truth, the estimate from all cameras;
    the inputs are then estimates from combinations of cameras. The command writes
    attention-lstm.onnx, model-card.md, log.csv and checkpoint.pt. Run it again to resume.

    Parameters
    ----------
    recordings
        Training recordings, with truth or with detections of several cameras.
    out
        Output folder.
    start
        Start from these weights (.onnx) at half the learning rate; `shipped` names those of the
        package. Default: random weights.
    validate
        Validation recordings, never trained on; repeatable.
    hold_out
        Share of the end of every continuous minute or more to hold out for validation.
    target
        Training target: truth, estimates, or auto (truth where available).
    include_scored
        Also train on slots declared for evaluation; the model card says so.
    combinations
        Maximum camera combinations per slot, sampled at random.
    replays
        Also learn from so many replays of each recording with truth, as half of the windows:
        simulated detectors of some of its cameras look at its people at 11 to 31 slots per second,
        and the inputs are what the filter shows with 1 or more cameras selected per slot. --start
        corrects its velocities.
    history
        History length M in slots.
    leads
        Longest lead to train for, in slots.
    hidden
        Hidden size of the network.
    dropout
        Dropout rate. Default: 0.2, or that of --start.
    published
        Train the paper's network with its loss, eq. (6), on estimates from combinations of cameras
        unless --target says otherwise. It states no errors, so it corrects no velocities.
    steps
        Maximum number of batches.
    minutes
        Time limit.
    batch
        Batch size.
    seed
        Random seed.
    jobs
        Worker processes for data preparation; -1 uses all cores. Does not change the weights.
    dask
        Dask scheduler for data preparation, such as tcp://host:8786, or local. Use only a cluster
        you trust.
    """
    import math

    from e3pose.runtime.workers import Workers

    _check(
        ("hold-out", hold_out, 0.0, 0.9),
        ("history", history, 4, 100),
        ("leads", leads, 1, 60),
        ("hidden", hidden, 8, 1024),
        ("dropout", 0.0 if dropout is None else dropout, 0.0, 0.9),
        ("steps", steps, 1, 10_000_000),
        ("minutes", math.inf if minutes is None else minutes, 0.01, math.inf),
        ("batch", batch, 2, 4096),
        ("seed", seed, 0, 2**31 - 1),
        ("combinations", combinations, 1, 1000),
        ("replays", replays, 0, 1000),
    )
    workers = Workers(jobs, dask)
    import torch

    from e3pose.cli.placed import load_placed
    from e3pose.learn.train.attention_lstm import TrainSettings as Settings
    from e3pose.learn.train.attention_lstm import train as run
    from e3pose.learn.train.clips import gather
    from e3pose.learn.train.estimates import EstimateSettings
    from e3pose.learn.train.lessons import LessonSettings
    from e3pose.learn.train.network import NetworkSettings
    from e3pose.learn.train.replayed import ReplayedSettings

    # More threads are no faster with a network so small, and a hundred times slower where other
    # programs run: they wait for each other by counting.
    torch.set_num_threads(1)
    network = NetworkSettings(history_slots=history, hidden=hidden)
    settings = Settings(
        network=network.as_published() if published else network,
        loss="squared" if published else "relative",
        num_leads=leads,
        steps=steps,
        minutes=math.inf if minutes is None else minutes,
        batch=batch,
        seed=seed,
    )
    before: AttentionLstm | None = None
    if start is not None and published:
        raise InputError("--published", "with --start", "one of them")
    if start is not None:
        before, settings = _gone_on_from(start, settings)
    if dropout is not None:
        settings = replace(settings, network=replace(settings.network, dropout=dropout))
    wanted = LessonSettings(
        target="estimates" if published and target == "auto" else target,
        include_scored=include_scored,
        estimates=EstimateSettings(combinations=combinations, seed=seed),
        replayed=ReplayedSettings(replays, _file(start) if start else None, seed),
    )
    learned, held_out = gather(
        [load_placed(path) for path in recordings],
        [load_placed(path) for path in validate or []],
        hold_out,
        history + leads,
        _with_progress(wanted, workers),
    )
    with _progress() as bar:
        task = bar.add_task("train", total=1.0)
        weights = run(
            learned,
            held_out,
            out,
            settings,
            lambda share, text: bar.update(task, completed=share, description=f"train, {text}"),
            workers,
            before,
        )
    print(f"Wrote {weights}; validation figures: {out / 'model-card.md'}")


def _progress() -> Progress:
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    return Progress(console=console, disable=not console.is_terminal, transient=True)


def _with_progress(
    wanted: LessonSettings, workers: Workers
) -> Callable[[Recording, int], list[Clip]]:
    """Return what makes the lessons of a recording, and shows how far it is."""
    from e3pose.learn.train.lessons import lessons

    def motion(recording: Recording, shortest: int) -> list[Clip]:
        with _progress() as bar:
            task = bar.add_task(f"fuse {recording.name}", total=1.0)
            return lessons(
                recording,
                shortest,
                wanted,
                workers,
                lambda share: bar.update(task, completed=share),
            )

    return motion


def _file(start: Path) -> Path:
    """Return the weights that `--start` names."""
    from e3pose.predict.attention_lstm import SHIPPED

    return SHIPPED if str(start) == SHIPPED_NAME else start


def _gone_on_from(start: Path, settings: TrainSettings) -> tuple[AttentionLstm, TrainSettings]:
    """Return the network in a file, and the settings to go on from it."""
    import hashlib

    from e3pose.files.bounded import read_bytes
    from e3pose.learn.train.weights import network_of
    from e3pose.predict.attention_lstm import MAX_WEIGHTS_BYTES

    path = _file(start)
    content = read_bytes(path, MAX_WEIGHTS_BYTES)
    network, _ = network_of(content, str(path))
    for name, wanted, found in (
        ("history", settings.network.history_slots, network.settings.history_slots),
        ("hidden", settings.network.hidden, network.settings.hidden),
    ):
        if wanted != found:
            raise InputError(f"--{name}: found {wanted}, expected {found} as in {path}")
    digest = hashlib.sha256(content).hexdigest()[:12]
    return network, replace(
        settings,
        network=network.settings,
        learning_rate=settings.learning_rate / 2,
        started_from=f"{start.name}, sha256 {digest}",
    )


def _check(*numbers: tuple[str, float, float, float]) -> None:
    for name, value, low, high in numbers:
        if not low <= value <= high:
            raise InputError(f"--{name}: found {value:g}, expected {low:g} to {high:g}")
