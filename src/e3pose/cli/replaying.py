"""`e3pose replay`: one policy over one recording."""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from cyclopts import Parameter

from e3pose import __version__
from e3pose.base.disk_list import DiskList
from e3pose.base.errors import Exit, InputError
from e3pose.base.quantities import age_s, duration_s, plural, shell, size_bytes
from e3pose.base.system import num_cores
from e3pose.cli.options import FAULTS as FAULT_GROUP
from e3pose.cli.options import (
    GOAL,
    OUTPUT,
    SMOOTHING,
    EnergyOptions,
    HoldOut,
    LoopOptions,
    Redetect,
    Whole,
    as_typed,
    check_outputs,
    options_of,
    warn,
)
from e3pose.cli.options import STORE as STORE_GROUP
from e3pose.cli.output import JsonFile, is_stdout, write_json, wrote
from e3pose.cli.placed import load_placed, warn_of_problems
from e3pose.cli.progress import bar, track_progress
from e3pose.cli.smoothing import SmoothOptions
from e3pose.estimate.smooth.delayed import lag_slots
from e3pose.evaluate.detect_again import open_pixels
from e3pose.evaluate.faults import arriving, deaths_s, downsampled, parse_kill
from e3pose.evaluate.figures import HeldOut, Summary, as_json
from e3pose.evaluate.held_out import doubts_of, joined, judge, turns
from e3pose.evaluate.poses_table import check_poses_path, write_poses
from e3pose.evaluate.replay import replay as run_replay
from e3pose.evaluate.smoothed import (
    keep_people,
    smooth_poses,
    smooth_records,
    take_of_records,
)
from e3pose.evaluate.summary import summarise
from e3pose.evaluate.tables import print_summary
from e3pose.model.skeleton import own_file
from e3pose.output.exports import ExportSettings, export
from e3pose.output.report import write_report
from e3pose.recording.problems import HARMLESS
from e3pose.settings.faults import Faults
from e3pose.settings.limits import check_smooth_delay
from e3pose.settings.parts import warnings_of
from e3pose.store.rows import Run

if TYPE_CHECKING:
    from e3pose.energy.profiles import DeviceProfile, Mode
    from e3pose.estimate.base import Estimate, Posterior
    from e3pose.estimate.smooth import SmoothSettings
    from e3pose.evaluate.detect_again import PixelViews
    from e3pose.model.slot_record import SlotRecord
    from e3pose.recording import Recording
    from e3pose.settings.energy import EnergyPlan
    from e3pose.settings.loop import ReplaySettings
    from e3pose.store import Retention

    Step = Callable[[SlotRecord], SlotRecord]


@Parameter(name="*", group=FAULT_GROUP)
@dataclass(frozen=True, kw_only=True)
class FaultOptions:
    """Injected faults, for every verb that runs the loop."""

    kill_camera: Annotated[tuple[str, ...], Parameter(negative="", show_default=False)] = ()
    """Fail a camera: CAMERA@SLOT or CAMERA@12.5s; repeatable. `each@SLOT` fails a different
    camera in each repetition."""
    loss: float = 0.0
    """Share of selected views lost in the network; their energy is still spent."""
    fps: float | None = None
    """Resample the recording to this frame rate."""

    def day(
        self, recording: Recording, watts: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    ) -> Faults:
        """Return the injected faults; raise `InputError` for impossible ones.

        Args:
            recording: as `downsampled` returns it.
            watts: what each camera draws when active, and when not.
        """
        day = Faults(tuple(parse_kill(text) for text in self.kill_camera), self.loss, watts)
        deaths_s(recording, day.kills)
        arriving(len(recording.rig), day.loss, 0, 0)
        return day

    def downsampled(self, recording: Recording) -> Recording:
        """Return the recording at the frame rate that is asked for."""
        return recording if self.fps is None else downsampled(recording, self.fps)


@Parameter(name="*", group=STORE_GROUP)
@dataclass(frozen=True, kw_only=True)
class StoreOptions:
    """Where every slot is kept, for every verb that runs the loop."""

    store: str | None = None
    """Store every slot in this database, for `e3pose query`: a file such as `live.db`, or a URL."""
    keep: str | None = None
    """Retention: delete slots older than this, such as `30d` or `12h`."""
    max_size: Annotated[str | None, Parameter(name="--max-size")] = None
    """Retention: delete the oldest slots beyond this size, such as `20GB`."""

    def file(self) -> Path | None:
        """Return the file that the store is, None for a database elsewhere, or none at all."""
        if self.store is None:
            return None
        from e3pose.store.database import database_path, database_url

        return database_path(database_url(self.store))

    def retention(self) -> Retention:
        """Return the retention; raise `InputError` for a value that is no age or size."""
        from e3pose.store import Retention

        if self.store is None and (self.keep or self.max_size):
            raise InputError("--keep, --max-size: found no --store, expected one to keep them in")
        with as_typed({"": "--keep"}):
            max_age_s = None if self.keep is None else age_s(self.keep)
        with as_typed({"": "--max-size"}):
            max_bytes = None if self.max_size is None else size_bytes(self.max_size)
        return Retention(max_age_s, max_bytes)


LOOP, ENERGY, FAULTS, STORE = LoopOptions(), EnergyOptions(), FaultOptions(), StoreOptions()
SMOOTH = SmoothOptions()


@Parameter(name="*", group=OUTPUT)
@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """The files to write."""

    poses: Path | None = None
    """Write the 3D poses here (.parquet or .csv)."""
    layout: Literal["long", "wide"] = "long"
    """Rows of --poses: one per joint (long) or per person (wide), as in `e3pose export`."""
    report: Path | None = None
    """Write a report page with a 3D player here (.html)."""
    json_file: JsonFile = None
    """Write the figures here as JSON; - is standard output."""
    people: Annotated[Whole | None, Parameter(show=False)] = None
    """Keep this many people only."""

    def check(self, recording: Path, store: StoreOptions, smoothed: str | None) -> None:
        """Raise `InputError` before the replay for files that could not be written.

        `smoothed` is the option by which poses are smoothed, if any.
        """
        if self.poses is not None:
            check_poses_path(self.poses)
        elif self.layout != "long":
            raise InputError("--layout", "it without --poses", "both")
        if self.report is not None and self.report.suffix.lower() not in (".html", ".htm"):
            found = repr(str(self.report))
            raise InputError(f"--report: found {found}, expected a name ending in .html")
        if store.store is not None or store.keep or store.max_size:
            store.retention()
        if store.store is not None and smoothed is not None:
            raise InputError(
                f"--store: found with {smoothed}, expected one of them; smooth later with "
                "e3pose export"
            )
        files = {"--poses": self.poses, "--json": self.json_file, "--report": self.report}
        check_outputs(recording, {"--store": store.file(), **files})

    def write(
        self,
        source: Recording,
        records: Sequence[SlotRecord],
        summary: Summary,
        notes: Sequence[str],
        store: Path | None,
        folder: Path | None = None,
    ) -> None:
        """Write the files and print the figures, unless JSON goes to standard output."""
        if self.poses is not None and self.layout == "wide" and any(len(r.people) for r in records):
            take = take_of_records(records, source.skeleton, source.interval_s, source.name)
            [*export(take, self.poses, self.poses.suffix[1:], ExportSettings(layout="wide"))]
        elif self.poses is not None:
            write_poses(records, source.skeleton, self.poses)
        if self.report is not None:
            write_report(source, records, summary, self.report, folder=folder)
        if not is_stdout(self.json_file):
            print_summary(summary, titles=source.rig.titles)
            for note in notes:
                print(note)
            for path in (self.poses, self.report, store):
                wrote(path)
        write_json(self.json_file, as_json(summary))


OUTPUTS = OutputOptions()


def replay(
    recording: Path,
    /,
    *,
    policy: str | None = None,
    cameras: Annotated[
        float | Literal["all"] | None, Parameter(alias="-C", group=GOAL, show_choices=False)
    ] = None,
    loop: LoopOptions = LOOP,
    energy: EnergyOptions = ENERGY,
    faults: FaultOptions = FAULTS,
    store: StoreOptions = STORE,
    smooth: SmoothOptions = SMOOTH,
    delay: Annotated[str | None, Parameter(group=SMOOTHING)] = None,
    detector: Redetect = None,
    hold_out: HoldOut = (),
    outputs: OutputOptions = OUTPUTS,
) -> None:
    """Replay a recording through the live pipeline, which sees only selected views.

    Example: `e3pose replay walk --cameras 2 --report walk.html`

    Prints accuracy (with truth or `--hold-out`), camera use and energy saved.

    Parameters
    ----------
    recording
        Recording folder.
    policy
        Camera selection: information, round-robin, random, all; of the paper: e3pose, e3pose-mv,
        independent, central-2d.
    cameras
        Cameras per slot C, a mean such as 1.5, or all. Default: 2 (paper: 3).
    delay
        Smooth with the next slots, for this time, such as 200ms.
    """
    smoothing = smooth.settings()
    if cameras == "all":
        if policy not in (None, "all"):
            raise InputError("--cameras", f"all with --policy {policy}", "one of them")
        policy, cameras = "all", None
    asked = loop.settings(policy, cameras)
    delay_s = delay_of(delay, smoothing.method, asked.pipeline)
    smoothed = "--delay" if delay_s else "--smooth" if smoothing.method else None
    outputs.check(recording, store, smoothed)
    whole = faults.downsampled(load_placed(recording, warned=True))
    shown = outputs.report is not None and asked.pipeline != "paper" and asked.policy != "all"

    def start(source: Recording, foresees: bool = False) -> _Run:
        plan = energy.settings().plan(source.rig.camera_ids, source.interval_s, source.battery_wh)
        settings = replace(
            asked.for_rig(len(source.rig), plan),
            foresees=foresees,
            faults=faults.day(source, plan.watts),
        )
        feedback, read_view = settings.feedback, None
        if feedback or detector is not None:
            read_view = open_pixels(source, recording, detector, feedback=feedback)
        smoother = Smoother(source, smoothing, delay_s)
        slots = run_replay(source, settings, publish=smoother.keep, read_view=read_view)
        return _Run(source, plan, settings, read_view, smoother, slots)

    more = ("cameras", "policy", "detector", "hold_out")
    with as_typed(options_of(LoopOptions, EnergyOptions, more=more)):
        (source, judges), *others = turns(whole, hold_out)
        main = start(source, shown)
        left_out = [(start(rest), by) for rest, by in others if by is not None]
    run = f"replay {main.settings.row_name}"
    slots = stored(main.slots, store, source, run, main.plan.profiles, main.plan.idle_mode)
    records = main.records(track_progress(slots, source.num_slots, "replay"))
    said = _judged(left_out) if left_out else []  # afterwards, as kernels are compiled by then
    left: list[str] = []
    if outputs.people is not None:
        records, count = keep_people(records, outputs.people)
        left = [f"Left out {plural(count, 'track')} beyond {plural(outputs.people, 'person')}."]
    # Beside the figures; an error before them is one line.
    problems = warn_of_problems(whole, recording)
    for words in warnings_of(source, main.settings):
        warn(words)
    held_out = joined([judge(judges, records) if judges else None, *said])
    notes = (*left, *([] if main.read_view is None else [main.read_view.summary()]))
    summary = replace(main.summary(records, notes), held_out=held_out)
    if summary.all_looked and not source.truth:
        own, bad = judge(source, records), [p for p in problems if p.kind not in HARMLESS]
        doubts = (*doubts_of(held_out, own), *(p.message for p in bad if p.where == "rig"))
        summary = replace(summary, reprojection=own, doubts=doubts)
    outputs.write(source, records, summary, notes, store.file(), recording)
    if not any(len(record.people) for record in records):
        why = sorted(problems, key=lambda one: one.kind in HARMLESS)
        also = f"; e3pose info {shell(recording)} tells more" if len(why) > 1 else ""
        reason = f"{why[0].where}: {why[0].message}" if why else "no two cameras see a person"
        print(f"e3pose: found nobody: {reason}{also}", file=sys.stderr)
        sys.exit(Exit.NOBODY)


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """A replay that has not begun."""

    source: Recording
    plan: EnergyPlan
    settings: ReplaySettings
    read_view: PixelViews | None
    smoother: Smoother
    slots: Iterator[SlotRecord]

    def records(
        self, slots: Iterator[SlotRecord], step: Step = lambda record: record
    ) -> DiskList[SlotRecord]:
        """Run it; `slots` are its own, passed through something, then through `step`."""
        return self.smoother.smoothed(DiskList(map(step, slots)), step)

    def summary(self, records: Sequence[SlotRecord], notes: Sequence[str]) -> Summary:
        """Return the figures of its records, with the remarks on new looks."""
        source, plan, read_view = self.source, self.plan, self.read_view
        figures = summarise(
            source if read_view is None else replace(source, processor=read_view.processor()),
            self.settings,
            records,
            plan.profiles,
            idle_mode=plan.idle_mode,
            battery_wh=plan.battery_wh,
        )
        notes = (*figures.notes, *notes)
        return replace(figures, smooth=self.smoother.words, notes=notes)


def _judged(left_out: Sequence[tuple[_Run, Recording]]) -> list[HeldOut]:
    """Return the figures of the held-out cameras on replays, several of which run at a time."""
    done, stopped, failed = itertools.count(1), Event(), list[BaseException]()
    # Replayed, and smoothed: rts passes them through once more.
    total = sum((1 + (run.smoother.words == "rts")) * run.source.num_slots for run, _ in left_out)
    alone = any(each.read_view is not None for each, _ in left_out)  # a network takes all cores

    def step(record: SlotRecord) -> SlotRecord:
        if stopped.is_set():
            raise CancelledError
        report(next(done), total)
        return record

    def judged(pair: tuple[_Run, Recording]) -> HeldOut:
        each, by = pair
        try:
            return judge(by, each.records(each.slots, step))
        except BaseException as error:  # whichever it is, the others stop now
            failed.append(error)
            stopped.set()
            raise

    with (
        bar("held-out cameras", transient=False) as report,
        ThreadPoolExecutor(1 if alone else num_cores()) as pool,
    ):
        try:
            return [*pool.map(judged, left_out)]
        except CancelledError:
            raise failed[0] from None
        except BaseException:
            stopped.set()
            raise


def delay_of(delay: str | None, method: str | None, pipeline: str) -> float:
    """Return the seconds of `--delay`, 0 without it; raise `InputError` for an impossible value."""
    if delay is None:
        return 0.0

    if method is not None:
        raise InputError("--delay: found with --smooth, expected one of them")
    with as_typed({"": "--delay", "smooth_delay_ms": "--delay"}):
        delay_s = duration_s(delay)
        check_smooth_delay(1e3 * delay_s, pipeline)
    return delay_s


class Smoother:
    """Smooths the poses of a replay, if that is asked for.

    Attributes:
        words: how; None for not at all.
    """

    def __init__(self, source: Recording, settings: SmoothSettings, delay_s: float) -> None:
        """Start without slots.

        Args:
            source: what is replayed.
            settings: of smoothing with all slots.
            delay_s: of smoothing with the slots of this time after each; 0 for none.
        """
        self._source, self._settings = source, settings
        self._posteriors: DiskList[Posterior] = DiskList()
        self._lag_slots: int | None = None
        self.words: str | None = settings.method
        if delay_s:
            self._lag_slots = lag_slots(delay_s, source.interval_s)
            self.words = f"{1e3 * self._lag_slots * source.interval_s:.0f} ms later"

    def keep(self, estimate: Estimate) -> None:
        """Keep what smoothing with the filter's motion model needs of a slot."""
        if (self._lag_slots or self._settings.method == "rts") and estimate.posterior is not None:
            self._posteriors.append(estimate.posterior)

    def smoothed(self, records: DiskList[SlotRecord], step: Step) -> DiskList[SlotRecord]:
        """Return the records with smoothed poses; rts passes them through `step` as well."""
        if self.words is None:
            return records

        skeleton, interval_s = self._source.skeleton, self._source.interval_s
        posteriors, self._posteriors = self._posteriors, DiskList()  # the file goes after use
        if len(posteriors):
            return smooth_records(records, posteriors, skeleton, self._lag_slots, step)
        return smooth_poses(records, skeleton, interval_s, self._settings)


def stored(
    records: Iterable[SlotRecord],
    options: StoreOptions,
    recording: Recording,
    name: str,
    profiles: Sequence[DeviceProfile],
    idle_mode: Mode,
) -> Iterator[SlotRecord]:
    """Yield records of a replay and keep each in the store that the options name, if they do.

    Energy is what the profiles, one a camera, say of the cameras that were ordered; times count
    from now.

    Raises:
        InputError: when the store cannot be written, at the start or before the end.
    """
    if options.store is None:
        yield from records
        return
    from e3pose.store import StoreWriter, WriterSettings

    run = Run(
        site=recording.name,
        name=name,
        started_ns=time.time_ns(),
        interval_s=recording.interval_s,
        skeleton=recording.skeleton.name,
        joints=recording.skeleton.joints,
        cameras=tuple(camera.camera_id for camera in recording.rig.cameras),
        software=f"e3pose {__version__}",
        own_skeleton=own_file(recording.skeleton),
    )
    active_j = np.array([each.watts("active") for each in profiles]) * recording.interval_s
    idle_j = np.array([each.watts(idle_mode) for each in profiles]) * recording.interval_s
    settings = WriterSettings(retention=options.retention())
    with StoreWriter(options.store, run, settings) as writer:
        for record in records:
            spent_j = np.where(record.selected, active_j, idle_j)
            writer.append(record, energy_j=spent_j, wait=True)
            yield record
        writer.flush(60.0)
        status = writer.status()
    if status.problem is not None or status.shed:
        raise InputError(
            f"{Path(options.store).name}: {plural(status.spooled, 'row')} not stored, "
            f"{status.shed} given up ({status.problem or 'no room'}), "
            "expected a database that takes them all"
        )
