"""A day of a lab, compressed: joules, batteries, and how soon newcomers are found.

    python lab/benchmarks/day.py --scene ring --seconds 240 --seeds 711
    python lab/benchmarks/day.py --recordings shelf,pizza --lead 2,4

    python lab/benchmarks/day.py --recordings pizza --share 0.5 --sets 0123,0234

Of a simulated day, people are there for `--busy` of the time: visits of one to four of them, who
come in through the doors and leave again. A row of the table is a way to run the cameras: all of
them; the published system with 3 of 5; two per slot as today; two per slot and rests; and the same
with an oracle for whom to keep awake, which wakes cameras at once and without a loss. Watts are a
profile's with a suspended rest: `SUSPENDED`, which is assumed, where it states none. A newcomer is
found when a published pose is within 0.5 m, in seconds since two cameras could see the person.
Of `--recordings`, which are folders, people are there throughout; without a truth, errors are those
from the offline smoother over all cameras (`clip_error.py`). With `--sets` the same cameras are
awake throughout, two of them per slot: error, and times that of all, as found, as a plan of rests
expects it while all are awake, and as the estimator states it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from clip_error import references
from e3pose.base.arrays import Flags, Floats
from e3pose.energy.modes import Rest
from e3pose.energy.profiles import load_profile, modes_of
from e3pose.energy.rest_costs import RestCosts, rest_costs
from e3pose.evaluate.noise.calibrate import first_slots
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import accuracy
from e3pose.evaluate.waking import drawn_w
from e3pose.model.noises import detector_of, load_noise
from e3pose.recording import Recording, load_recording
from e3pose.recording.record import Truth
from e3pose.select import awake, rest_plan
from e3pose.select.rest_needs import needs_of
from e3pose.select.stated_error import stated_error_m
from e3pose.simulate import SCENES, SceneSettings, simulate
from e3pose.simulate.activities import Play, _Task

FPS = 12.5
PEOPLE = 4
VISIT_S = (10.0, 22.0)
LEAVING_S = 3.0  # to the door
FOUND_M = 0.5
BATTERY_WH = 50.0
SUSPENDED = Rest("suspended", 0.5, 0.5, 1.0, 0.2, "assumed")
WARMUP_SLOTS = 10
NEVER_S = 1e9
RESTS = 1  # layout: of `ways`
LIMIT_SHARE = 0.6  # of the power of two cameras per slot, all awake


def visits(seconds: float, busy: float, rng: np.random.Generator) -> list[tuple[float, float, int]]:
    """Return start, end and number of people of visits that take a share `busy` of the time."""
    found: list[tuple[float, float, int]] = []
    total_s, at_s = busy * seconds, 0.0
    lengths: list[float] = []
    while sum(lengths) < total_s - VISIT_S[0] / 2:
        lengths.append(float(rng.uniform(*VISIT_S)))
    lengths = [length * total_s / sum(lengths) for length in lengths]
    gaps = rng.uniform(0.5, 1.5, len(lengths) + 1)
    gaps *= (seconds - total_s) / gaps.sum()
    for gap_s, length_s in zip(gaps, lengths, strict=False):
        begin_s = at_s + float(gap_s)
        found.append((begin_s, begin_s + length_s, int(rng.integers(1, PEOPLE + 1))))
        at_s = begin_s + length_s
    return found


def visiting(plan: Sequence[tuple[float, float, int]]) -> type[Play]:
    """Return a play whose people come and go with the visits."""

    class Visits(Play):
        def next_visit(self, person: int, time_s: float) -> float:
            starts = [b for b, e, people in plan if person < people and e > time_s + 4.0]
            return max(starts[0], time_s) + 0.7 * person if starts else NEVER_S

        def _begin(self) -> None:
            for person in range(len(self.tasks)):
                self.tasks[person] = _Task("away", self.next_visit(person, 0.0))

        def ends(self, person: int, task: _Task, time_s: float) -> bool:
            leaves = task.kind == "away" or (task.kind == "walk" and ("away", 0.0) in task.then)
            if leaves or self.group.own_seat[person] >= 0:
                return False
            left_s = time_s + LEAVING_S
            return not any(b <= left_s < e for b, e, people in plan if person < people)

        def _finished(self, person: int, task: _Task, time_s: float) -> bool:
            return self.ends(person, task, time_s) or super()._finished(person, task, time_s)

        def _next(self, person: int, task: _Task, time_s: float) -> _Task:
            if not self.ends(person, task, time_s):
                return super()._next(person, task, time_s)
            exits = self.exits
            door = exits[np.hypot(*(exits - self.group.xy[person]).T).argmin()]
            return self._walk(person, time_s, door, [("away", 0.0)], stops=False)

        def _walk_off(self, person: int, time_s: float, late: bool) -> _Task:
            task = super()._walk_off(person, time_s, late)
            if task.kind == "away":
                task.until_s = self.next_visit(person, time_s)
            return task

    return Visits


def day(scene: str, seconds: float, busy: float, seed: int) -> Recording:
    """Simulate a day."""
    plan = visits(seconds, busy, np.random.default_rng([seed, 3]))
    fps = FPS if SCENES[scene].fps > FPS else None
    settings = SceneSettings(scene=scene, seconds=seconds, fps=fps, people=PEOPLE)
    with patch("e3pose.simulate.simulation.Play", visiting(plan)):
        return simulate(settings, seed)


@dataclass(frozen=True, slots=True)
class Way:
    """A way to run the cameras."""

    name: str
    settings: ReplaySettings
    oracle: bool = False


def ways(lead: int, seed: int, costs: RestCosts) -> list[Way]:
    """Return the rows of the table."""
    base = ReplaySettings(lead_slots=lead, seed=seed % 1000, phase=seed % 1000)
    rests = replace(base, rest="suspended", rest_costs=costs)
    free = replace(
        costs, enter_s=0 * costs.enter_s, wake_s=0 * costs.wake_s, wake_sd_s=0 * costs.wake_sd_s
    )
    num_cameras = len(costs.idle_w)
    limit_w = LIMIT_SHARE * float(costs.idle_w.sum() + 2 * costs.look_w.mean())
    return [
        Way("two, awake (today)", replace(base, num_selected=2.0)),
        Way("two, with rests", replace(rests, num_selected=2.0)),
        Way(f"rests, {LIMIT_SHARE:.0%} of today's power", replace(rests, watts=limit_w)),
        Way(
            "oracle of who is awake", replace(rests, num_selected=2.0, rest_costs=free), oracle=True
        ),
        Way(
            "E3Pose, 3 of 5",
            replace(base, pipeline="paper", num_selected=float(round(3 / 5 * num_cameras))),
        ),
        Way("all cameras", replace(base, policy="all")),
    ]


def run(recording: Recording, way: Way) -> list[Any]:
    """Replay; the oracle plans in every slot, with every camera within reach."""
    if not way.oracle:
        return list(replay(recording, way.settings))
    slot_s, planned = recording.interval_s, awake.RestPlanner.planned

    def at_once(planner: Any, memory: Any, situation: Any, *others: Any) -> Any:
        """Plan without waiting for the look of a camera that woke."""
        looked = replace(situation, unseen_slots=np.zeros_like(situation.unseen_slots))
        return planned(planner, memory, looked, *others)

    with (
        patch.object(awake.RestPlanner, "planned", at_once),
        patch.object(rest_plan, "FIRST_REST_S", slot_s),
        patch.object(rest_plan, "LONGEST_REST_S", slot_s),
        patch.object(rest_plan, "EMPTY_REST_S", slot_s),
        patch.object(rest_plan, "STAGGER", 0.0),
        patch.object(awake, "PLAN_S", slot_s),
    ):
        return list(replay(recording, way.settings))


def set_lines(recording: Recording, settings: ReplaySettings, sets: Sequence[Flags]) -> list[str]:
    """Return what it costs that only sets of cameras are awake."""
    everybody = np.ones(len(recording.rig), dtype=bool)
    tried, rises = np.stack([everybody, *sets]), list[Floats]()

    def found(awake_set: Flags) -> tuple[Any, Any, float]:
        def planned(
            planner: awake.RestPlanner, memory: Any, situation: Any, until: Any, later: Any, _: Any
        ) -> Any:
            ahead = [later(seconds) for seconds in awake.LATER_S]
            if awake_set.all():
                rises.append(needs_of(planner.rig, situation, ahead, ~everybody).rise(tried))
            return replace(memory, num_selected=2.0), np.where(awake_set, 0, 10**6)

        with patch.object(awake.RestPlanner, "planned", planned):
            records = list(replay(recording, settings))
        stated_m = [stated_error_m(each.covariance_m2) for each in records[WARMUP_SLOTS:]]
        result = accuracy(recording, records)
        return result.mpjpe_mm, result.recall_500mm, 1000 * float(np.nanmean(stated_m))

    lines = [
        "| awake | error, mm | recall, % | times | planned | stated |",
        "|---|---|---|---|---|---|",
    ]
    all_mm, _, all_stated_mm = found(everybody)
    known = [rise for rise in rises if np.isfinite(rise).all()]
    for cameras, planned in zip(tried, np.mean(known, axis=0), strict=True):
        error_mm, recall, stated_mm = found(cameras)
        name = "".join(map(str, np.flatnonzero(cameras)))
        ratios = f"{error_mm / all_mm:.2f} | {planned:.2f} | {stated_mm / all_stated_mm:.2f}"
        lines.append(f"| {name} | {error_mm:.1f} | {100 * recall:.1f} | {ratios} |")
    return lines


def seconds_until_found(recording: Recording, records: Sequence[Any]) -> list[float]:
    """Return the seconds from when two cameras could see a newcomer to the first pose nearby."""
    truth = recording.truth
    if truth is None:
        return []
    joints_m = truth.joints_m
    waits: list[float] = []
    for person in range(joints_m.shape[1]):
        body_m = _middle_m(joints_m[:, person])
        views = np.sum([c.sees(body_m) for c in recording.rig.cameras], axis=0)
        there = np.isfinite(body_m).all(axis=1) & (views >= 2)
        edges = np.diff(np.concatenate([[0], there.astype(np.int64), [0]]))
        begins, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
            if begin < 2 * WARMUP_SLOTS or (end - begin) * recording.interval_s < 2.0:
                continue  # who was there before it began, or only passed
            if begin and np.isfinite(joints_m[max(begin - 25, 0) : begin, person]).any():
                seen = there[max(begin - 25, 0) : begin].any()
                if seen:
                    continue  # the same visit, out of sight for a moment
            waits.append(_wait_s(recording, records, body_m, begin, end))
    return waits


def _middle_m(joints_m: Floats) -> Floats:
    """Return `(num_slots, 3)`: means of the known joints; NaN where none is."""
    known = np.isfinite(joints_m).all(axis=2, keepdims=True)
    count = known.sum(axis=1)
    return np.asarray(np.where(known, joints_m, 0).sum(axis=1) / np.where(count, count, np.nan))


def _wait_s(
    recording: Recording, records: Sequence[Any], body_m: Floats, begin: int, end: int
) -> float:
    for slot in range(begin, end):
        people_m = (
            np.nanmean(records[slot].poses.joints_m, axis=1)
            if len(records[slot].poses)
            else np.zeros((0, 3))
        )
        if len(people_m) and np.linalg.norm(people_m - body_m[slot], axis=-1).min() < FOUND_M:
            return (slot - begin) * recording.interval_s
    return (end - begin) * recording.interval_s


def with_truth(recording: Recording) -> Recording:
    """Return a recording whose truth is the smoother over all cameras, if it has none."""
    if recording.truth is not None:
        return recording
    people = references(recording, load_noise(detector_of(recording)))
    joints_m = np.stack([[p.at(slot) for p in people] for slot in range(recording.num_slots)])
    names = tuple(f"person{number}" for number in range(1, len(people) + 1))
    return replace(recording, truth=Truth(recording.skeleton, names, joints_m))


def part_of(recording: Recording, share: float) -> Recording:
    """Return a share of a recording, from its start; less than all of it is without a truth."""
    if share == 1:
        return recording
    return first_slots(recording, round(share * recording.num_slots))


def costs_of(profile_name: str, num_cameras: int) -> RestCosts:
    """Return what a rig of a profile draws."""
    profile = load_profile(profile_name)
    rest = modes_of(profile).rest("suspended") or SUSPENDED
    active, idle = (profile.watts(mode) for mode in ("active", "power-saving"))
    return rest_costs([active] * num_cameras, [idle] * num_cameras, [rest] * num_cameras)


def row(recording: Recording, way: Way, costs: RestCosts, lead: int) -> dict[str, Any]:
    """Replay once and return the figures."""
    records = run(recording, way)
    found = accuracy(recording, records)
    used = way.settings.rest_costs or costs
    begin = WARMUP_SLOTS + lead
    drawn = drawn_w(records, lead, used, recording.interval_s)[begin:]
    selected = np.stack([record.selected for record in records])[begin:]
    truth = recording.truth
    busy: Flags = np.ones(len(drawn), dtype=bool)
    if truth is not None and recording.name.startswith("simulated"):
        busy = np.asarray(np.isfinite(truth.joints_m[begin:, :, 0, 0]).any(axis=1))
    return {
        "name": way.name,
        "watts": float(drawn.mean()),
        "busy_w": float(drawn[busy].mean()) if busy.any() else np.nan,
        "empty_w": float(drawn[~busy].mean()) if (~busy).any() else np.nan,
        "active": float(selected.sum(axis=1).mean()),
        "error_mm": found.mpjpe_mm,
        "recall": found.recall_500mm,
        "pcp": None if found.pcp is None else found.pcp.actors["average"],
        "waits_s": seconds_until_found(recording, records),
    }


def head() -> str:
    """Return the head of a table in Markdown."""
    names = (
        "cameras", "error, mm", "recall, %", "PCP", "W per camera", "there", "nobody", "looks",
        "Wh a day", "days on 50 Wh", "found after, s: median; 95 % (of)",
    )  # fmt: skip
    return f"| {' | '.join(names)} |\n|{'---|' * len(names)}"


def line(same: Sequence[dict[str, Any]]) -> str:
    """Return a row of the table: means over recordings; waits are of all newcomers."""
    mean = {key: _mean([each[key] for each in same]) for key in same[0] if key != "name"}
    waits = [wait for each in same for wait in each["waits_s"]]
    late = f"{np.median(waits):.2f}; {np.percentile(waits, 95):.2f} ({len(waits)})" if waits else ""
    wh = 24 * mean["watts"]
    cells = [
        same[0]["name"],
        f"{mean['error_mm']:.1f}",
        f"{100 * mean['recall']:.1f}",
        f"{mean['pcp']:.2f}",
        f"{mean['watts']:.2f}",
        f"{mean['busy_w']:.2f}",
        f"{mean['empty_w']:.2f}",
        f"{mean['active']:.2f}",
        f"{wh:.0f}",
        f"{BATTERY_WH / wh:.2f}",
        late,
    ]
    return "| " + " | ".join(cells).replace("nan", "") + " |"


def _mean(values: Sequence[Any]) -> float:
    known = [v for v in values if v is not None and not isinstance(v, list) and np.isfinite(v)]
    return float(np.mean(known)) if known else np.nan


def main() -> None:
    """Print a table for every scene or recording, and lead."""
    from rich.progress import track

    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scene", default="ring", help="simulated days of it; several with commas")
    parser.add_argument("--recordings", default="", help="folders, in place of days; with commas")
    parser.add_argument("--seconds", type=float, default=240.0)
    parser.add_argument("--busy", type=float, default=0.2, help="share of the time with people")
    parser.add_argument("--seeds", default="711")
    parser.add_argument("--lead", default="4", help="slots ahead; several with commas")
    parser.add_argument("--profile", default="xavier-nx")
    parser.add_argument("--share", type=float, default=1.0, help="of recordings, from their start")
    parser.add_argument("--sets", default="", help="cameras awake throughout, such as 012,0134")
    parser.add_argument("--ways", default="", help="numbers of rows to run; all by default")
    options = parser.parse_args()
    folders = [Path(each) for each in options.recordings.split(",") if each]
    seeds = [int(each) for each in options.seeds.split(",")]
    wanted = [int(each) for each in options.ways.split(",") if each]
    for place in folders or options.scene.split(","):
        recordings = [
            with_truth(part_of(load_recording(place), options.share))
            if isinstance(place, Path)
            else day(place, options.seconds, options.busy, seed)
            for seed in seeds
        ]
        costs = costs_of(options.profile, len(recordings[0].rig))
        for lead in map(int, options.lead.split(",")):
            rate = 1 / recordings[0].interval_s
            print(f"\n`{place}`, {rate:g} slots per second, lead {lead}\n", flush=True)
            asked = [ways(lead, seed, costs) for seed in seeds]
            if options.sets:
                cameras = np.arange(len(recordings[0].rig))
                sets = [np.isin(cameras, list(map(int, each))) for each in options.sets.split(",")]
                print("\n".join(set_lines(recordings[0], asked[0][RESTS].settings, sets)))
                continue
            print(head(), flush=True)
            numbers = wanted or range(len(asked[0]))
            quiet = not sys.stderr.isatty()
            for number in track(numbers, f"{place}, lead {lead}", disable=quiet):
                pairs = zip(recordings, asked, strict=True)
                found = [row(each, several[number], costs, lead) for each, several in pairs]
                print(line(found), flush=True)


if __name__ == "__main__":
    main()
