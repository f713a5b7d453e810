"""`e3pose learn`: learning from what the running system estimates; its versions; the way back."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from e3pose.cli.options import Whole
from e3pose.errors import InputError
from e3pose.plural import counted

if TYPE_CHECKING:
    from e3pose.learn.online import OnlineTrainer
    from e3pose.learn.online.rehearse import Rehearsed
    from e3pose.predict.base import Predictor
    from e3pose.recording import Recording
    from e3pose.settings.loop import ReplaySettings

learn_app = App(
    name="learn", help="Let the predictor learn from what the running system estimates."
)
PAUSE_S = 0.2
WARM_UP_SLOTS = 10  # in which code is loaded


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
    paced: Annotated[bool, Parameter(negative="")] = False,
    held_back: float = 60.0,
    least: float = 120.0,
    every: float = 0.0,
    minutes: float = 2.0,
    margin: float = 0.02,
) -> None:
    """Run recordings one after the other as if they were live, and learn from them on the way.

    Example: `e3pose learn replay monday tuesday wednesday --out learned`

    The predictor is trained in a process of its own on the poses that the system estimated, never
    on the truth, and swapped between two slots when it is better than the running one on the newest
    minutes, which it never saw. Needs `pip install 'e3pose[train]'`; without it the system runs and
    only says so. What was learned stays in OUT; the same command goes on from there.

    Parameters
    ----------
    recordings
        Folders with detections, in the order in which they happened. Never give one twice: what is
        held back would have been learned before.
    out
        The folder of this site: poses, versions, the running training.
    policy
        Who decides, as in `e3pose replay`.
    pipeline
        How the people are found, as in `e3pose replay`.
    cameras
        C, how many cameras detect in a slot; 3 unless the rig has fewer.
    lead
        tau, how many slots ahead the cameras are told.
    paced
        Run at the pace of the recording with the training beside it, as live. Without it the slots
        go by as fast as they can, and training happens between recordings.
    held_back
        Seconds with people, the newest, that are not learned from.
    least
        Seconds with people to begin with.
    every
        Seconds from one training to the next.
    minutes
        Time that a training may learn for.
    margin
        Share by which the error must be lower at every lead.
    """
    from e3pose.cli.placed import load_placed
    from e3pose.clock import WallClock
    from e3pose.evaluate.replay import ReplaySettings, make_pipeline
    from e3pose.learn.online import LearningSettings, OnlineTrainer
    from e3pose.learn.online.versions import check_learning_folder

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
    settings = LearningSettings(
        interval_s=sources[0].interval_s,
        held_back_s=held_back,
        least_s=least,
        every_s=every,
        train_s=60 * minutes,
        margin=margin,
        chunk_s=max(1.0, min(30.0, held_back / 4)),
    )
    options = {
        "policy": policy,
        "pipeline": pipeline,
        "lead_slots": lead,
        "num_selected": min(3, *(len(s.rig) for s in sources)) if cameras is None else cameras,
        "predictor": "attention-lstm",
    }
    given = {key: value for key, value in options.items() if value is not None}
    loop = ReplaySettings(**given)  # type: ignore[arg-type]
    for source in sources:  # a wrong option is told before anything is written
        make_pipeline(source, loop)
    trainer = OnlineTrainer(out, sources[0].skeleton, settings, WallClock(), background=paced)
    try:
        _run(sources, loop, trainer, paced)
    finally:
        trainer.close()
    _print_versions(out)


@learn_app.command(name="versions")
def list_versions(folder: Path, /) -> None:
    """List the networks of a site, and how much better each was than the one before it.

    Example: `e3pose learn versions learned`

    Parameters
    ----------
    folder
        The folder that was given to `--out`.
    """
    _check_folder(folder)
    _print_versions(folder)


@learn_app.command
def rollback(folder: Path, /, *, to: Whole | None = None) -> None:
    """Go back to an earlier network; a system that runs with the folder takes it within a second.

    Example: `e3pose learn rollback learned`

    Parameters
    ----------
    folder
        The folder that was given to `--out`.
    to
        The number of the version, 0 for the shipped network; by default the one before.
    """
    from e3pose.learn.online.versions import VersionStore

    _check_folder(folder)
    store = VersionStore(folder / "versions")
    if to is None:
        number = store.back()
    else:
        store.use(to)
        number = to
    print(f"{folder}: version {number} is current")


def _run(
    sources: list[Recording], settings: ReplaySettings, trainer: OnlineTrainer, paced: bool
) -> None:
    import logging
    import time

    from e3pose.cli.progress import track_progress
    from e3pose.learn.online.rehearse import rehearse

    logging.getLogger("e3pose.learn.online").addHandler(logging.NullHandler())  # events are printed
    told = 0
    predictor: Predictor | None = trainer.poll()
    for source in sources:
        began = time.monotonic()

        def wait_until(offset_s: float, began: float = began) -> None:
            time.sleep(max(0.0, began + offset_s - time.monotonic()))

        run = rehearse(source, settings, trainer, predictor, wait_until if paced else None)
        slots = list(track_progress(run, source.num_slots, source.name))
        predictor = slots[-1].predictor if slots else predictor
        print(_summary(source, slots))
        if not paced:
            trainer.write_waiting()
        print(f"  {trainer.collected_s:.0f} s with people are collected")
        if not paced:
            trainer.attend()
            while trainer.training:
                time.sleep(PAUSE_S)
                trainer.attend()
            predictor = trainer.poll() or predictor
        for event in trainer.events[told:]:
            print(f"  {event}")
        told = len(trainer.events)


def _summary(source: Recording, slots: list[Rehearsed]) -> str:
    used = sorted({slot.version for slot in slots})
    swaps = [1000 * slot.seconds for slot in slots if slot.swapped]
    line = f"{source.name}: {counted(len(slots), 'slot')} with version {', '.join(map(str, used))}"
    times = sorted(1000 * slot.seconds for slot in slots[WARM_UP_SLOTS:])
    if times:
        line += f"; a slot took {times[len(times) // 2]:.1f} ms, the longest {times[-1]:.1f} ms"
    return line + "".join(f", one with a swap {ms:.1f} ms" for ms in swaps)


def _check_folder(folder: Path) -> None:
    if not (folder / "versions").is_dir():
        raise InputError(f"{folder}: found no versions there, expected a folder of `e3pose learn`")


def _print_versions(folder: Path) -> None:
    from datetime import datetime, timezone

    from rich.console import Console
    from rich.table import Table

    from e3pose.learn.online.versions import VersionStore

    manifest = VersionStore(folder / "versions").read()
    table = Table(
        "", "version", "from", "made", "mm on the newest minutes: lead, before, now", box=None
    )
    running = {manifest.current: "*"}
    table.add_row(running.get(0, ""), "0", "", "", "the network to begin with")
    for version in manifest.versions:
        made = datetime.fromtimestamp(version.created_s, timezone.utc)
        figures = zip(version.leads, version.parent_error_m, version.error_m, strict=True)
        table.add_row(
            running.get(version.number, ""),
            str(version.number),
            str(version.parent),
            f"{made:%Y-%m-%d %H:%M}Z",
            "; ".join(f"{lead}: {1000 * a:.1f} {1000 * b:.1f}" for lead, a, b in figures),
        )
    console = Console() if sys.stdout.isatty() else Console(width=200)
    console.print(table)
