"""One slot of Shelf in pictures: what cameras detect, and 3D poses from five and from three."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from e3pose.base.arrays import Floats
from e3pose.estimate.per_slot.fuse import Fuser
from e3pose.evaluate import metrics
from e3pose.evaluate.metrics import LIMBS
from e3pose.evaluate.replay import selected_views
from e3pose.model.skeleton import convert
from e3pose.settings.parts import PAPER_FUSION
from e3pose_lab.reproduce.replays import SHELF, Asked, recording_of
from e3pose_lab.reproduce.sources import Sources

Limbs = list[list[float]]  # of one person: both ends of each limb that is known

CHOSEN = 3
SAME_PX, SAME_M = 150.0, 0.5  # within which two are the same person
TRUNK = ((8, 9), (2, 3), (8, 2), (9, 3))  # of Shelf-14, for the eye


@dataclass(frozen=True, slots=True)
class SceneAsked:
    """Which slots.

    Attributes:
        first: slot.
        stop: the slot after the last.
        stride: slots from one to the next.
    """

    first: int
    stop: int
    stride: int = 1


@dataclass(frozen=True, slots=True)
class Scene:
    """The slot in which three cameras are better than all by most.

    Attributes:
        slot: which.
        chosen: the three cameras.
        error_mm: mean error with all cameras, and with these.
        seen: people by camera, pixels `u0 v0 u1 v1` of each limb; here and below in the order of
            the people from three cameras, without limbs where one of them lacks, others after them.
        projected: the people from three cameras, likewise.
        people: by what they are from, `all`, `chosen` and `truth`; metres `x0 y0 z0 x1 y1 z1`.
    """

    slot: int
    chosen: list[int]
    error_mm: list[float]
    seen: list[list[Limbs]]
    projected: list[list[Limbs]]
    people: dict[str, list[Limbs]]


def scene(sources: Sources, asked: SceneAsked) -> Scene:
    """Fuse all cameras and every three of them in some slots; return the slot worth a picture.

    The choice reads the labels, as the paper's picture does.
    """
    recording = recording_of(sources, Asked(SHELF, "all"))
    truth = recording.truth
    assert truth is not None, "Shelf is labelled"
    fuser, count = Fuser(recording.rig, len(recording.skeleton), PAPER_FUSION), len(recording.rig)
    best: tuple[float, int, tuple[int, ...], list[float]] | None = None

    def fused(slot: int, cameras: tuple[int, ...]) -> tuple[Floats, Floats]:
        poses = fuser.fuse(
            selected_views(recording, slot, np.isin(np.arange(count), cameras))
        ).people
        shelf, _ = convert(poses.joints_m, poses.scores, recording.skeleton, truth.skeleton)
        return poses.joints_m, shelf

    everyone = tuple(range(count))
    for slot in range(asked.first, min(asked.stop, recording.num_slots), asked.stride):
        wanted = truth.joints_m[slot]
        wanted = wanted[np.isfinite(wanted).any(axis=(1, 2))]
        if len(wanted) < CHOSEN:
            continue
        all_mm = _error_mm(fused(slot, everyone)[1], wanted)
        for cameras in combinations(everyone, CHOSEN):
            error_mm = _error_mm(fused(slot, cameras)[1], wanted)
            if best is None or all_mm - error_mm > best[0]:
                best = (all_mm - error_mm, slot, cameras, [all_mm, error_mm])
    assert best is not None, "a slot with three labelled people"
    _, slot, cameras, errors_mm = best
    joints_m, shelf_m = fused(slot, cameras)
    limbs = recording.skeleton.limbs
    shelf = [pair for pair in (*LIMBS, *TRUNK) if max(pair) < len(truth.skeleton)]
    projected = [camera.project(joints_m) for camera in recording.rig.cameras]
    seen = []
    for camera in everyone:
        view = recording.view(slot, camera)
        keypoints_px = projected[camera][:0] if view is None else view.keypoints_px
        seen.append(limbs_of(in_order(keypoints_px, projected[camera], SAME_PX), limbs))
    return Scene(
        slot,
        list(cameras),
        errors_mm,
        seen,
        [limbs_of(each, limbs) for each in projected],
        {
            "all": limbs_of(in_order(fused(slot, everyone)[1], shelf_m, SAME_M), shelf),
            "chosen": limbs_of(shelf_m, shelf),
            "truth": limbs_of(in_order(truth.joints_m[slot], shelf_m, SAME_M), shelf),
        },
    )


def in_order(people: Floats, like: Floats, within: float) -> Floats:
    """Return people in the order of others, so that one person has one colour in all pictures.

    Args:
        people: `(num_people, num_joints, 2 or 3)`, NaN where a joint is not known.
        like: `(num_others, num_joints, 2 or 3)` likewise.
        within: mean distance up to which two are the same, in the same unit.

    Returns:
        `(num_others + num_new, num_joints, 2 or 3)`: NaN where nobody is like one of the others,
        people who are like none of them after these.
    """
    people = people[np.isfinite(people).any(axis=(1, 2))]
    mean = metrics.mean_errors_m(people, like)
    rows, columns = linear_sum_assignment(np.minimum(mean, 2 * within))
    same = mean[rows, columns] <= within
    ordered = np.full_like(like, np.nan)
    ordered[columns[same]] = people[rows[same]]
    return np.concatenate([ordered, np.delete(people, rows[same], axis=0)])


def _error_mm(joints_m: Floats, wanted_m: Floats) -> float:
    """Return the mean error of labelled people; somebody who is not found is half a metre off."""
    if not len(joints_m):
        return 1000 * metrics.MATCH_LIMIT_M
    nearest = metrics.mean_errors_m(joints_m, wanted_m).min(axis=0)
    return float(1000 * np.minimum(nearest, metrics.MATCH_LIMIT_M).mean())


def limbs_of(joints: Floats, pairs: Sequence[tuple[int, int]]) -> list[Limbs]:
    """Return both ends of every limb that is known, person by person."""
    found = []
    for person in joints:
        ends = [np.concatenate([person[a], person[b]]) for a, b in pairs] if len(person) > 1 else []
        found.append([end.tolist() for end in ends if np.isfinite(end).all()])
    return found
