"""How well falls are found, and what is taken for one.

    python lab/benchmarks/event_detection.py --seeds 0-9 --cameras 1,2,4 --fps 12.5 --lead 4
    python lab/benchmarks/event_detection.py --scenes "" --recordings PIZZA,SHELF --cameras 2
    python lab/benchmarks/event_detection.py --scenes "" --captured
    python lab/benchmarks/event_detection.py --scenes "" --motions MOTIONS --cameras 1,2

MOTIONS is a folder of recordings with truth alone, as `e3pose import bvh` makes them, and a table
`falls.csv` with a line `motion,down_s,up_s` for each fall: the recording's name, when the hips are
down, when the person begins to get up. They move before a ring of cameras with the detectors of the
simulated homes.

Simulated homes: `home-fall` has falls of seven kinds (their kinematics: `simulate.episodes`),
`home` and `home-play` have everything else that goes down, many times as often as life has it, and
`home-floor` only what ends on the floor. A fall is found when it is told before the person gets up.
In recordings of real people nobody falls: every alarm is false there.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from rich.progress import track
from scipy.stats import chi2

from choice_of_cameras import made as made_of
from e3pose.base.arrays import Flags
from e3pose.evaluate.faults import downsampled
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.events.people import Seen
from e3pose.events.watch import advance, begin_watch, looks_of
from e3pose.model.look_request import NO_REQUEST, LookRequest
from e3pose.model.people import People
from e3pose.model.person_event import ONCE, PersonEvent
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording, load_recording
from e3pose.settings.energy import AWAKE, EnergySettings, RestChoice
from e3pose.settings.events_table import EventsTable
from e3pose.settings.site_file import ZoneTable
from e3pose.simulate.episodes import BED_M, FALLS, LOW, SOFA_M, Episode
from e3pose.simulate.gestures import RAMP_S, Gesturing
from e3pose.simulate.scenes import BED, SOFA
from e3pose.simulate.settings import DetectorSettings, Guessing, SceneSettings
from e3pose.simulate.simulation import lives_of, simulate
from e3pose_lab.datasets import shared_folder
from predictor_in_the_loop import captured, seen

SOON_S = 3.0  # the aim: falls are told so soon after lying


EARLY_S = 1.0  # something may be told so long before a body has got there
LATE_S = 6.0  # what is due so near to the end of a recording does not count
SLIDE = "slide-down"
LIES_DEG = 45.0  # trunk from the vertical: who is on the floor and more upright sits
WAVES_S = 2.5  # who waves for so long has to be told
ENDS_S = 8.0  # getting up, or off a bed, is told so long after at most


@dataclass(frozen=True, slots=True)
class Due:
    """An event that should be told.

    Attributes:
        kind: of the event.
        what: it is of, an episode.
        since_s: from when on it is so, of which the delay counts.
        until_s: it must be told before.
        must: whether it has to be told; otherwise it may be, and is then no false alarm.
    """

    kind: str
    what: str
    since_s: float
    until_s: float
    must: bool = True

    def covers(self, event: PersonEvent, late_s: float = 0.0) -> bool:
        """Return whether an event is this one."""
        at_s = event.time_ns / 1e9
        return event.kind == self.kind and self.since_s - EARLY_S < at_s < self.until_s + late_s


def due_of(lived: Sequence[Episode], table: EventsTable, seconds: float) -> list[Due]:
    """Return the events due in a recording of so many seconds; near its end they are optional."""
    return [
        replace(due, must=due.must and due.since_s < seconds - LATE_S)
        for episode in lived
        for due in _due(episode, table)
    ]


def waves_of(gestures: Sequence[Gesturing], seconds: float) -> list[Due]:
    """Return the waves that are due in a recording of so many seconds."""
    return [
        Due(
            "waved", "wave", one.start_s + RAMP_S, one.stop_s,
            one.stop_s - one.start_s > WAVES_S + 2 * RAMP_S and one.stop_s < seconds - LATE_S,
        )
        for one in gestures
        if one.name == "wave"
    ]  # fmt: skip


def _due(episode: Episode, table: EventsTable) -> Iterator[Due]:
    times_s = episode.start_s + np.cumsum([key.after_s for key in episode.keys])
    kind, ends_s = episode.kind, episode.stop_s + ENDS_S
    low = [key.pelvis[2] < LOW and key.lift_m == 0 for key in episode.keys]
    raised = [key.lift_m > 0 for key in episode.keys]
    if True in raised:
        first, last = raised.index(True), len(raised) - 1 - raised[::-1].index(True)
        settled = times_s[last] - times_s[first] > table.settled_s + 2
        yield Due("left", kind, float(times_s[last]), ends_s, bool(settled))
    if True not in low:
        return
    first, last = low.index(True), len(low) - 1 - low[::-1].index(True)
    down_s, up_s = float(times_s[first]), float(times_s[last])
    key = episode.keys[last]
    lies_deg = np.degrees(np.arccos(np.clip(np.cos(key.pitch) * np.cos(key.roll), -1, 1)))
    if kind in FALLS:
        called = "fall" if lies_deg >= LIES_DEG else "fall that ends sitting"
        yield Due("fall", called if kind != SLIDE else f"slow {called}", down_s, episode.stop_s)
    whole = all(low[first : last + 1])
    long = whole and up_s - down_s > table.lies_s + 2
    yield Due("on-floor", kind, down_s + table.lies_s, ends_s, long)
    up = whole and up_s - down_s > 4 and last + 1 < len(low)
    yield Due("got-up", kind, up_s, ends_s, up)


def box(
    middle: tuple[float, float], width_m: float, depth_m: float
) -> tuple[tuple[float, float], ...]:
    """Return the corners of a rectangle of the floor."""
    (x, y), w, d = middle, width_m / 2, depth_m / 2
    return ((x - w, y - d), (x + w, y - d), (x + w, y + d), (x - w, y + d))


ZONES = (
    ZoneTable("bed", box(BED, 1.0, 2.1), height_m=BED_M),
    ZoneTable("sofa", box(SOFA, 1.9, 0.9), height_m=SOFA_M),
)


@dataclass
class Tally:
    """Counts of events found, missed and false in some recordings.

    Attributes:
        tried, found: events that were due, and those told, by kind and what they are of.
        delays_s: from when something is so until it was told, by kind.
        false: alarms without anything due, by kind.
        other: episodes that are no fall.
        hours: of recordings.
        missed: what was due and not told.
        took_s, slots: what following the people cost.
        joules: drawn by cameras that may sleep.
        asks: whether events ask for looks.
    """

    tried: Counter[tuple[str, str]] = field(default_factory=Counter)
    found: Counter[tuple[str, str]] = field(default_factory=Counter)
    delays_s: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    false: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    other: Counter[str] = field(default_factory=Counter)
    hours: float = 0.0
    missed: list[str] = field(default_factory=list)
    took_s: float = 0.0
    slots: int = 0
    joules: float = 0.0
    asks: bool = True

    def count(
        self,
        due: Sequence[Due],
        told: Sequence[PersonEvent],
        name: str,
        doing: Callable[[float], str] = lambda at_s: "moving",
    ) -> None:
        """Count what was due in a recording, and what was told of it."""
        for one in due:
            if not one.must:
                continue
            hits = sorted(event.time_ns / 1e9 - one.since_s for event in told if one.covers(event))
            self.tried[one.kind, one.what] += 1
            self.found[one.kind, one.what] += bool(hits)
            self.delays_s[one.kind] += hits[:1]
            if not hits:
                self.missed.append(f"{name}: no {one.kind} of {one.what} at {one.since_s:.1f} s")
        for event in told:
            if not any(one.covers(event, LATE_S) for one in due):
                at_s = event.time_ns / 1e9
                self.false[event.kind].append(
                    f"{name}: {event.kind} while {doing(at_s)} at {at_s:.1f} s"
                )


def told_in(
    recording: Recording, settings: ReplaySettings, zones: Sequence[ZoneTable], tally: Tally
) -> list[PersonEvent]:
    """Replay a recording and return the events told; they ask for looks if the tally says so."""
    table, told = EventsTable(), list[PersonEvent]()
    watch = begin_watch(table, recording.skeleton.joints, zones)
    asleep, selected = list[Flags](), list[Flags]()

    def asks() -> LookRequest:
        return looks_of(watch) if tally.asks else NO_REQUEST

    for record in replay(recording, settings, asks=asks):
        shown = Seen(record.slot, round(record.time_s * 1e9), record.people)
        began = time.thread_time()
        watch, events = advance(watch, shown)
        tally.took_s += time.thread_time() - began
        tally.slots += 1
        asleep.append(record.asleep_until > record.slot)
        selected.append(record.selected)
        told += [event for event in events if event.is_news or event.kind in ONCE]
    tally.hours += recording.num_slots / recording.fps / 3600
    if settings.rest_costs is not None:
        deep = settings.rest_costs.deep(np.array(asleep), recording.interval_s)
        drawn_w = settings.rest_costs.drawn_w(np.array(selected), deep)
        tally.joules += float(drawn_w.sum()) * recording.interval_s
    return told


def home(made: SceneSettings, seed: int, settings: ReplaySettings, tally: Tally) -> None:
    """Count what is told of a simulated home, and false alarms."""
    lives = lives_of(made, seed)
    lived = [episode for life in lives for episode in life.episodes]
    waves = waves_of([gesture for life in lives for gesture in life.gestures], made.seconds)
    recording = simulate(made, seed)
    told = told_in(recording, placed(settings, recording), ZONES, tally)
    name = f"{made.scene} {seed}"

    def doing(at_s: float) -> str:
        return ", ".join(e.kind for e in lived if e.start_s <= at_s <= e.stop_s + 1)

    tally.count([*due_of(lived, EventsTable(), made.seconds), *waves], told, name, doing)
    tally.other.update(episode.kind for episode in lived if episode.kind not in FALLS)


def placed(settings: ReplaySettings, recording: Recording) -> ReplaySettings:
    """Return settings for the cameras of a recording, which may sleep."""
    if settings.rest == AWAKE:
        return settings
    ids = recording.rig.camera_ids
    plan = EnergySettings().plan(ids, 1 / recording.fps, recording.battery_wh)
    return settings.for_rig(len(ids), plan)


def captured_people(tally: Tally) -> Iterator[str]:
    """Follow the people of motion capture as it has them, and yield the falls that are told."""
    for number, (kind, joints_m) in enumerate(captured(shared_folder())):
        watch, sigma_m = begin_watch(EventsTable(), COCO17.joints), np.full((1, 17), 0.02)
        for slot, pose_m in enumerate(joints_m):
            people = People(np.array([1]), pose_m[None], sigma_m=sigma_m)
            shown = Seen(slot, round(slot / 30 * 1e9), people)
            began = time.thread_time()
            watch, events = advance(watch, shown)
            tally.took_s += time.thread_time() - began
            yield from (
                f"{kind} {number} at {slot / 30:.1f} s" for event in events if event.kind == "fall"
            )
        tally.slots += len(joints_m)
        tally.hours += len(joints_m) / 30 / 3600


def motions(folder: Path, fps: float, settings: ReplaySettings, tally: Tally) -> None:
    """Count what is told of motion capture before simulated cameras."""
    with (folder / "falls.csv").open() as file:
        falls = list(csv.DictReader(file))
    detector = DetectorSettings(guessing=Guessing())
    for path in sorted(each for each in folder.iterdir() if each.is_dir()):
        motion = load_recording(path)
        assert motion.truth is not None
        joints_m = motion.truth.joints_m[:, 0]
        keep = downsampled(seen(joints_m, motion.fps, detector), fps)
        told = [e for e in told_in(keep, settings, (), tally) if e.kind == "fall"]
        due = [
            Due("fall", "recorded fall", float(row["down_s"]), float(row["up_s"]))
            for row in falls
            if row["motion"] == path.name
        ]
        tally.count(due, told, path.name)


def main() -> None:
    """Print a line for each recording or scene, and number of cameras."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenes", default="home-fall,home,home-play")
    parser.add_argument("--recordings", default="", help="folders, or motion-1, motion-2")
    parser.add_argument("--captured", action="store_true", help="motion capture as it is")
    parser.add_argument("--motions", type=Path, help="folder of motion capture")
    parser.add_argument("--seeds", default="0-3", help="FIRST-LAST; 900 and up are kept")
    parser.add_argument("--seconds", type=float, default=180.0)
    parser.add_argument("--people", type=int, help="by default as many as the scene has")
    parser.add_argument("--fps", type=float, default=12.5)
    parser.add_argument("--lead", type=int, default=4)
    parser.add_argument("--cameras", default="1,2,4")
    parser.add_argument("--watts", help="cameras sleep; in place of --cameras")
    parser.add_argument("--rest", action="store_true", help="cameras sleep with --cameras, too")
    parser.add_argument("--unasked", action="store_true", help="events ask for no looks")
    parser.add_argument("--show", action="store_true", help="list what was missed and false")
    options = parser.parse_args()
    first, _, last = options.seeds.partition("-")
    if options.captured:
        tally = Tally()
        tally.false["fall"] = list(captured_people(tally))
        print_lines("motion capture", tally, options.show)
    for goal, settings in goals(options):
        for name in filter(None, options.recordings.split(",")):
            tally = Tally(asks=not options.unasked)
            recording = made_of(name, options.fps, 60.0, 0)
            told = told_in(recording, placed(settings, recording), (), tally)
            for event in told:
                tally.false[event.kind].append(f"{event.kind} at {event.time_ns / 1e9:.1f} s")
            print_lines(f"{name}, {goal}", tally, options.show)
        if options.motions:
            tally = Tally(asks=not options.unasked)
            motions(options.motions, options.fps, settings, tally)
            print_lines(f"{options.motions}, {goal}", tally, options.show)
        for scene in filter(None, options.scenes.split(",")):
            tally = Tally(asks=not options.unasked)
            made = SceneSettings(
                scene=scene, seconds=options.seconds, fps=options.fps, people=options.people
            )
            for seed in track(range(int(first), int(last or first) + 1), transient=True):
                home(made, seed, settings, tally)
            print_lines(f"{scene}, {goal}", tally, options.show)


def goals(options: argparse.Namespace) -> Iterator[tuple[str, ReplaySettings]]:
    """Yield what is asked for in words, and its settings: watts, or cameras."""
    asked = ", unasked" if options.unasked else ""
    usual = ReplaySettings(lead_slots=options.lead)
    if options.watts:
        for watts in map(float, options.watts.split(",")):
            yield f"{watts:g} W{asked}", replace(usual, rest="asleep", watts=watts)
        return
    rest: RestChoice = "asleep" if options.rest else AWAKE
    rests = ", asleep" if options.rest else ""
    for cameras in map(float, options.cameras.split(",")):
        settings = replace(usual, rest=rest, num_selected=cameras)
        yield f"{cameras:g} cameras{rests}{asked}", settings


def print_lines(name: str, tally: Tally, show: bool) -> None:
    """Print what was found: a line for each kind of event, and what it is of."""
    milliseconds = 1e3 * tally.took_s / max(tally.slots, 1)
    drawn = f", {tally.joules / (3600 * tally.hours):.1f} W drawn" if tally.joules else ""
    print(f"{name}: {tally.hours:.2f} h, {milliseconds:.2f} ms of CPU a slot{drawn}")
    for (kind, what), tried in sorted(tally.tried.items()):
        found = tally.found[kind, what]
        low, high = interval(found, tried)
        print(f"    {kind}, {what}: {found} of {tried} ({low:.0f} to {high:.0f} %)")
    for kind, delays in sorted(tally.delays_s.items()):
        delays_s = np.array(delays or [np.nan])
        soon = f", within {SOON_S:g} s {(delays_s <= SOON_S).sum()}" if kind == "fall" else ""
        print(
            f"    {kind}: told after {np.median(delays_s):.1f} s "
            f"(95 %: {np.quantile(delays_s, 0.95):.1f}){soon}"
        )
    print(f"    episodes that are no fall: {dict(sorted(tally.other.items()))}")
    counts = {kind: len(alarms) for kind, alarms in sorted(tally.false.items())}
    most = rate_bound(counts.get("fall", 0)) / max(tally.hours, 1e-9)
    print(f"    false: {counts or 'none'}; false falls an hour: at most {most:.1f}", flush=True)
    alarms = [alarm for alarms in tally.false.values() for alarm in alarms]
    for line in (*tally.missed, *(f"false: {alarm}" for alarm in alarms)) if show else ():
        print("       ", line, flush=True)


def rate_bound(count: int) -> float:
    """Return the most events that so many that were seen do not rule out, 95 % (Poisson)."""
    return float(chi2.ppf(0.95, 2 * (count + 1)) / 2)


def interval(found: int, tried: int) -> tuple[float, float]:
    """Return the 95 % interval of a share, per cent (Wilson)."""
    if not tried:
        return 0.0, 100.0
    share, z2 = found / tried, 1.96**2
    middle = (share + z2 / (2 * tried)) / (1 + z2 / tried)
    half = np.sqrt(share * (1 - share) * z2 / tried + z2**2 / (4 * tried**2)) / (1 + z2 / tried)
    return 100 * float(middle - half), 100 * float(middle + half)


if __name__ == "__main__":
    main()
