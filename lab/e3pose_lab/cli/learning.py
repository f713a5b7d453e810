"""`e3pose learn`: train the predictor online on the system's own estimates; versions; rollback."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Group, Parameter

from e3pose.base.clock import WallClock
from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.cli.options import Flag, Whole
from e3pose.cli.placed import load_placed
from e3pose.cli.progress import track_progress
from e3pose.edge.learn import LearningSettings, OnlineTrainer
from e3pose.edge.learn.versions import VersionStore, check_learning_folder
from e3pose.evaluate.columns import print_tables, table_console
from e3pose.evaluate.replay import ReplaySettings, make_pipeline
from e3pose_lab.train.rehearse import Rehearsed, rehearse

if TYPE_CHECKING:
    from e3pose.predict.base import Predictor
    from e3pose.recording import Recording

learn_app = App(
    name="learn", help="Train the predictor online, on the poses that the system estimates."
)
PAUSE_S = 0.2
WARM_UP_SLOTS = 10  # in which code is loaded


@Parameter(name="*", group=Group("Training", sort_key=1))
@dataclass(frozen=True, kw_only=True)
class TrainingOptions:
    """When to train, how long, and what counts as better."""

    held_back: float = 60.0
    """Hold out this many of the newest seconds with people, for validation."""
    least: float = 120.0
    """Seconds with people before the first training."""
    every: float = 0.0
    """Seconds between trainings."""
    minutes: float = 2.0
    """Time limit of one training."""
    margin: float = 0.02
    """Required relative improvement at every lead."""

    def settings(self, interval_s: float) -> LearningSettings:
        """Return the settings that these options mean."""
        return LearningSettings(
            interval_s=interval_s,
            held_back_s=self.held_back,
            least_s=self.least,
            every_s=self.every,
            train_s=60 * self.minutes,
            margin=self.margin,
            chunk_s=max(1.0, min(30.0, self.held_back / 4)),
        )


TRAINING = TrainingOptions()


@learn_app.command(name="replay")
def learn_replay(
    recordings: Annotated[list[Path], Parameter(name="RECORDING", negative="")],
    /,
    *,
    out: Path = Path("learned"),
    policy: str | None = None,
    pipeline: str | None = None,
    cameras: Annotated[Whole | None, Parameter(alias="-C")] = None,
    lead: Whole = 1,
    paced: Flag = False,
    training: TrainingOptions = TRAINING,
) -> None:
    """Replay recordings in order, as if live, and train the predictor on the estimated poses.

    Example: `e3pose learn replay monday tuesday wednesday --out learned`

    Training runs in a separate process on the system's own estimates, never on the truth. A new
    network replaces the running one between two slots if it is better on held-out recent minutes.
    Training needs the extra `train`. Run the same command again to resume.

    Parameters
    ----------
    recordings
        Recording folders in chronological order, each once.
    out
        Folder for collected poses, versions and the training job.
    policy
        Policy, as in `e3pose replay`.
    pipeline
        Estimator, as in `e3pose replay`.
    cameras
        Cameras per slot C. Default: 3, or all cameras of a smaller rig.
    lead
        Lead tau: slots between a decision and the slot it is for.
    paced
        Replay in real time with training in parallel, as live. Default: replay at full speed and
        train between recordings.
    """
    places = [path.resolve() for path in recordings]
    for path, place in zip(recordings, places, strict=True):
        if places.count(place) > 1:
            raise InputError(f"{path}: found twice, expected every recording once")
    check_learning_folder(out)
    sources = [load_placed(path) for path in recordings]
    skeletons = {source.skeleton.name for source in sources}
    rates = {source.fps for source in sources}
    if len(skeletons) > 1 or len(rates) > 1:
        raise InputError("learn: found recordings of several skeletons or rates, expected one")
    settings = training.settings(sources[0].interval_s)
    options = {
        "policy": policy,
        "pipeline": pipeline,
        "lead_slots": lead,
        "num_selected": min(3, *(len(s.rig) for s in sources)) if cameras is None else cameras,
        "predictor": "attention-lstm",
    }
    given = {key: value for key, value in options.items() if value is not None}
    loop = ReplaySettings(**given)  # type: ignore[arg-type]
    for source in sources:  # a wrong option fails before anything is written
        make_pipeline(source, loop)
    trainer = OnlineTrainer(out, sources[0].skeleton, settings, WallClock(), background=paced)
    try:
        _run({p.name: s for p, s in zip(places, sources, strict=True)}, loop, trainer, paced)
    finally:
        trainer.close()
    _print_versions(out)


@learn_app.command(name="versions")
def list_versions(folder: Path, /) -> None:
    """List the networks of a site with their validation errors.

    Example: `e3pose learn versions learned`

    Parameters
    ----------
    folder
        Folder given to `--out`.
    """
    _check_folder(folder)
    _print_versions(folder)


@learn_app.command
def rollback(folder: Path, /, *, to: Whole | None = None) -> None:
    """Return to an earlier network; a running system switches within a second.

    Example: `e3pose learn rollback learned`

    Parameters
    ----------
    folder
        Folder given to `--out`.
    to
        Version number; 0 is the shipped network. Default: the previous version.
    """
    _check_folder(folder)
    store = VersionStore(folder / "versions")
    if to is None:
        number = store.back()
    else:
        store.use(to)
        number = to
    print(f"{folder}: version {number} is now current")


def _run(
    sources: dict[str, Recording], settings: ReplaySettings, trainer: OnlineTrainer, paced: bool
) -> None:
    logging.getLogger("e3pose.edge.learn").addHandler(logging.NullHandler())  # events are printed
    shown = 0
    predictor: Predictor | None = trainer.poll()
    for name, source in sources.items():
        began = time.monotonic()

        def wait_until(offset_s: float, began: float = began) -> None:
            time.sleep(max(0.0, began + offset_s - time.monotonic()))

        run = rehearse(source, settings, trainer, predictor, wait_until if paced else None)
        slots = list(track_progress(run, source.num_slots, name))
        predictor = slots[-1].predictor if slots else predictor
        print(_summary(name, slots))
        if not paced:
            trainer.write_waiting()
        print(f"  {trainer.collected_s:.0f} s with people collected")
        if not paced:
            trainer.run_once()
            while trainer.training:
                time.sleep(PAUSE_S)
                trainer.run_once()
            predictor = trainer.poll() or predictor
        for event in trainer.events[shown:]:
            print(f"  {event}")
        shown = len(trainer.events)


def _summary(name: str, slots: list[Rehearsed]) -> str:
    used = sorted({slot.version for slot in slots})
    swaps = [1000 * slot.seconds for slot in slots if slot.swapped]
    line = f"{name}: {plural(len(slots), 'slot')} with version {', '.join(map(str, used))}"
    times = sorted(1000 * slot.seconds for slot in slots[WARM_UP_SLOTS:])
    if times:
        line += f"; slot time {times[len(times) // 2]:.1f} ms median, {times[-1]:.1f} ms maximum"
    return line + "".join(f", {ms:.1f} ms with a swap" for ms in swaps)


def _check_folder(folder: Path) -> None:
    if not (folder / "versions").is_dir():
        raise InputError(f"{folder}: found no versions, expected a folder of `e3pose learn`")


def _print_versions(folder: Path) -> None:
    manifest = VersionStore(folder / "versions").read()
    leads = sorted({lead for version in manifest.versions for lead in version.leads})
    rows = {0: ["-", "shipped network", *["-"] * len(leads)]}
    for version in manifest.versions:
        made = datetime.fromtimestamp(version.created_s, timezone.utc)
        figures = {
            lead: f"{1000 * before:.1f} -> {1000 * after:.1f}"
            for lead, before, after in zip(
                version.leads, version.parent_error_m, version.error_m, strict=True
            )
        }
        rows[version.number] = [
            str(version.parent),
            f"{made:%Y-%m-%d %H:%M}Z",
            *(figures.get(lead, "-") for lead in leads),
        ]
    headings = ["parent", "created", *(f"lead {lead}, mm" for lead in leads)]
    columns = {name: [row[i] for row in rows.values()] for i, name in enumerate(headings)}
    numbers = [f"{number}{' *' * (number == manifest.current)}" for number in rows]
    console = table_console(200)
    print_tables(console, {"version": numbers}, columns)
    console.print("* current; errors on held-out minutes, parent -> version")
