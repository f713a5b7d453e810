"""How much can choosing cameras give? Selections that know more than a policy can.

    python lab/benchmarks/oracle_choice.py --seeds 701,702 --counts 2 --rows information,greedy

`positions`, `detections`, `noise` and `errors` are the policy `information` with the truth about
the slot it decides: where people are; which joints each camera shows, and with which score; how far
its keypoints are off; how far the estimate of each joint would be off. `greedy`, `ahead` and `beam`
try all sets of cameras with the detections that they will give, and take the one of least true
error: in the slot, with two more slots of cameras in turn, or in all slots so far of the best few
histories. They know the noise of detections that are still to come. `redrawn` does not: it takes
the set of least mean error over draws of the noise, and is judged, like `plain` (the policy), on
other draws. Gains over round robin, in percent of the mean error of people who are found. For a
real recording, `--scenes FOLDER`, the truth is the smoother over all cameras, shoulders to knees,
as in `choice_of_cameras.py`; rows with truth and redrawn ones have no meaning there.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from adaptive_choice import ADAPTIVE, FPS, SECONDS, SPREAD

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Figures = tuple[float, float, float]  # gain, gain with errors cut, recall beyond round robin's

# Without `unequal-batteries`, where an oracle would have to plan energy.
SCENES = (
    "two-rooms", "l-hall", "shaft", "one-sided", "poor-view", "dying-cameras", "slow", "ring",
    "pillar",
)  # fmt: skip
WITH_TRUTH = (ADAPTIVE, "positions", "detections", "noise", "errors")
# How many slots are tried on, with cameras in turn, and how many histories are kept.
TRIED = {"greedy": (0, 1), "ahead": (2, 1), "beam": (0, 6)}
REDRAWN = ("plain", "redrawn")
DRAWS, JUDGES = 10, 4  # of the noise, to select on and to judge on
CUT_M = 0.1  # gains swing less where no person counts as more off: a lost one is 300 mm off
MISS_M = 0.5  # an estimate this far off is of somebody else
NEAR = 0.3  # of a person's height in the image: a detection this near is of the person
LEAST_SHARE = 0.1  # of the expected variance, for keypoints that happen to be exact
UPPER = np.triu_indices(3)


@dataclass
class Teller:
    """An estimator that notes whom its tracks are of, and expects people where they will be.

    Attributes:
        inner: the estimator.
        recording: with its truth.
        ahead: slots.
        positions: whether it knows where people will be.
        slot: that the newest outlook is of.
        people: `(num_tracks,)` whom the tracks of the newest outlook are of; -1 for nobody.
        off_m: `(num_tracks, num_joints, 3)` how far it is off.
    """

    inner: Any
    recording: Any
    ahead: int
    positions: bool
    slot: int = 0
    people: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    off_m: Floats = field(default_factory=lambda: np.zeros(0))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    def outlook(self, memory: Any, ahead_s: float) -> Any:
        """See `Estimator.outlook`."""
        truth_m = self.recording.truth.joints_m
        now = round(memory.belief.time_s / self.recording.interval_s)
        self.slot = min(now + self.ahead, len(truth_m) - 1)
        expected = self.inner.outlook(memory, ahead_s)
        apart_m = distances_m(memory.belief.state[..., :3], truth_m[now])
        self.people = np.where(apart_m.min(axis=1) < MISS_M, apart_m.argmin(axis=1), -1)
        true_m = np.where(
            (self.people >= 0)[:, None, None], truth_m[self.slot][self.people], np.nan
        )
        self.off_m = expected.joints_m - true_m
        if not self.positions:
            return expected
        known = np.isfinite(true_m).all(axis=(1, 2), keepdims=True)
        return replace(expected, joints_m=np.where(known, true_m, expected.joints_m))


@dataclass(frozen=True, slots=True)
class WithTruth:
    """The policy with the true views of the slot, or the true errors of the estimate."""

    inner: Any
    teller: Teller
    what: str

    def select(self, situation: Any) -> Flags:
        """See `Policy.select`."""
        foresight, teller = situation.foresight, self.teller
        if self.what == "errors":
            foresight = replace(foresight, prior=self._prior(foresight.prior))
        else:
            shown = shown_joints(teller.recording, self.what == "noise")[teller.slot]
            views = foresight.views.copy()
            for track in np.flatnonzero(teller.people >= 0):
                views[:, track] = shown[:, teller.people[track]]
            foresight = replace(foresight, views=views)
        return np.asarray(self.inner.select(replace(situation, foresight=foresight)))

    def _prior(self, prior: Floats) -> Floats:
        """Put 0.7 of the actual squared error and 0.3 of the expected one together."""
        matrices = np.zeros((*prior.shape[:-1], 3, 3))
        matrices[..., UPPER[0], UPPER[1]] = matrices[..., UPPER[1], UPPER[0]] = prior
        off_m = self.teller.off_m
        squares = 0.7 * off_m[..., :, None] * off_m[..., None, :] + 0.3 * np.linalg.inv(matrices)
        known = np.isfinite(squares).all(axis=(-1, -2))
        matrices[known] = np.linalg.inv(squares[known])
        return np.ascontiguousarray(matrices[..., UPPER[0], UPPER[1]])


def distances_m(people_m: Floats, truth_m: Floats) -> Floats:
    """Return `(num_people, num_actors)` mean distances of joints; inf from who is not there."""
    apart_m = np.linalg.norm(people_m[:, None] - truth_m[None], axis=-1)
    known = np.isfinite(apart_m)
    total_m = np.where(known, apart_m, 0.0).sum(axis=-1)
    number = known.sum(axis=-1)
    return np.where(number > 0, total_m / np.maximum(number, 1), np.inf)


@lru_cache(maxsize=2)
def shown_joints(recording: Any, errors: bool) -> Floats:
    """Return the information of all detections, `(num_slots, num_cameras, num_actors, joints, 6)`.

    Matrices are their upper entries, in 1/m2; 0 for joints that are not shown. With `errors` the
    variance of a keypoint is how far it is off, squared.
    """
    from e3pose.model.noises import detector_of, load_noise

    truth_m = recording.truth.joints_m
    noise = load_noise(detector_of(recording))
    shown = np.zeros((len(truth_m), len(recording.rig), *truth_m.shape[1:3], 6))
    for index, camera in enumerate(recording.rig.cameras):
        sigma = noise.in_images_of(max(camera.image_size))
        pixels, squares_m2 = camera.project(truth_m), _slopes_squared(camera, truth_m)
        for slot, person in zip(*np.nonzero(np.isfinite(pixels).all(axis=(2, 3))), strict=True):
            view, at = recording.view(slot, index), pixels[slot, person]
            if view is None or not len(view):
                continue
            seen = np.isfinite(view.keypoints_px[..., 0])
            squares = ((view.keypoints_px - at) ** 2).sum(axis=-1)
            off = np.where(seen, np.sqrt(squares), 0.0).sum(axis=-1) / np.maximum(seen.sum(-1), 1)
            mine = int(off.argmin())
            if off[mine] < NEAR * np.ptp(at[:, 1]):
                variance = sigma.of(view.scores[mine]) ** 2
                if errors:
                    variance = np.maximum(squares[mine] / 2, LEAST_SHARE * variance)
                weight = np.where(seen[mine], 1 / variance, 0.0)
                shown[slot, index, person] = squares_m2[slot, person] * weight[:, None]
    return shown


def _slopes_squared(camera: Any, points_m: Floats) -> Floats:
    """Return the upper entries of J' J, `(*batch, 6)`, J the derivative of the projection."""
    x, y, z = np.moveaxis(points_m @ camera.R.T + camera.t, -1, 0)
    zero = np.zeros_like(z)
    slopes = np.stack([1 / z, zero, -x / z**2, zero, 1 / z, -y / z**2], axis=-1)
    slopes = camera.K[:2, :2] @ slopes.reshape(*z.shape, 2, 3) @ camera.R
    squares = np.swapaxes(slopes, -1, -2) @ slopes
    return np.asarray(squares[..., UPPER[0], UPPER[1]])


@dataclass(frozen=True, slots=True)
class Run:
    """A recording and how it is replayed."""

    recording: Any
    count: int
    seed: int
    lead: int

    def pipeline(self, policy: str, lead: int) -> Any:
        from e3pose.evaluate.replay import ReplaySettings, make_pipeline

        own = self.seed % 1000
        settings = ReplaySettings(
            policy=policy, num_selected=self.count, seed=own, phase=own, lead_slots=lead
        )
        return make_pipeline(self.recording, settings)

    def online(self, slot: int) -> Flags:
        from e3pose.evaluate.faults import deaths_s

        gone_s = deaths_s(self.recording, ())
        return np.asarray(slot * self.recording.interval_s < gone_s - 1e-9)

    def step(self, pipeline: Any, state: Any, slot: int, chosen: Flags | None = None) -> Any:
        """Return the next state and the record of a slot with the cameras ordered, or `chosen`."""
        from e3pose.evaluate.replay import selected_views
        from e3pose.pipeline import step

        if chosen is not None:
            state = replace(state, selections=chosen[None])
        online = self.online(slot)
        views = selected_views(self.recording, slot, state.selections[0] & online)
        return step(pipeline, state, views, online)

    def sets(self, slot: int) -> list[Flags]:
        """Return all sets of cameras that may be chosen."""
        online = np.flatnonzero(self.online(slot))
        cameras = np.arange(len(self.recording.rig))
        count = min(self.count, len(online))
        return [np.isin(cameras, each) for each in combinations(online.tolist(), count)]

    def errors_m(self, record: Any) -> Floats:
        """Return how far the nearest estimate is from each person of the slot, `MISS_M` at most."""
        truth_m = self.recording.truth.joints_m[record.slot]
        truth_m = truth_m[np.isfinite(truth_m).any(axis=(-1, -2))]
        apart_m = distances_m(record.poses.joints_m, truth_m)
        return np.asarray(apart_m.min(axis=0, initial=MISS_M))


def in_order(run: Run, pipeline: Any, chosen: Sequence[Flags] | None = None) -> list[Floats]:
    """Replay; return the errors of every slot."""
    from e3pose.pipeline import initial_state

    state, errors = initial_state(pipeline), []
    for slot in range(run.recording.num_slots):
        state, record = run.step(pipeline, state, slot, None if chosen is None else chosen[slot])
        errors.append(run.errors_m(record))
    return errors


def with_truth(run: Run, what: str) -> list[Floats]:
    """Replay with the policy `information`, which knows the truth of `what`."""
    pipeline = run.pipeline(ADAPTIVE, run.lead)
    teller = Teller(pipeline.estimator, run.recording, run.lead, what == "positions")
    policy: Any = pipeline.policy
    if what in ("detections", "noise", "errors"):
        policy = WithTruth(policy, teller, what)
    return in_order(run, replace(pipeline, estimator=teller, policy=policy))


def tried(run: Run, ahead: int, kept: int) -> list[Floats]:
    """Replay with the sets of cameras of least true error (`TRIED`)."""
    from e3pose.pipeline import initial_state

    pipeline, last = run.pipeline(SPREAD, 1), run.recording.num_slots
    histories: list[tuple[float, Any, tuple[Floats, ...]]] = [(0.0, initial_state(pipeline), ())]
    for slot in range(last):
        found = []
        for total_m, state, errors in histories:
            for chosen in run.sets(slot) if slot >= pipeline.warmup_slots else (None,):
                after, record = run.step(pipeline, state, slot, chosen)
                mine = run.errors_m(record)
                so_far_m, trial, later_m = total_m + mine.sum(), after, 0.0
                for later in range(slot + 1, min(slot + 1 + ahead, last)):
                    trial, record = run.step(pipeline, trial, later)
                    later_m += run.errors_m(record).sum()
                found.append((so_far_m + later_m, (so_far_m, after, (*errors, mine))))
        found.sort(key=lambda each: each[0])
        histories = [history for _, history in found[:kept]]
    return list(histories[0][2])


def redraw(scene: str, seed: int, draw: int) -> Any:
    """Simulate a scene with other keypoint noise: motion, scores and misses are the same."""
    from e3pose.simulate import detections

    drawn: Callable[..., Floats] = detections._errors

    def errors(*arguments: Any) -> Floats:
        *others, rng = arguments
        return drawn(*others, np.random.default_rng([draw, int(rng.integers(2**31))]))

    with patch.object(detections, "_errors", errors):
        return recorded(scene, seed)


def redrawn(runs: Sequence[Run]) -> list[Flags]:
    """Return for every slot the cameras of least mean error over draws of the noise."""
    from e3pose.pipeline import initial_state

    pipelines = [run.pipeline(SPREAD, 1) for run in runs]
    states, chosen = [initial_state(each) for each in pipelines], []
    for slot in range(runs[0].recording.num_slots):
        warm = slot >= pipelines[0].warmup_slots
        best_m, best, afters = np.inf, np.ones(len(runs[0].recording.rig), dtype=bool), states
        for each in runs[0].sets(slot) if warm else [best]:
            total_m, trials = 0.0, []
            for run, pipeline, state in zip(runs, pipelines, states, strict=True):
                after, record = run.step(pipeline, state, slot, each)
                total_m += run.errors_m(record).sum()
                trials.append(after)
                if total_m >= best_m:
                    break
            else:
                best_m, best, afters = total_m, each, trials
        states = afters
        chosen.append(best)
    return chosen


def recorded(scene: str, seed: int) -> Any:
    from choice_of_cameras import recorded as is_folder
    from e3pose.simulate import SCENES as ALL
    from e3pose.simulate import SceneSettings, simulate

    if is_folder(scene):
        return smoothed(scene)
    fps = FPS if ALL[scene].fps > FPS else None
    return simulate(SceneSettings(scene=scene, seconds=SECONDS, fps=fps), seed)


@lru_cache(maxsize=1)
def smoothed(folder: str) -> Any:
    """Read a recording; its truth becomes what the smoother over all cameras says of ten joints."""
    from choice_of_cameras import settings_of
    from e3pose.evaluate.held_out import COMPARED
    from e3pose.evaluate.replay import replay
    from e3pose.evaluate.smoothed import smooth_records
    from e3pose.recording import Truth, load_recording

    recording = load_recording(Path(folder))
    posteriors: list[Any] = []
    everybody = settings_of("all", len(recording.rig), 1, 0)

    def keep(people: Any) -> None:
        posteriors.append(people.posterior)

    records = list(replay(recording, everybody, publish=keep))
    late = smooth_records(records, posteriors, recording.skeleton)
    ids = sorted({track for record in late for track in record.track_ids.tolist()})
    joints_m = np.full((recording.num_slots, len(ids), len(recording.skeleton), 3), np.nan)
    columns = [recording.skeleton.index(joint) for joint in COMPARED]
    for record in late:
        rows = np.searchsorted(ids, record.track_ids)
        joints_m[record.slot, rows[:, None], columns] = record.poses.joints_m[:, columns]
    truth = Truth(recording.skeleton, tuple(map(str, ids)), joints_m)
    return replace(recording, truth=truth, truth_complete=True)


def figures(errors: Sequence[Floats], reference: Sequence[Floats]) -> Figures:
    """Return the gains in percent, and the difference in recall in points."""
    mine_m, other_m = np.concatenate(errors), np.concatenate(reference)
    found_m, others_m = mine_m[mine_m < MISS_M], other_m[other_m < MISS_M]
    gain = 100 * (1 - found_m.mean() / others_m.mean())
    cut = 100 * (1 - np.minimum(found_m, CUT_M).mean() / np.minimum(others_m, CUT_M).mean())
    recall = 100 * (len(found_m) / len(mine_m) - len(others_m) / len(other_m))
    return float(gain), float(cut), float(recall)


def measure(scene: str, seed: int, count: int, lead: int, rows: Sequence[str]) -> dict[str, Any]:
    """Return the figures of every row of the table for one recording."""
    run = Run(recorded(scene, seed), count, seed, lead)
    found: dict[str, Any] = {}
    reference = in_order(run, run.pipeline(SPREAD, lead))
    for row in rows:
        if row in TRIED:
            found[row] = figures(tried(run, *TRIED[row]), reference)
        elif row in WITH_TRUTH:
            found[row] = figures(with_truth(run, row), reference)
    asked = [row for row in REDRAWN if row in rows]
    if asked:
        drawn = [
            Run(redraw(scene, seed, draw), count, seed, lead) for draw in range(DRAWS + JUDGES)
        ]
        chosen = redrawn(drawn[:DRAWS]) if "redrawn" in asked else None
        judged: dict[str, list[Figures]] = {row: [] for row in asked}
        for run in drawn[DRAWS:]:
            reference = in_order(run, run.pipeline(SPREAD, lead))
            for row in asked:
                pipeline = run.pipeline(ADAPTIVE if row == "plain" else SPREAD, lead)
                if row == "redrawn":
                    pipeline = run.pipeline(SPREAD, 1)
                errors = in_order(run, pipeline, chosen if row == "redrawn" else None)
                judged[row].append(figures(errors, reference))
        found.update({row: tuple(np.mean(judged[row], axis=0)) for row in asked})
    turns_m = np.concatenate(reference)
    return {
        "scene": scene, "seed": seed, "count": count, "lead": lead, "found": found,
        "turns_mm": 1000 * float(turns_m[turns_m < MISS_M].mean()),
    }  # fmt: skip


def report(results: Sequence[dict[str, Any]], rows: Sequence[str]) -> Iterator[str]:
    """Yield a table in Markdown for each number of cameras."""
    for count in sorted({each["count"] for each in results}):
        mine = [each for each in results if each["count"] == count]
        yield f"\n| C = {count}, gain in % | round robin, mm | " + " | ".join(rows) + " |"
        yield "|---|---|" + "---|" * len(rows)
        for scene in dict.fromkeys(each["scene"] for each in mine):
            here = [each for each in mine if each["scene"] == scene]
            gains = [np.mean([each["found"][row][0] for each in here]) for row in rows]
            turns_mm = np.mean([each["turns_mm"] for each in here])
            cells = " | ".join(f"{gain:.1f}" for gain in gains)
            yield f"| {Path(scene).name} | {turns_mm:.1f} | {cells} |"
        cut = f"mean, errors cut at {1000 * CUT_M:.0f} mm"
        for index, name in enumerate(("mean", cut, "recall, points")):
            means = [np.mean([each["found"][row][index] for each in mine]) for row in rows]
            yield f"| {name} | | " + " | ".join(f"{mean:.1f}" for mean in means) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--seeds", default="701,702")
    parser.add_argument("--counts", default="1,2")
    parser.add_argument("--lead", type=int, default=4, help="of the policy and of round robin")
    parser.add_argument("--rows", default=",".join((*WITH_TRUTH, "greedy", "ahead", *REDRAWN)))
    parser.add_argument("--out", type=Path, help="a file that gets a line a recording")
    options = parser.parse_args()
    rows, results = options.rows.split(","), []
    for scene in options.scenes.split(","):
        for seed in map(int, options.seeds.split(",")):
            for count in map(int, options.counts.split(",")):
                results.append(measure(scene, seed, count, options.lead, rows))
                print(json.dumps(results[-1]), file=sys.stderr, flush=True)
                if options.out:
                    with options.out.open("a") as file:
                        file.write(json.dumps(results[-1]) + "\n")
    for line in report(results, rows):
        print(line)


if __name__ == "__main__":
    main()
