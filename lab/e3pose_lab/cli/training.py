"""`e3pose train`: train the attention-LSTM predictor on recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from e3pose.base.errors import InputError
from e3pose.cli.options import Flag, Whole

if TYPE_CHECKING:
    from rich.progress import Progress

    from e3pose.recording import Recording
    from e3pose_lab.train.attention_lstm import TrainSettings
    from e3pose_lab.train.network import AttentionLstm
    from e3pose_lab.train.training_clips import ClipSettings
    from e3pose_lab.train.windows import Clip
    from e3pose_lab.workers import Workers

SHIPPED_NAME = "shipped"


@Parameter(name="*", group=Group("Training data", sort_key=1))
@dataclass(frozen=True, kw_only=True)
class DataOptions:
    """Recordings to learn from, and how."""

    validate: Annotated[list[Path] | None, Parameter(consume_multiple=True, negative="")] = None
    """Validation recordings, never trained on; repeatable."""
    hold_out: float = 0.2
    """Share of the end of every continuous minute or more to hold out for validation."""
    target: Literal["auto", "truth", "estimates", "least-occluded"] = "auto"
    """Training target: truth; estimates (of all cameras together); least-occluded (estimates of
    the three cameras with the least occlusion, as in the paper for live video); or auto (truth
    where available)."""
    include_scored: Flag = False
    """Also train on slots declared for evaluation; the model card says so."""
    combinations: Whole = 32
    """Maximum camera combinations per slot, sampled at random."""
    replays: Whole = 0
    """Also learn from so many replays of each recording with truth, as half of the windows:
    simulated detectors of some of its cameras detect its people at 11 to 31 slots per second, and
    the inputs are what the filter publishes with 1 or more cameras selected per slot. --start
    corrects its velocities."""
    jobs: Whole = 1
    """Worker processes for data preparation; -1 uses all cores. Does not change the weights."""
    dask: str | None = None
    """Dask scheduler for data preparation, such as tcp://host:8786, or local. Use only a cluster
    you trust."""


@Parameter(name="*", group=Group("Network", sort_key=2))
@dataclass(frozen=True, kw_only=True)
class NetworkOptions:
    """The network to train."""

    start: Path | None = None
    """Start from these weights (.onnx) at half the learning rate; `shipped` names those of the
    package, with `--published` those of the paper's network. Default: random weights."""
    history: Whole = 10
    """History length M in slots."""
    leads: Whole = 15
    """Longest lead to train for, in slots."""
    hidden: Whole = 96
    """Hidden size of the network."""
    dropout: float | None = None
    """Dropout rate. Default: 0.2, or that of --start."""
    published: Flag = False
    """Train the paper's network on estimates from combinations of cameras, without other bodies
    than those recorded; --target is least-occluded unless given. It states no errors, so it
    corrects no velocities."""


@Parameter(name="*", group=Group("Optimisation", sort_key=3))
@dataclass(frozen=True, kw_only=True)
class StepOptions:
    """How long and how to train."""

    steps: Whole = 12_000
    """Maximum number of batches."""
    minutes: float | None = None
    """Time limit."""
    batch: Whole = 128
    """Batch size."""
    seed: Whole = 0
    """Random seed."""
    loss: Literal["relative", "squared"] = "relative"
    """Error relative to that of the best simple predictor, or squared error, eq. (6) of the
    paper, which learns fast motion alone."""


DATA, NETWORK, STEPS = DataOptions(), NetworkOptions(), StepOptions()


def train(
    recordings: Annotated[list[Path], Parameter(name="RECORDING", negative="")],
    /,
    *,
    out: Path = Path("predictor"),
    data: DataOptions = DATA,
    network: NetworkOptions = NETWORK,
    optimisation: StepOptions = STEPS,
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
    """
    from e3pose_lab.workers import Workers

    _check(data, network, optimisation)
    workers = Workers(data.jobs, data.dask)
    import torch

    from e3pose.cli.placed import load_placed
    from e3pose_lab.train.attention_lstm import train as run
    from e3pose_lab.train.clips import gather

    # More threads are no faster with a network so small, and a hundred times slower where other
    # programs run: they wait for each other in busy loops.
    torch.set_num_threads(1)
    settings, before = _settings(network, optimisation)
    learned, held_out = gather(
        [load_placed(path) for path in recordings],
        [load_placed(path) for path in data.validate or []],
        data.hold_out,
        network.history + network.leads,
        _with_progress(_clip_settings(data, network, optimisation.seed), workers),
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


def _settings(
    network: NetworkOptions, optimisation: StepOptions
) -> tuple[TrainSettings, AttentionLstm | None]:
    """Return the settings, and the network to start from."""
    import math

    from e3pose_lab.train.attention_lstm import TrainSettings as Settings
    from e3pose_lab.train.network import NetworkSettings

    shape = NetworkSettings(history_slots=network.history, hidden=network.hidden)
    settings = Settings(
        network=shape.as_published() if network.published else shape,
        loss=optimisation.loss,
        variety="motion" if network.published else "bodies",
        num_leads=network.leads,
        steps=optimisation.steps,
        minutes=math.inf if optimisation.minutes is None else optimisation.minutes,
        batch=optimisation.batch,
        seed=optimisation.seed,
    )
    before: AttentionLstm | None = None
    if network.start is not None:
        before, settings = _gone_on_from(network, settings)
    if network.dropout is not None:
        settings = replace(settings, network=replace(settings.network, dropout=network.dropout))
    return settings, before


def _clip_settings(data: DataOptions, network: NetworkOptions, seed: int) -> ClipSettings:
    """Return the settings of the clips of each recording."""
    from e3pose_lab.train.estimates import EstimateSettings
    from e3pose_lab.train.replayed import ReplayedSettings
    from e3pose_lab.train.training_clips import ClipSettings as Settings

    start = None if network.start is None else _file(network)
    return Settings(
        target="least-occluded" if network.published and data.target == "auto" else data.target,
        include_scored=data.include_scored,
        estimates=EstimateSettings(combinations=data.combinations, seed=seed),
        replayed=ReplayedSettings(data.replays, start, seed),
    )


def _progress() -> Progress:
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    return Progress(console=console, disable=not console.is_terminal, transient=True)


def _with_progress(
    wanted: ClipSettings, workers: Workers
) -> Callable[[Recording, int], list[Clip]]:
    """Make a function that makes the training clips of a recording and shows its progress."""
    from e3pose_lab.train.training_clips import training_clips

    def motion(recording: Recording, shortest: int) -> list[Clip]:
        with _progress() as bar:
            task = bar.add_task(f"fuse {recording.name}", total=1.0)
            return training_clips(
                recording,
                shortest,
                wanted,
                workers,
                lambda share: bar.update(task, completed=share),
            )

    return motion


def _file(options: NetworkOptions) -> Path:
    """Return the weights that `--start` names."""
    from e3pose.predict.attention_lstm import PUBLISHED, SHIPPED

    assert options.start is not None
    if str(options.start) != SHIPPED_NAME:
        return options.start
    return PUBLISHED if options.published else SHIPPED


def _gone_on_from(
    options: NetworkOptions, settings: TrainSettings
) -> tuple[AttentionLstm, TrainSettings]:
    """Return the network in the file that `--start` names, and the settings to go on from it."""
    import hashlib

    from e3pose.base.bounded import read_bytes
    from e3pose.predict.attention_lstm import MAX_WEIGHTS_BYTES
    from e3pose_lab.train.weights import network_of

    path = _file(options)
    content = read_bytes(path, MAX_WEIGHTS_BYTES)
    network, _ = network_of(content, str(path))
    if options.published and network.settings != network.settings.as_published():
        raise InputError("--published", f"another network in {path}", "one trained with it")
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
        started_from=f"{path.name}, sha256 {digest}",
    )


def _check(data: DataOptions, network: NetworkOptions, optimisation: StepOptions) -> None:
    """Raise `InputError` naming an option that is out of its range."""
    limits = {
        "hold_out": (0.0, 0.9),
        "history": (4, 100),
        "leads": (1, 60),
        "hidden": (8, 1024),
        "dropout": (0.0, 0.9),
        "steps": (1, 10_000_000),
        "minutes": (0.01, float("inf")),
        "batch": (2, 4096),
        "seed": (0, 2**31 - 1),
        "combinations": (1, 1000),
        "replays": (0, 1000),
    }
    given = {**asdict(data), **asdict(network), **asdict(optimisation)}
    for name, (low, high) in limits.items():
        value = given[name]
        if value is not None and not low <= value <= high:
            option = name.replace("_", "-")
            wanted = f"{low:g} or more" if high == float("inf") else f"{low:g} to {high:g}"
            raise InputError(f"--{option}", f"{value:g}", wanted)
