"""What every smoother promises, and limbs of smoothed people."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.room import BODY
from tests.estimate.smooth.motions import motion, waving

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.estimate.smooth import SMOOTHERS, SmoothSettings, butterworth, keep_limbs, smoothed
from e3pose.estimate.smooth.gaps import fill_gaps, stretches
from e3pose.model.skeleton import COCO17
from e3pose.model.take import FILLED, MEASURED, MISSING, Motion, Take

FPS = 50.0


def take(*motions: Motion) -> Take:
    return Take("a take", COCO17, 1 / FPS, motions)


@each_case("method", sorted(SMOOTHERS))
def test_what_is_missing_stays_missing_and_what_rests_stays(method: str) -> None:
    joints = np.ones((30, 17, 3))
    joints[10:14, 3] = np.nan
    joints[:, 5] = np.nan
    before = motion(joints, first=4)
    (after,) = smoothed(take(before), SmoothSettings(method)).motions
    assert (after.first, after.track_id, len(after)) == (4, 7, 30)
    np.testing.assert_allclose(after.joints_m, joints, atol=1e-9)
    np.testing.assert_array_equal(after.origin, before.origin)
    np.testing.assert_array_equal(after.scores, before.scores)


@each_case("method", sorted(SMOOTHERS))
def test_noise_falls(method: str) -> None:
    rng = np.random.default_rng(0)
    true = waving(200, 0.3, FPS)
    before = motion(true + rng.normal(scale=0.01, size=true.shape))
    (after,) = smoothed(take(before), SmoothSettings(method)).motions
    jerk = [np.abs(np.diff(m.joints_m, 2, axis=0)).mean() for m in (before, after)]
    assert jerk[1] < 0.5 * jerk[0]


@each_case("method", sorted(SMOOTHERS))
def test_one_slot_alone_stays(method: str) -> None:
    before = motion(np.ones((1, 17, 3)))
    (after,) = smoothed(take(before), SmoothSettings(method)).motions
    np.testing.assert_allclose(after.joints_m, 1.0)


@each_case(("hz", "gain", "within"), [(0.5, 1.0, 0.01), (6.0, 0.5**0.5, 0.03), (15.0, 0.0, 0.03)])
def test_butterworth_halves_the_power_at_its_cutoff(hz: float, gain: float, within: float) -> None:
    waves = waving(400, hz, FPS)
    found = butterworth(motion(waves), 1 / FPS, 6.0).joints_m[100:300, 0, 0]
    wave = waves[100:300, 0, 0]
    assert found @ wave / (wave @ wave) == pytest.approx(gain, abs=within)  # and without delay


def test_cutoffs_are_checked() -> None:
    some = take(motion(np.ones((30, 17, 3))))
    with pytest.raises(InputError, match=r"less than 20\.1 Hz at 50 slots per second"):
        smoothed(some, SmoothSettings("butterworth", 25.0))
    with pytest.raises(InputError, match="butterworth or one-euro"):
        smoothed(some, SmoothSettings("rts", 6.0))
    with pytest.raises(InputError, match="found 'best', expected rts"):
        smoothed(some, SmoothSettings("best"))
    slow = Take("slow", COCO17, 0.1, some.motions)
    smoothed(slow, SmoothSettings("butterworth"))  # its own cut-off fits any rate


@each_case(
    ("known", "longest", "found"),
    [
        ("", 5, []),
        ("...", 5, []),
        ("xxx", 0, [(0, 3)]),
        (".x.xx.", 0, [(1, 2), (3, 5)]),
        (".x.xx.", 1, [(1, 5)]),
        ("x..x...x", 2, [(0, 4), (7, 8)]),
    ],
)
def test_stretches(known: str, longest: int, found: list[tuple[int, int]]) -> None:
    flags = np.array([one == "x" for one in known], dtype=bool)
    assert list(stretches(flags, longest)) == found


def test_short_gaps_are_filled_and_marked_long_ones_left() -> None:
    joints = waving(60, 0.5, FPS)
    joints[20:24, 9] = np.nan
    joints[40:50, 9] = np.nan
    joints[:3, 4] = np.nan
    after = fill_gaps(motion(joints), 4)
    assert (after.origin[20:24, 9] == FILLED).all()
    assert (after.origin[40:50, 9] == MISSING).all()
    assert (after.origin[:3, 4] == MISSING).all()  # there is nothing before
    assert (after.origin[:, :9] != FILLED).all()
    apart = np.linalg.norm(after.joints_m - waving(60, 0.5, FPS), axis=-1)
    assert apart[20:24, 9].max() < 0.002
    assert after.scores[21, 9] == 0.9
    nothing = fill_gaps(motion(joints), 0)
    assert ((nothing.origin == MEASURED) | (nothing.origin == MISSING)).all()


NUM_SLOTS, LIMBS_FPS = 60, 20.0
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
    take = Take("", COCO17, 1 / LIMBS_FPS, (guessed(),))
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
    thing = motion(waving(NUM_SLOTS, 1.0, LIMBS_FPS))
    assert keep_limbs(replace(thing, first=3), COCO17).joints_m is thing.joints_m
