"""Who exists: who is born, wide, gone or hidden, and the number that each gets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.room import (
    ALL,
    BODY,
    MODEL,
    error_m,
    run,
    see,
    spread_m,
    standing,
    step,
    turn,
)
from tests.reference.filter_associate import associate
from tests.reference.filter_existence import end, wide
from tests.reference.filter_learned_noise import knots_px

from e3pose.base.arrays import Floats
from e3pose.estimate.filter import Belief
from e3pose.estimate.filter.estimator import Filtered
from e3pose.estimate.filter.existence import MOST_WIDE_M
from e3pose.estimate.filter.step import StepKernel
from e3pose.model.pose import Poses2D

KNOTS_PX = knots_px(MODEL, np.zeros((len(MODEL.rig) + 1, 2)))[0]


def test_unseen_people_are_carried_less_and_less_certainly_and_say_so() -> None:
    person = standing((0.0, 0.0))
    belief, seen = run(see(person) for _ in range(10))
    belief, unseen = run([{}] * 5, belief=belief)
    assert unseen[0].track_ids.tolist() == [1]
    assert not unseen[0].measured.any()
    assert error_m(unseen[0], person)[0, 0] < 0.005
    _, again = run([see(person, (0,)), see(person, (2,))], belief=belief)
    spreads = [spread_m(e) for e in (seen[-1], *unseen, *again)]
    assert np.all(np.diff(spreads[:6]) > 0)
    assert spreads[7] < spreads[6] < spreads[5]


def test_joint_never_seen_is_nan() -> None:
    person = standing((0.0, 0.0))
    slots = []
    for slot in range(10):
        views = see(person, (slot % 5, (slot + 2) % 5))
        hidden = np.where(np.arange(17) == 9, 0.0, 0.9)[None]
        slots.append({c: Poses2D(v.keypoints_px, hidden) for c, v in views.items()})
    _, estimates = run(slots)
    assert np.isnan(estimates[-1].joints_m[0, 9]).all()
    assert np.isnan(estimates[-1].covariance_m2[0, 9]).all()
    assert np.isfinite(np.delete(estimates[-1].joints_m[0], 9, axis=0)).all()


def test_cameras_that_are_off_are_no_miss() -> None:
    person = standing((0.0, 0.0))
    belief, _ = run(see(person) for _ in range(10))
    belief, _ = run([{}] * 12, belief=belief)
    assert belief.existence[0] > 0.7
    empty = {camera: Poses2D.empty(17) for camera in ALL}
    _, estimates = run([empty] * 12, belief=belief)
    assert len(estimates[-1]) == 0


def test_after_a_long_pause_nobody_is_assumed_and_ids_go_on() -> None:
    person = standing((0.0, 0.0))
    belief, _ = run(see(person) for _ in range(10))
    belief, estimate = step(MODEL, belief, {}, belief.time_s + 60)
    assert len(estimate) == 0
    _, estimates = run((see(person) for _ in range(5)), belief=belief)
    assert estimates[-1].track_ids.tolist() == [2]


def test_detections_that_fit_badly_do_not_keep_a_track_alive() -> None:
    belief, _ = run(see(standing((0.0, 0.0))) for _ in range(10))
    exact, off = standing((0.0, 0.0)), standing((0.0, 0.0)) + [0.12, 0.12, 0.0]
    fits = {}
    for name, people in (("exact", exact), ("off", off)):
        rows, fit, _ = associate(
            belief,
            see(people, (0,))[0].keypoints_px,
            np.full((1, 17), 0.9),
            0,
            MODEL,
            KNOTS_PX,
        )
        assert rows.tolist() == [0]
        fits[name] = fit[0]
    assert fits["exact"] > 0.98  # next to nothing is lost to the track's own doubt
    assert 0 <= fits["off"] < 0.9


def test_who_could_be_anywhere_takes_nobodys_detection() -> None:
    belief, _ = run(see(standing((0.0, 0.0), (0.5, 0.3))) for _ in range(10))
    # Seen without noise, either of them may have been started first.
    lost, near = np.argsort(belief.state[:, :, 0].mean(axis=1)).tolist()
    covariance = belief.covariance.copy()
    covariance[lost, :, :3, :3] += 0.25 * np.eye(3)
    belief = replace(belief, covariance=covariance)
    view = see(standing((0.48, 0.3)), (0,))[0]
    rows, _, _ = associate(belief, view.keypoints_px, view.scores, 0, MODEL, KNOTS_PX)
    assert (rows[lost], rows[near]) == (-1, 0)
    swapped = replace(belief, state=belief.state[::-1])
    rows, _, _ = associate(swapped, view.keypoints_px, view.scores, 0, MODEL, KNOTS_PX)
    assert (rows[lost], rows[near]) == (0, -1)


def test_who_could_be_anywhere_is_followed_and_after_half_a_second_not_shown() -> None:
    belief, _ = run(see(standing((0.0, 0.0))) for _ in range(10))
    belief, estimates = run([{}] * 20, belief=belief)
    assert [len(estimates[i]) for i in (2, 5, 19)] == [1, 1, 0]
    assert len(belief) == 1
    _, estimates = run((see(standing((0.0, 0.0))) for _ in range(3)), belief=belief)
    assert estimates[-1].track_ids.tolist() == [1]


def test_what_each_camera_delivered_is_remembered() -> None:
    person = standing((0.0, 0.0))
    belief, _ = run(see(person) for _ in range(5))
    empty = Poses2D.empty(17)
    belief, _ = run(
        (see(person, (0,), score=0.95) | see(person, (2,), score=0.3) | {1: empty}
         for _ in range(10)),
        belief=belief,
    )  # fmt: skip
    good, none, bad = belief.delivered[0, :3].tolist()
    assert good > 0.9
    assert none < 0.05 < bad < 0.15
    assert belief.last_seen_s[0].tolist() == pytest.approx([0, 0.4, 0, 0.4, 0.4])
    later, _ = run([{}] * 20, belief=belief)
    assert none < later.delivered[0, 1] < 0.5  # it may be worth another look
    assert later.last_seen_s[0, 0] == pytest.approx(0.8)


def test_uncertainty_of_who_is_unseen_is_that_of_the_prediction() -> None:
    person = standing((0.0, 0.0))
    belief, _ = run(see(person) for _ in range(20))
    assert (belief.bone_counts > 5).all()  # bones are known, but tell nothing about places
    nothing, _ = run([{}] * 5, belief=belief)
    elsewhere, _ = run([{0: Poses2D.empty(17)}] * 5, belief=belief)
    least = [
        np.trace(b.covariance[0, :, :3, :3], axis1=1, axis2=2).min() for b in (nothing, elsewhere)
    ]
    assert least[1] == pytest.approx(least[0], rel=0.05)


FPS = 12.5
MIDDLE = (-0.5, 0.5)
NOBODY = {camera: Poses2D.empty(17) for camera in ALL}


def standing_there(hidden: dict[int, Poses2D]) -> Belief:
    """Return the belief of somebody who stands in the middle; some cameras never show it."""
    person = standing(MIDDLE)
    belief, _ = run((see(person) | hidden for _ in range(50)), FPS)
    return belief


def test_who_is_missed_in_plain_sight_is_soon_gone() -> None:
    looks = ({turn(slot)[0]: Poses2D.empty(17)} for slot in range(8))
    _, estimates = run(looks, FPS, belief=standing_there({}))
    assert 2 <= [len(estimate) for estimate in estimates].index(0) <= 4


def test_who_is_hidden_behind_a_pillar_stays() -> None:
    """Two of five cameras never show the middle; people there were seen by the others."""
    hidden = {0: Poses2D.empty(17), 3: Poses2D.empty(17)}
    belief, estimates = run([hidden] * 2, FPS, belief=standing_there(hidden))
    assert [len(estimate) for estimate in estimates] == [1, 1]
    _, estimates = run([NOBODY] * 2, FPS, belief=belief)
    assert len(estimates[0]) == 0


def test_a_false_start_takes_no_number() -> None:
    estimator = Filtered(MODEL, StepKernel())
    memory, first, ghost = estimator.begin(), standing((0.0, 0.0)), standing((1.2, 0.8))
    second = standing((-1.2, 0.9))
    slots = [see(first)] * 10
    for _ in range(3):  # two cameras agree on somebody whom no other confirms
        slots += [{**see(first), **see(np.concatenate([first, ghost]), (0, 2))}, *[see(first)] * 20]
    slots += [see(np.concatenate([first, second]))] * 10
    started, shown = 0, []
    for slot, views in enumerate(slots):
        memory, estimate = estimator.estimate(memory, views, slot / 25, lambda: 0.0)
        started = max(started, memory.belief.next_id - 1)
        shown.append(estimate.people.track_ids.tolist())
    assert started == 2 and len(memory.belief) == 2
    assert shown[5] == [1] and shown[-1] == [1, 2]
    assert max(map(len, shown)) == 2


LEFT, RIGHT = [5, 7, 9, 11, 13, 15], [6, 8, 10, 12, 14, 16]


def stretched(factor: float) -> Floats:
    """Return a body `(1, 17, 3)` as many times as wide."""
    return (BODY * [1.0, factor, 1.0])[None]


def test_shoulders_and_hips_of_people_are_not_wide_and_twice_that_is() -> None:
    body_m = float(np.ptp(BODY[5:7, 1]) + np.ptp(BODY[11:13, 1]))
    assert body_m == pytest.approx(0.64)
    assert not wide(stretched(0.99 * MOST_WIDE_M / body_m), MODEL)[0]
    assert wide(stretched(1.01 * MOST_WIDE_M / body_m), MODEL)[0]
    joints_m = stretched(3.0)
    joints_m[:, 5] = np.nan
    assert not wide(joints_m, MODEL)[0]  # of a width that is not known nothing is said


@each_case(("factor", "born"), [(1.0, 1), (2.0, 0)])
def test_a_pair_of_views_that_meets_in_a_wide_body_starts_nobody(factor: float, born: int) -> None:
    belief, _ = run([see(stretched(factor), (0, 2))])
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
