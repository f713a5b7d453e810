"""Limbs of smoothed people: as long as people's, left as right, and vague where they were moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.cases import each_case
from tests.estimate.filter.room import BODY
from tests.estimate.smooth.motions import motion, waving

from e3pose.base.arrays import Floats
from e3pose.estimate.smooth import SMOOTHERS, SmoothSettings, keep_limbs, smoothed
from e3pose.model.skeleton import COCO17
from e3pose.model.take import Motion, Take

NUM_SLOTS, FPS = 60, 20.0
WRIST, ANKLE = COCO17.index("left_wrist"), COCO17.index("right_ankle")


def length_m(joints_m: Floats, first: str, second: str) -> Floats:
    between = joints_m[:, COCO17.index(first)] - joints_m[:, COCO17.index(second)]
    return np.asarray(np.linalg.norm(between, axis=-1))


def guessed() -> Motion:
    """Return somebody with a wrist near the elbow and an ankle that goes astray."""
    joints_m = np.tile(BODY, (NUM_SLOTS, 1, 1)) + np.linspace(0, 2, NUM_SLOTS)[:, None, None]
    joints_m[:, WRIST] = joints_m[:, COCO17.index("left_elbow")] + [0, 0, -0.11]
    joints_m[20:40, ANKLE] += [1.2, 0.5, 0.3]
    sigma_m = np.full((NUM_SLOTS, 17), 0.02)
    sigma_m[20:40, ANKLE] = 0.19
    return motion(joints_m, sigma_m)


@each_case("method", sorted(SMOOTHERS))
def test_limbs_stay_within_what_people_have(method: str) -> None:
    take = Take("", COCO17, 1 / FPS, (guessed(),))
    found = smoothed(take, SmoothSettings(method)).motions[0]
    shank_m = length_m(found.joints_m, "right_knee", "right_ankle")
    assert shank_m.min() > 0.35 and shank_m.max() < 0.5
    left_m, right_m = (
        length_m(found.joints_m, f"{s}_elbow", f"{s}_wrist") for s in ("left", "right")
    )
    assert (2 * np.abs(left_m - right_m) / (left_m + right_m)).max() < 0.15
    assert left_m.min() > 0.15


def test_a_joint_that_had_to_move_is_less_certain() -> None:
    before = guessed()
    after = keep_limbs(before, COCO17)
    moved_m = np.linalg.norm(after.joints_m - before.joints_m, axis=-1)
    assert moved_m[30, ANKLE] > 0.5
    assert after.sigma_m[30, ANKLE] > 0.5 * moved_m[30, ANKLE]
    np.testing.assert_array_equal(after.origin, before.origin)
    hips = [COCO17.index(f"{side}_hip") for side in ("left", "right")]
    np.testing.assert_array_equal(after.joints_m[:, hips], before.joints_m[:, hips])


def test_what_is_missing_stays_missing_and_a_thing_stays_as_it_is() -> None:
    gone = guessed()
    gone.joints_m[:, ANKLE] = np.nan
    gone = motion(gone.joints_m)
    assert np.isnan(keep_limbs(gone, COCO17).joints_m[:, ANKLE]).all()
    thing = motion(waving(NUM_SLOTS, 1.0, FPS))
    assert keep_limbs(replace(thing, first=3), COCO17).joints_m is thing.joints_m
