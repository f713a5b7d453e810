"""What every smoother promises, and what low-pass filters do to waves."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.smooth.motions import motion, waving

from e3pose.base.errors import InputError
from e3pose.estimate.smooth import SMOOTHERS, SmoothSettings, butterworth, smoothed
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
