"""A policy's check on itself: is a selection really better than taking turns?

Time runs in rounds of stretches. In all but the last of a round cameras are selected as usual, in
the last one the other way: by turns where the policy selects, by the policy where it has fallen
back to turns. In the last two stretches the cameras whose turn it is look every few slots, whatever
the policy prefers, and their keypoints are compared with the people that were predicted without
them. So both ways are judged by the same cameras at the same times: a camera that is preferred
because it confirms itself gains nothing by it. Method: `docs/explanation/camera-selection.md`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import gcd

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.known import mean_of_known
from e3pose.estimate.base import Outlook
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.select.policies.base import Policy, turns_of
from e3pose.select.rounds import (
    BACK,
    LEAST_ROUNDS,
    SETTLE_S,
    STRETCH_S,
    STRETCHES,
    Rounds,
    by,
    place_of,
    with_round,
)

# tuned: slots | by reasoning, tried on no recording | not measured
FEWEST_SLOTS = 4  # between two slots that are compared
# tuned: views | by reasoning, tried on no recording | not measured
LEAST_LOOKS = 3  # in each of two stretches, or the round says nothing
# tuned: standard errors | by reasoning, tried on no recording; on drawn distances that scatter by a
#   tenth it never falls back without cause in 40 rounds | not measured
SURE = 2.5  # standard errors behind turns, to fall back
# tuned: joints | by reasoning, tried on no recording | not measured
LEAST_JOINTS = 4  # of a detection that is compared
# tuned: m | by reasoning, tried on no recording | not measured
SAME_M = 0.5  # a detection farther than this from everybody is of nobody
# tuned: m | by reasoning, tried on no recording | not measured
WILD_M = 0.3  # a keypoint counts as no farther off

SELECTING, TURNS = 0, 1  # layout: of the pairs in `OwnCheck`


@dataclass(frozen=True, slots=True)
class Plan:
    """How the cameras of one slot are selected.

    Attributes:
        way: `SELECTING` or `TURNS`.
        common: the cameras whose turn it is look, whatever the way.
        counts: their views are compared.
    """

    way: int = SELECTING
    common: bool = False
    counts: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class OwnCheck(Rounds):
    """What the rounds so far have shown: of the distance while selecting over that by turns.

    Attributes:
        round: which one it is.
        looks: `(2,)` views compared in this round, by way.
        seen_m: `(2,)` sum of their mean distances from the people predicted, metres.
        stated_m: `(2,)` sum of the errors stated in the same slots.
        stated: mean logarithm of the same ratio of stated errors.
        by_turns: whether the policy has fallen back to turns.
    """

    round: int = 0
    looks: Floats = field(default_factory=lambda: np.zeros(2))
    seen_m: Floats = field(default_factory=lambda: np.zeros(2))
    stated_m: Floats = field(default_factory=lambda: np.zeros(2))
    stated: float = 0.0
    by_turns: bool = False

    def plan(self, slot: int, interval_s: float, num_cameras: int) -> Plan:
        """Return how the cameras of a slot are selected."""
        _, place, into_s = place_of(slot, interval_s)
        usual = TURNS if self.by_turns else SELECTING
        way = usual if place < STRETCHES - 1 else 1 - usual
        common = place >= STRETCHES - 2 and slot % _every(num_cameras) == 0
        return Plan(way, common, common and into_s >= SETTLE_S)

    def after(
        self, slot: int, interval_s: float, way: int, seen_m: float, error_m: float
    ) -> OwnCheck:
        """Return the check after a slot.

        Args:
            slot: which one.
            interval_s: seconds per slot.
            way: of its plan.
            seen_m: how far its views were from the people predicted; NaN where none is compared.
            error_m: the mean error stated after it; NaN where nobody is known.
        """
        now, _, _ = place_of(slot, interval_s)
        check = self if now == self.round else replace(self._judged(), round=now)
        if not (np.isfinite(seen_m) and np.isfinite(error_m)):
            return check
        one = np.eye(2)[way]
        return replace(
            check,
            looks=check.looks + one,
            seen_m=check.seen_m + one * seen_m,
            stated_m=check.stated_m + one * error_m,
        )

    def _judged(self) -> OwnCheck:
        """Return the check at the end of a round, with nothing in the next one."""
        begun = replace(self, looks=np.zeros(2), seen_m=np.zeros(2), stated_m=np.zeros(2))
        if self.looks.min() < LEAST_LOOKS or min(self.seen_m.min(), self.stated_m.min()) <= 0:
            return begun
        seen, stated = self.seen_m / self.looks, self.stated_m / self.looks
        check = with_round(begun, math.log(seen[SELECTING] / seen[TURNS]))
        off = math.log(stated[SELECTING] / stated[TURNS]) - check.stated
        check = replace(check, stated=check.stated + off / check.rounds)
        if check.rounds < LEAST_ROUNDS:
            return check
        if check.by_turns:
            return replace(check, by_turns=check.mean + BACK * check.error > 0)
        return replace(check, by_turns=check.mean - SURE * check.error > 0)

    def words(self) -> str:
        """Return what is known, for operators; empty before enough rounds."""
        if self.rounds < LEAST_ROUNDS:
            return ""
        ways = "error with the selection against turns"
        found = f"{ways}: {self.change} by views, {by(self.stated)} stated"
        if not self.by_turns:
            return found
        return f"cameras take turns, tried again every {STRETCH_S * STRETCHES:.0f} s; {found}"


def decides(
    policy: Policy, check: OwnCheck, slot: int, interval_s: float, num_cameras: int
) -> Policy:
    """Return what selects for a slot: the policy, or the turns that it is compared with."""
    turns = turns_of(policy)
    if turns is None:
        return policy
    plan = check.plan(slot, interval_s, num_cameras)
    return turns if plan.common or plan.way == TURNS else policy


def distance_m(
    rig: Rig, outlook: Outlook, views: Mapping[int, Poses2D], cameras: NDArray[np.bool_]
) -> float:
    """Return how far keypoints are from the people predicted, at their distance from the camera.

    Args:
        rig: the cameras.
        outlook: of the slot of the views, made before them.
        views: by camera.
        cameras: `(num_cameras,)` those that are compared.

    Returns:
        The mean in metres; NaN where nobody is compared.
    """
    joints_m = outlook.joints_m[outlook.confirmed]
    found = [
        off
        for camera, view in views.items()
        if cameras[camera] and len(view) and len(joints_m)
        for off in _pairs(rig, camera, joints_m, view)
    ]
    return float(np.concatenate(found).mean()) if found else math.nan


def _pairs(rig: Rig, camera: int, joints_m: Floats, view: Poses2D) -> list[Floats]:
    """Return the distances of the keypoints of each detection from the person it is of."""
    from scipy.optimize import linear_sum_assignment

    lens = rig.cameras[camera]
    depth_m = joints_m @ lens.R[2] + lens.t[2]
    per_pixel_m = np.where(depth_m > 0, depth_m, np.nan) / lens.K[0, 0]
    pixels = lens.project(joints_m)[:, None] - view.keypoints_px[None]
    off_m = np.linalg.norm(pixels, axis=-1) * per_pixel_m[:, None]
    known = np.isfinite(off_m)
    mean_m = mean_of_known(off_m, LEAST_JOINTS, np.inf)
    people, detections = linear_sum_assignment(np.minimum(mean_m, 2 * SAME_M))
    return [
        np.minimum(off_m[pair][known[pair]], WILD_M)
        for pair in zip(people, detections, strict=True)
        if mean_m[pair] < SAME_M
    ]


def _every(num_cameras: int) -> int:
    """Return after how many slots the next is compared, so that all cameras come in turn."""
    return next(
        n for n in range(FEWEST_SLOTS, num_cameras + 2 * FEWEST_SLOTS) if gcd(n, num_cameras) == 1
    )
