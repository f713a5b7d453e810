"""How well falls are found, and what is taken for one.

    python lab/benchmarks/event_detection.py --seeds 0-9 --cameras 1,2,4 --fps 12.5 --lead 4
    python lab/benchmarks/event_detection.py --scenes "" --recordings PIZZA,SHELF --cameras 2
    python lab/benchmarks/event_detection.py --scenes "" --captured

Simulated homes: `home-fall` has falls of seven kinds (their kinematics: `simulate.episode_kinds`),
`home` and `home-play` have everything else that goes down, many times as often as life has it. A
fall is found when it is told before the person gets up. In recordings of real people nobody falls:
every alarm is false there.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.progress import track

from choice_of_cameras import made as made_of
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.events.people import Seen
from e3pose.events.watch import advance, begin_watch
from e3pose.model.person_event import PersonEvent
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording
from e3pose.settings.events_table import EventsTable
from e3pose.settings.site_file import ZoneTable
from e3pose.simulate.episode_kinds import BED_M, FALLS, SOFA_M
from e3pose.simulate.homes import BED, SOFA
from e3pose.simulate.settings import SceneSettings
from e3pose.simulate.simulation import episodes_of, simulate
from e3pose.site.event_sink import seen_in
from predictor_in_the_loop import captured

SOON_S = 1.0  # a fall may be told so long before the hips are down
LATE_S = 6.0  # falls so near to the end of a recording do not count
SLIDE = "slide-down"


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
    """What was found in some recordings.

    Attributes:
        falls, found: how many there were, and how many were told.
        slides, slides_found: the same of slow slides down a wall.
        delays_s: from the hips on the floor until the fall was told.
        false: alarms where nobody fell.
        other: episodes that are no fall.
        hours: of recordings.
        missed: falls that were not told.
        took_s, slots: what following the people cost.
    """

    falls: int = 0
    found: int = 0
    slides: int = 0
    slides_found: int = 0
    delays_s: list[float] = field(default_factory=list)
    false: list[str] = field(default_factory=list)
    other: int = 0
    hours: float = 0.0
    missed: list[str] = field(default_factory=list)
    took_s: float = 0.0
    slots: int = 0


def told_in(
    recording: Recording, settings: ReplaySettings, zones: Sequence[ZoneTable], tally: Tally
) -> list[PersonEvent]:
    """Replay a recording and return the falls that are told."""
    table, told = EventsTable(), list[PersonEvent]()
    watch = begin_watch(table, recording.skeleton.joints, zones)
    for record in replay(recording, settings):
        seen = seen_in(record, round(record.time_s * 1e9))
        began = time.thread_time()
        watch, events = advance(watch, seen)
        tally.took_s += time.thread_time() - began
        tally.slots += 1
        told += [event for event in events if event.kind == "fall"]
    tally.hours += recording.num_slots / recording.fps / 3600
    return told


def home(made: SceneSettings, seed: int, settings: ReplaySettings, tally: Tally) -> None:
    """Count the falls of a simulated home that are found, and false alarms."""
    lived = [episode for person in episodes_of(made, seed) for episode in person]
    told = told_in(simulate(made, seed), settings, ZONES, tally)
    for fall in (episode for episode in lived if episode.kind in FALLS):
        if fall.down_s > made.seconds - LATE_S:
            continue
        after_s = [e.time_ns / 1e9 - fall.down_s for e in told if e.time_ns / 1e9 < fall.stop_s]
        after_s = [delay_s for delay_s in after_s if delay_s > -SOON_S]
        if fall.kind == SLIDE:
            tally.slides += 1
            tally.slides_found += bool(after_s)
            continue
        tally.falls += 1
        tally.found += bool(after_s)
        tally.delays_s += sorted(after_s)[:1]
        if not after_s:
            tally.missed.append(f"{made.scene} {seed} {fall.kind} at {fall.down_s:.1f} s")
    tally.other += sum(episode.kind not in FALLS for episode in lived)
    for event in told:
        at_s = event.time_ns / 1e9
        if not any(e.kind in FALLS and e.start_s < at_s < e.stop_s for e in lived):
            doing = [e.kind for e in lived if e.start_s <= at_s <= e.stop_s + 1]
            tally.false.append(f"{made.scene} {seed} {', '.join(doing)} at {at_s:.1f} s")


def captured_people(tally: Tally) -> Iterator[str]:
    """Follow the people of motion capture as it has them, and yield the falls that are told."""
    for number, (kind, joints_m) in enumerate(captured(Path(os.environ["E3POSE_SHARED"]))):
        watch, sigma_m = begin_watch(EventsTable(), COCO17.joints), np.full((1, 17), 0.02)
        for slot, pose_m in enumerate(joints_m):
            shown = Seen(slot, round(slot / 30 * 1e9), np.array([1]), pose_m[None], sigma_m)
            began = time.thread_time()
            watch, events = advance(watch, shown)
            tally.took_s += time.thread_time() - began
            yield from (
                f"{kind} {number} at {slot / 30:.1f} s" for event in events if event.kind == "fall"
            )
        tally.slots += len(joints_m)
        tally.hours += len(joints_m) / 30 / 3600


def main() -> None:
    """Print a line for each recording or scene, and number of cameras."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenes", default="home-fall,home,home-play")
    parser.add_argument("--recordings", default="", help="folders, or motion-1, motion-2")
    parser.add_argument("--captured", action="store_true", help="motion capture as it is")
    parser.add_argument("--seeds", default="0-3", help="FIRST-LAST; 900 and up are kept")
    parser.add_argument("--seconds", type=float, default=180.0)
    parser.add_argument("--fps", type=float, default=12.5)
    parser.add_argument("--lead", type=int, default=4)
    parser.add_argument("--cameras", default="1,2,4")
    parser.add_argument("--show", action="store_true", help="list what was missed and false")
    options = parser.parse_args()
    first, _, last = options.seeds.partition("-")
    if options.captured:
        tally = Tally()
        tally.false = list(captured_people(tally))
        print_line("motion capture", tally, options.show)
    for cameras in options.cameras.split(","):
        settings = ReplaySettings(num_selected=float(cameras), lead_slots=options.lead)
        for name in filter(None, options.recordings.split(",")):
            tally = Tally()
            recording = made_of(name, options.fps, 60.0, 0)
            told = told_in(recording, settings, (), tally)
            tally.false = [f"at {event.time_ns / 1e9:.1f} s" for event in told]
            print_line(f"{name}, {cameras} cameras", tally, options.show)
        for scene in filter(None, options.scenes.split(",")):
            tally, made = (
                Tally(),
                SceneSettings(scene=scene, seconds=options.seconds, fps=options.fps),
            )
            for seed in track(range(int(first), int(last or first) + 1), transient=True):
                home(made, seed, settings, tally)
            print_line(f"{scene}, {cameras} cameras", tally, options.show)


def print_line(name: str, tally: Tally, show: bool) -> None:
    """Print what was found."""
    low, high = interval(tally.found, tally.falls)
    delays_s = np.array(tally.delays_s or [np.nan])
    print(
        f"{name}: {tally.found} of {tally.falls} falls ({low:.0f} to {high:.0f} %), "
        f"{tally.slides_found} of {tally.slides} slides, told after {np.median(delays_s):.1f} s "
        f"(95 %: {np.quantile(delays_s, 0.95):.1f}); {len(tally.false)} false alarms in "
        f"{tally.other} other episodes, {tally.hours:.2f} h; "
        f"{1e3 * tally.took_s / max(tally.slots, 1):.2f} ms of CPU a slot",
        flush=True,
    )
    for line in (*tally.missed, *(f"false: {alarm}" for alarm in tally.false)) if show else ():
        print("   ", line)


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
