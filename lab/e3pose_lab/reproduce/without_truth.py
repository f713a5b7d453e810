"""Replays of a recording without truth, judged by a camera that took no part, and a smoother."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.estimate.base import Estimate
from e3pose.evaluate import metrics
from e3pose.evaluate.figures import HeldOutCamera
from e3pose.evaluate.held_out import COMPARED, judge, turns
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.smoothed import smooth_records
from e3pose.evaluate.summary import in_skeleton
from e3pose.model.skeleton import COCO17
from e3pose.model.slot_record import SlotRecord
from e3pose.recording import Recording
from e3pose_lab.reproduce.replays import Asked, recording_of, records_of
from e3pose_lab.reproduce.sources import Sources

LIMITS = ("25", "50", "105", "150")
WARMUP = 10  # slots with all cameras, and those of the lead: not compared
JOINTS = [COCO17.index(name) for name in COMPARED]
_SMOOTHED: dict[tuple[str, int], Floats] = {}


@dataclass(frozen=True, slots=True)
class Likeness:
    """How near the poses of a replay are to those of the smoother over all cameras.

    Attributes:
        found: share of the smoother's people who have a pose within each limit, mm; percent.
        within: share of the poses within each limit of somebody, the paper's AP; percent.
        mpjpe_mm: of people found within 500 mm, over the joints that both have.
        recall: share of people found within 500 mm, percent.
        more: share of the poses of nobody, or of somebody who has one already; percent.
        cameras: selected per slot.
    """

    found: dict[str, float]
    within: dict[str, float]
    mpjpe_mm: float
    recall: float
    more: float
    cameras: float


@dataclass(frozen=True, slots=True)
class HeldOutAsked:
    """A replay without one of the cameras.

    Attributes:
        asked: how to replay the others.
        camera: its place in the rig.
    """

    asked: Asked
    camera: int


def outside(sources: Sources, asked: HeldOutAsked) -> HeldOutCamera:
    """Replay a recording without a camera; compare what is estimated with what that camera sees."""
    recording = recording_of(sources, asked.asked)
    ((rest, judges),) = turns(recording, [recording.rig.camera_ids[asked.camera]])
    assert judges is not None, "a camera is held out"
    return judge(judges, _estimated(rest, asked.asked)).mean


def likeness(sources: Sources, asked: Asked) -> Likeness:
    """Replay a recording; compare what is estimated in each slot with the smoother."""
    recording = recording_of(sources, asked)
    people_m = _smoothed(sources.stamp, recording)
    records = _estimated(recording, asked)
    poses = in_skeleton(records, recording.skeleton, COCO17)
    found = metrics.candidates(
        [joints[:, JOINTS] for joints in poses],
        [record.people.scores.mean(axis=-1) for record in records],
        people_m[[record.slot for record in records]],
    )
    off_m, matched = found.errors_m, metrics.first_matches(found, metrics.MATCH_LIMIT_M)
    limits_m = {limit: float(limit) / 1000 for limit in LIMITS}
    first = {name: metrics.first_matches(found, limit) for name, limit in limits_m.items()}
    return Likeness(
        {name: 100 * float(each.sum()) / found.num_truths for name, each in first.items()},
        {name: 100 * float((off_m < limit).mean()) for name, limit in limits_m.items()},
        mpjpe_mm=1000 * float(off_m[matched].mean()),
        recall=100 * float(matched.sum()) / found.num_truths,
        more=100 * float(1 - matched.mean()),
        cameras=float(np.mean([record.selected.sum() for record in records])),
    )


def _estimated(recording: Recording, asked: Asked) -> list[SlotRecord]:
    """Return the records of a replay after its warm-up, without the joints that a slot lacks."""
    records = records_of(recording, replace(asked, fill=asked.pipeline != "paper"))
    return [record for record in records if record.slot >= WARMUP + asked.lead]


def _smoothed(stamp: str, recording: Recording) -> Floats:
    """Return `(num_slots, num_people, 10, 3)` metres of everybody; made once in a process."""
    place = stamp, recording.num_slots
    if place not in _SMOOTHED:
        _SMOOTHED[place] = smoothed_people(recording)
    return _SMOOTHED[place]


def smoothed_people(recording: Recording) -> Floats:
    """Return `(num_slots, num_people, 10, 3)` metres, NaN for who is not there: the smoother."""
    told: list[Estimate] = []
    everything = ReplaySettings(policy="all", num_selected=len(recording.rig))
    records = list(replay(recording, everything, publish=told.append))
    posteriors = [each.posterior for each in told if each.posterior is not None]
    late = smooth_records(records, posteriors, recording.skeleton)
    people = in_skeleton(late, recording.skeleton, COCO17)
    ids = np.unique(np.concatenate([record.people.track_ids for record in late]))
    paths_m = np.full((recording.num_slots, len(ids), len(JOINTS), 3), np.nan)
    for record, joints_m in zip(late, people, strict=True):
        paths_m[record.slot, np.searchsorted(ids, record.people.track_ids)] = joints_m[:, JOINTS]
    return paths_m
