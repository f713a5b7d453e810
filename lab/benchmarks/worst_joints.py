"""What the worst joints of an estimate have in common, and what each cause costs.

    python lab/benchmarks/worst_joints.py RECORDING ... --policy information --cameras 2 --lead 4

Prints how the 5 % of joints with the largest errors divide into causes, then the errors with one
cause removed from the recording (`oracles`), then, for recordings without truth, how far the
reference moves when it lacks a camera. The reference is the truth of the recording or, without it,
the smoother over all views (`clip_error.py`). Figures are over all recordings, in millimetres.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clip_error import SAME_M, references
from e3pose.base.arrays import Flags, Floats
from e3pose.evaluate.metrics import mean_errors_m
from e3pose.evaluate.noise.residuals import assign_detections
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.smoother import smooth
from e3pose.model.noise import LEAST_SCORE, Noise
from e3pose.model.noises import detector_of, load_noise
from e3pose.model.projection import project
from e3pose.pipeline import SlotRecord
from e3pose.predict.base import Prediction
from e3pose.recording import Recording, ViewSeries, load_recording

WORST = 0.05
RECENT_S = 0.15  # how long ago a camera may have seen a joint
WILD_SIGMAS = 3.0  # a keypoint farther than this from the reference is wild
ALONG = 0.8  # share of an error along a line of sight
LAGS_S = np.arange(0.0, 0.151, 0.01)
TRUNK = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
CAUSES = (
    "the whole body is off", "the joint above is off", "left and right are exchanged",
    "no keypoint for 0.15 s", "wild keypoints only", "wild and right keypoints",
    "one camera, along its line of sight", "one camera, across it",
    "right keypoints: late", "right keypoints: other",
)  # fmt: skip
ORACLES = ("as it is", "wild dropped", "wild put right", "missing filled", "true prediction")
FILLED_SCORE, FORESEEN_M = 0.5, 0.02  # of what the oracles add


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Where people are, and what the detector made of them.

    Attributes:
        joints_m: `(num_slots, num_persons, num_joints, 3)`, NaN where unknown.
        keypoints_px: `(num_slots, num_persons, num_cameras, num_joints, 2)` undistorted.
        scores: `(num_slots, num_persons, num_cameras, num_joints)`.
        wild: the same shape: seen, and farther off than `WILD_SIGMAS`.
    """

    joints_m: Floats
    keypoints_px: Floats
    scores: Floats
    wild: Flags

    @property
    def right(self) -> Flags:
        """Seen and not wild, shaped as `wild`."""
        return np.asarray((self.scores > 0) & ~self.wild)


def reference_of(recording: Recording) -> Reference:
    """Return the truth, or what all cameras say, and the detections that belong to it."""
    noise, num_slots = load_noise(detector_of(recording)), recording.num_slots
    if recording.truth is not None:
        joints_m = recording.truth.joints_m
    else:
        paths = references(recording, noise)
        joints_m = np.full((num_slots, len(paths), len(recording.skeleton), 3), np.nan)
        for person, path in enumerate(paths):
            last = path.first_slot + len(path.joints_m)
            joints_m[path.first_slot : last, person] = path.joints_m
    shape = (*joints_m.shape[:2], len(recording.rig), joints_m.shape[2])
    keypoints, scores = np.full((*shape, 2), np.nan), np.zeros(shape)
    there = [np.flatnonzero(known.any(axis=1)) for known in _known(joints_m).swapaxes(0, 1)]
    people = [person for person, slots in enumerate(there) if len(slots)]
    tracks = [(there[person], joints_m[there[person], person]) for person in people]
    for person, seen in zip(people, assign_detections(recording, tracks, num_slots), strict=True):
        span = slice(seen.first_slot, seen.first_slot + len(seen.scores))
        found = seen.scores > LEAST_SCORE
        keypoints[span, person], scores[span, person] = seen.keypoints_px, seen.scores * found
    shown = np.moveaxis(project(joints_m, recording.rig.projections)[0], 0, 2)
    off = np.linalg.norm(keypoints - shown, axis=-1) / _sigma_px(recording, noise, scores)
    return Reference(joints_m, keypoints, scores, (scores > 0) & (off > WILD_SIGMAS))


def _known(joints_m: Floats) -> Flags:
    return np.asarray(np.isfinite(joints_m).all(axis=-1))


def _sigma_px(recording: Recording, noise: Noise, scores: Floats) -> Floats:
    """Return the noise of keypoints `(*batch, num_cameras, num_joints)`."""
    scales = [max(camera.image_size) / noise.image_px for camera in recording.rig.cameras]
    return np.asarray(noise.of(scores, np.array(scales)[:, None]))


class TruePrediction:
    """Predicts what the reference says of the slots after `slot`."""

    def __init__(self, joints_m: Floats) -> None:
        self.joints_m, self.slot = joints_m, 0

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        """See `Predictor.predict`."""
        joints_m = np.repeat(history_m[-1:], lead_slots, axis=0)
        apart = mean_errors_m(history_m[-1], self.joints_m[self.slot])
        for track in np.flatnonzero(apart.min(axis=1, initial=np.inf) < SAME_M):
            for ahead in range(lead_slots):
                slot = min(self.slot + ahead + 1, len(self.joints_m) - 1)
                truth = self.joints_m[slot, apart[track].argmin()]
                joints_m[ahead, track][_known(truth)] = truth[_known(truth)]
        error_m = FORESEEN_M * np.arange(1.0, lead_slots + 1)[:, None, None]
        return Prediction(joints_m, np.broadcast_to(error_m, joints_m.shape[:-1]).copy())


def repaired(recording: Recording, reference: Reference, oracle: str) -> Recording:
    """Return the recording with keypoints changed as `ORACLES` says, the same in every call."""
    if oracle in ("as it is", "true prediction"):
        return recording
    rng, noise = np.random.default_rng(0), load_noise(detector_of(recording))
    views = []
    for index, (camera, series) in enumerate(
        zip(recording.rig.cameras, recording.views, strict=True)
    ):
        keypoints, scores = series.keypoints_px.copy(), series.scores.copy()
        scale = max(camera.image_size) / noise.image_px
        for frame, slot in enumerate(series.slots.tolist()):
            for row in range(series.starts[frame], series.starts[frame + 1]):
                own_px = camera.undistort(series.keypoints_px[row])
                found = np.nansum(reference.keypoints_px[slot, :, index] == own_px, axis=(1, 2))
                if not found.size or not found.max() > 0:
                    continue
                person = int(found.argmax())
                exact = camera.project(reference.joints_m[slot, person])
                inside = camera.sees(reference.joints_m[slot, person])
                if oracle == "missing filled":
                    change = (reference.scores[slot, person, index] == 0) & inside
                    scores[row, change] = FILLED_SCORE
                else:
                    change = reference.wild[slot, person, index]
                    gone = change & (~inside | (oracle == "wild dropped"))
                    keypoints[row, gone], scores[row, gone] = np.nan, 0.0
                    change = change & ~gone
                sigma = noise.of(scores[row, change]) * scale
                errors = rng.standard_normal((int(change.sum()), 2)) * sigma[:, None]
                keypoints[row, change] = exact[change] + errors
        views.append(ViewSeries(series.slots, series.times_s, series.starts, keypoints, scores))
    return replace(recording, views=tuple(views))


def records(
    recording: Recording, reference: Reference, settings: ReplaySettings, oracle: str
) -> Iterator[SlotRecord]:
    """Replay with an oracle."""
    predictor = TruePrediction(reference.joints_m) if oracle == "true prediction" else None
    for record in replay(repaired(recording, reference, oracle), settings, predictor=predictor):
        yield record
        if predictor is not None:
            predictor.slot = record.slot + 1


def compare(
    recording: Recording, reference: Reference, settings: ReplaySettings, oracle: str
) -> tuple[Floats, NDArray[np.int64]]:
    """Return errors in metres and causes `(num_compared,)` of the joints of a replay."""
    arrived = np.zeros((recording.num_slots, len(recording.rig)), dtype=bool)
    first = settings.warmup_slots + settings.lead_slots - 1
    found: list[tuple[float, int]] = []
    for record in records(recording, reference, settings, oracle):
        arrived[record.slot] = record.arrived
        truth = reference.joints_m[record.slot]
        if record.slot < first or not len(record.poses) or not len(truth):
            continue
        apart = mean_errors_m(record.poses.joints_m, truth)
        for row in np.flatnonzero(apart.min(axis=1, initial=np.inf) < SAME_M):
            person, joints_m = int(apart[row].argmin()), record.poses.joints_m[row]
            off = np.linalg.norm(joints_m - truth[person], axis=-1)
            causes_of = _causes(recording, reference, arrived, record.slot, person, joints_m)
            known = np.flatnonzero(np.isfinite(off))
            found += [(float(off[j]), int(causes_of[j])) for j in known]
    rows = np.array(found, dtype=np.float64).reshape(-1, 2)
    return rows[:, 0], rows[:, 1].astype(np.int64)


def _causes(
    recording: Recording,
    reference: Reference,
    arrived: Flags,
    slot: int,
    person: int,
    joints_m: Floats,
) -> NDArray[np.int64]:
    """Return `(num_joints,)`: the first of `CAUSES` that explains half of each joint's error."""
    from e3pose.estimate.filter.tree import grow

    skeleton, dt = recording.skeleton, recording.interval_s
    truth = reference.joints_m[slot, person]
    error = joints_m - truth
    half = np.linalg.norm(error, axis=-1) / 2
    parents, names = grow(skeleton).parents, skeleton.joints
    above = np.where((parents >= 0)[:, None], error[parents], np.nan)
    trunk = np.median(error[[skeleton.index(name) for name in TRUNK]], axis=0)
    sides = {"left": "right", "right": "left"}
    others = [_other(name, sides) for name in names]
    swapped = np.array([names.index(o) if o in names else j for j, o in enumerate(others)])
    pair = swapped != np.arange(len(names))
    since = max(0, slot - max(1, round(RECENT_S / dt)) + 1)
    looked = arrived[since : slot + 1, :, None]
    right = reference.right[since : slot + 1, person] & looked
    wild = (reference.wild[since : slot + 1, person] & looked).any(axis=(0, 1))
    cameras = right.any(axis=0).sum(axis=0)
    newest = right.any(axis=0).argmax(axis=0)  # the only one, where it matters
    rays = truth - np.array([c.center_m for c in recording.rig.cameras])[newest]
    along = np.abs((error * rays).sum(axis=-1)) / np.linalg.norm(rays, axis=-1)
    slots = np.arange(reference.joints_m.shape[0])
    path = reference.joints_m[:, person]
    late = np.zeros(len(names), dtype=bool)
    for lag_s in LAGS_S:
        place = np.clip(slot - lag_s / dt, 0, slots[-1])
        low, share = int(place), place - int(place)
        past = path[low] if share == 0 else (1 - share) * path[low] + share * path[low + 1]
        late |= np.linalg.norm(joints_m - past, axis=-1) < half
    tests = (
        np.linalg.norm(error - trunk, axis=-1) < half,
        np.linalg.norm(error - above, axis=-1) < half,
        (np.linalg.norm(joints_m - truth[swapped], axis=-1) < half) & pair,
        (cameras == 0) & ~wild,
        cameras == 0,
        wild,
        (cameras == 1) & (along > 2 * ALONG * half),
        cameras == 1,
        late,
        np.ones(len(names), dtype=bool),
    )
    return np.asarray(np.argmax(tests, axis=0))


def _other(name: str, sides: dict[str, str]) -> str:
    side, _, joint = name.partition("_")
    return f"{sides.get(side, side)}_{joint}"


def figures(errors_m: Floats) -> str:
    """Return mean, 95 %, 99 % and maximum in millimetres."""
    off = 1000 * errors_m
    tails = " ".join(f"{np.quantile(off, q):6.0f}" for q in (1 - WORST, 0.99, 1.0))
    return f"{off.mean():6.1f} {tails}"


def print_causes(errors_m: Floats, causes: NDArray[np.int64]) -> None:
    """Print each cause's share of the worst joints and of all, and the 95 % error without it."""
    bad = errors_m > np.quantile(errors_m, 1 - WORST)
    print(f"{'cause':36} worst  all    mean  if gone: 95 %")
    for cause, name in enumerate(CAUSES):
        ours = causes == cause
        if not (ours & bad).any():
            continue
        without = np.where(ours & bad, np.median(errors_m), errors_m)
        print(
            f"{name:36} {100 * ours[bad].mean():4.0f} % {100 * ours.mean():3.0f} % "
            f"{1000 * errors_m[ours & bad].mean():5.0f} "
            f"{1000 * np.quantile(without, 1 - WORST):9.0f}"
        )


def print_reference(recording: Recording, reference: Reference) -> None:
    """Print how far the smoother over all cameras but one is from that over all."""
    noise = load_noise(detector_of(recording))
    known = _known(reference.joints_m)
    for left_out in range(len(recording.rig)):
        off = []
        for person in range(reference.joints_m.shape[1]):
            slots = np.flatnonzero(known[:, person].any(axis=-1))
            path = reference.joints_m[slots, person]
            start = np.where(np.isfinite(path), path, np.nanmean(path, axis=(0, 1)))
            scores = reference.scores[slots, person].copy()
            scores[:, left_out] = 0
            sigma = np.where(scores > 0, _sigma_px(recording, noise, scores), np.inf)
            keypoints = reference.keypoints_px[slots, person]
            dt = recording.interval_s
            other = smooth(keypoints, sigma, recording.rig.projections, start, dt)
            off.append(np.linalg.norm(other - path, axis=-1)[known[slots, person]])
        name = recording.rig.camera_ids[left_out]
        print(f"reference without {name:18} {figures(np.concatenate(off))}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", type=Path, nargs="+", help="folders, compared together")
    parser.add_argument("--policy", default="information", help="which cameras detect")
    parser.add_argument("--cameras", type=float, default=2, help="per slot, on average")
    parser.add_argument("--lead", type=int, default=4, help="slots between decision and use")
    parser.add_argument("--phases", type=int, default=1, help="replays of each recording")
    parser.add_argument("--warmup", type=int, default=10, help="slots with all cameras, left out")
    options = parser.parse_args()
    settings = ReplaySettings(
        pipeline="memory",
        policy=options.policy,
        num_selected=options.cameras,
        lead_slots=options.lead,
        warmup_slots=options.warmup,
    )
    loaded = [load_recording(path) for path in options.recordings]
    everything = [(recording, reference_of(recording)) for recording in loaded]
    print(f"{'':36}   mean   95 %   99 %    max")
    for oracle in ORACLES:
        parts = [
            compare(*each, replace(settings, phase=phase, seed=phase), oracle)
            for each in everything
            for phase in range(options.phases)
        ]
        errors_m, causes = (np.concatenate(column) for column in zip(*parts, strict=True))
        if not len(errors_m):
            raise SystemExit("found no joint to compare: recordings must outlast the warm-up")
        print(f"{oracle:36} {figures(errors_m)}", flush=True)
        if oracle == ORACLES[0]:
            first = errors_m, causes
    for recording, reference in everything:
        if recording.truth is None:
            print_reference(recording, reference)
    print_causes(*first)


if __name__ == "__main__":
    main()
