"""Bodies of twice a person's width: views of which one took a front for a back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.room import BODY, MODEL, run, see
from tests.reference.filter_existence import end, wide

from e3pose.base.arrays import Floats
from e3pose.estimate.filter import Belief, Model
from e3pose.estimate.filter.existence import MOST_WIDE_M
from e3pose.estimate.filter.step import StepKernel
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton

SIMULATED = load_noise("simulated")


LEFT, RIGHT = [5, 7, 9, 11, 13, 15], [6, 8, 10, 12, 14, 16]


def stretched(factor: float) -> Floats:
    """Return a body `(1, 17, 3)` as many times as wide."""
    return (BODY * [1.0, factor, 1.0])[None]


def test_shoulders_and_hips_of_people_are_not_wide_and_twice_that_is() -> None:
    body_m = float(np.ptp(BODY[5:7, 1]) + np.ptp(BODY[11:13, 1]))
    assert body_m == pytest.approx(0.64)
    assert not wide(stretched(0.99 * MOST_WIDE_M / body_m), MODEL)[0]
    assert wide(stretched(1.01 * MOST_WIDE_M / body_m), MODEL)[0]


def test_nothing_is_said_of_a_width_that_is_not_known() -> None:
    joints_m = stretched(3.0)
    joints_m[:, 5] = np.nan
    assert not wide(joints_m, MODEL)[0]
    no_girdles = Model(MODEL.rig, Skeleton("none", ("nose", "neck"), ()), SIMULATED)
    assert not wide(np.zeros((1, 2, 3)), no_girdles)[0]


@each_case("compiled", [False, True])
@each_case(("factor", "born"), [(1.0, 1), (2.0, 0)])
def test_a_pair_of_views_that_meets_in_a_wide_body_starts_nobody(
    compiled: bool, factor: float, born: int
) -> None:
    views = see(stretched(factor), (0, 2))
    belief = Belief.empty(MODEL)
    if compiled:
        belief, _ = StepKernel()(MODEL, belief, views, 0.0)
    else:
        belief, _ = run([views])
    assert (len(belief), belief.next_id) == (born, born + 1)
    assert len(belief.leftovers) == 2 - 2 * born  # they wait for other views


def test_a_track_that_mirrored_views_widen_is_dropped() -> None:
    person = stretched(1.0)
    belief, _ = run([see(person, (0, 2))])
    state = belief.state.copy()
    state[..., 1] *= 2
    wider = replace(belief, state=state)
    assert len(end(belief, MODEL)) == 1
    assert len(end(wider, MODEL)) == 0


def test_one_mirrored_view_does_not_end_somebody_whom_all_know() -> None:
    person = stretched(1.0)
    belief, _ = run(see(person) for _ in range(20))
    mirrored = {}
    for camera, view in see(person).items():
        keypoints = view.keypoints_px.copy()
        if camera == 1:
            keypoints[:, LEFT + RIGHT] = keypoints[:, RIGHT + LEFT]
        mirrored[camera] = Poses2D(keypoints, view.scores)
    _, estimates = run([mirrored] * 10, belief=belief)
    assert estimates[-1].track_ids.tolist() == [1]
