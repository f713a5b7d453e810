"""Detections that never become a person: what they cost with a target error.

    python lab/benchmarks/leftovers.py --scenes operating-room,lab --posters 0,1,2 --targets 40,60
    python lab/benchmarks/leftovers.py --recording RECORDING --rates 6,30 --lead 1,4

A poster is a person who stands still in one camera and in no other. `cameras` are those per slot
after the warm-up, `waits %` the slots for which a detection waited to be met, `off mm` the mean
distance from the truth (of a recording: from the smoother over all cameras), `stated mm` the same
as stated, `missed %` the people with nobody shown within half a metre, `shown after s` the mean
time until people who come in are shown.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from choice_of_cameras import made, matched
from clip_error import Reference, references
from e3pose.base.arrays import Flags, Floats
from e3pose.evaluate.replay import ReplaySettings, make_pipeline, selected_views
from e3pose.model.noises import detector_of, load_noise
from e3pose.model.uncertainty import expected_distance_m
from e3pose.pipeline import initial_state, step
from e3pose.recording import Recording, ViewSeries
from e3pose.select.policies import Policy, Selection, Situation
from lost_people import missed_in

WARMUP = 10
FIGURES = ("cameras", "waits %", "off mm", "stated mm", "missed %", "shown after s")


@dataclass(slots=True)
class Watched:
    """A policy, and for which slots a detection waited to be met."""

    policy: Policy
    waits: list[bool] = field(default_factory=list)

    def select(self, situation: Situation) -> Selection:
        """See `Policy.select`."""
        assert situation.foresight is not None
        self.waits.append(bool(situation.foresight.entrants.weights.sum() > 0.5))
        return self.policy.select(situation)


def with_posters(recording: Recording, count: int, seed: int) -> Recording:
    """Return the recording with a person who stands still in each of the first `count` cameras.

    The pose is one that another camera had of somebody, so it meets nobody in space, and the same
    in every frame but for two pixels of noise.
    """
    rng = np.random.default_rng([seed, 5])
    views = list(recording.views)
    for camera in range(count):
        series, donor = views[camera], recording.views[camera - 1]
        best = int(np.argmax(donor.scores.sum(axis=1)))
        pose, known = donor.keypoints_px[best], donor.scores[best] > 0
        width, height = recording.rig.cameras[camera].image_size
        size = np.ptp(pose[known], axis=0)
        pose = pose - pose[known].min(axis=0) + (0.15 * width, 0.25 * height) - 0.1 * size
        keypoints, scores = list(series.keypoints_px), list(series.scores)
        for frame in reversed(range(len(series.slots))):
            at = int(series.starts[frame + 1])
            keypoints.insert(at, pose + rng.normal(scale=2.0, size=pose.shape))
            scores.insert(at, np.where(known, 0.8, 0.0))
        starts = series.starts + np.arange(len(series.starts))
        views[camera] = ViewSeries(
            series.slots, series.times_s, starts, np.array(keypoints), np.array(scores)
        )
    return replace(recording, views=tuple(views))


def figures(
    recording: Recording, people: Sequence[Reference], target_mm: float, lead: int, seed: int
) -> dict[str, float]:
    """Replay once; return the figures by name."""
    settings = ReplaySettings(
        policy="information", target_error_m=target_mm / 1000, lead_slots=lead,
        phase=seed % 1000, warmup_slots=WARMUP,
    )  # fmt: skip
    pipeline = make_pipeline(recording, settings)
    watched = Watched(pipeline.policy)
    pipeline = replace(pipeline, policy=watched)
    state, online = initial_state(pipeline), np.ones(len(recording.rig), dtype=bool)
    true_m = truth(recording, people)
    cameras, shown, off, stated = [], [], [], []
    for slot in range(recording.num_slots):
        views = selected_views(recording, slot, state.selections[0])
        state, record = step(pipeline, state, views, online)
        shown.append(record.poses.joints_m)
        if slot < WARMUP + lead:
            continue
        cameras.append(record.selected.sum())
        here = true_m[slot][np.isfinite(true_m[slot]).any(axis=(1, 2))]
        for mine, theirs in matched(record.poses.joints_m, here):
            apart_m = np.linalg.norm(record.poses.joints_m[mine] - here[theirs], axis=-1)
            off.append(apart_m[np.isfinite(apart_m)])
        stated.append(expected_distance_m(record.covariance_m2).ravel())
    missed = missed_in(true_m, shown)
    there = np.asarray(np.isfinite(true_m).any(axis=(2, 3)))
    waited = [slots * recording.interval_s for slots in waits(there, missed, WARMUP + lead)]
    missed = missed[WARMUP + lead :]
    return {
        "cameras": float(np.mean(cameras)),
        "waits %": 100 * float(np.mean(watched.waits[WARMUP:])),
        "off mm": 1000 * float(np.concatenate(off).mean()) if off else np.nan,
        "stated mm": 1000 * float(np.nanmean(np.concatenate(stated))),
        "missed %": 100 * float(missed.sum() / there[WARMUP + lead :].sum()),
        "shown after s": float(np.mean(waited)) if waited else np.nan,
    }


def waits(there: Flags, missed: Flags, begin: int) -> list[int]:
    """Return the slots until each person who comes in after `begin` is shown, or leaves unshown."""
    found = []
    for person in range(there.shape[1]):
        edges = np.flatnonzero(np.diff(np.pad(there[:, person], 1).astype(np.int8)))
        for first, stop in edges.reshape(-1, 2).tolist():
            seen = ~missed[first:stop, person]
            if first > begin:
                found.append(int(seen.argmax()) if seen.any() else stop - first)
    return found


def truth(recording: Recording, people: Sequence[Reference]) -> Floats:
    """Return `(num_slots, num_persons, num_joints, 3)`: the truth, or what all cameras say."""
    if recording.truth is not None:
        return recording.truth.joints_m
    slots = range(recording.num_slots)
    return np.stack([np.stack([person.at(slot) for slot in slots]) for person in people], axis=1)


def recordings(options: argparse.Namespace) -> Any:
    """Yield place, rate, seed and recording."""
    places = [str(options.recording)] if options.recording else options.scenes.split(",")
    for place in places:
        for rate in map(float, options.rates.split(",")):
            for seed in map(int, options.seeds.split(",")):
                yield place, rate, seed, made(place, rate, options.seconds, seed)


def main() -> None:
    """Measure and print a line for every replay."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenes", default="operating-room,lab")
    parser.add_argument("--recording", type=Path, help="a real one in place of scenes")
    parser.add_argument("--posters", default="0,1,2", help="cameras that see somebody who is not")
    parser.add_argument("--targets", default="40,60", help="millimetres")
    parser.add_argument("--rates", default="6", help="slots per second")
    parser.add_argument("--lead", default="1", help="slots ahead")
    parser.add_argument("--seeds", default="901")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--out", type=Path, help="a file that gets a line for every replay")
    options = parser.parse_args()
    print(f"| place | slots/s | seed | posters | target | lead | {' | '.join(FIGURES)} |")
    print("|---" * (6 + len(FIGURES)) + "|")
    for place, rate, seed, recording in recordings(options):
        people: list[Reference] = []
        if recording.truth is None:
            people = references(recording, load_noise(detector_of(recording)))
        for posters in map(int, options.posters.split(",")):
            seen = with_posters(recording, posters, seed)
            for target_mm in map(float, options.targets.split(",")):
                for lead in map(int, options.lead.split(",")):
                    found = figures(seen, people, target_mm, lead, seed)
                    row = (place, rate, seed, posters, target_mm, lead)
                    cells = [f"{found[name]:.2f}" for name in FIGURES]
                    print(f"| {' | '.join(map(str, row))} | {' | '.join(cells)} |", flush=True)
                    if options.out:
                        with options.out.open("a") as file:
                            file.write(json.dumps([*row, found]) + "\n")


if __name__ == "__main__":
    main()
