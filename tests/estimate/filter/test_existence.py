"""People whom no camera sees for a while: carried on, doubted, and given up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.estimate.filter.room import ALL, MODEL, error_m, run, see, spread_m, standing, step
from tests.reference.filter_associate import associate
from tests.reference.filter_learned_noise import knots_px

from e3pose.model.pose import Poses2D

KNOTS_PX = knots_px(MODEL, np.zeros((len(MODEL.rig) + 1, 2)))[0]


def test_uncertainty_grows_unseen_and_shrinks_seen() -> None:
    person = standing((0.0, 0.0))
    belief, seen = run(see(person) for _ in range(10))
    belief, unseen = run([{}] * 5, belief=belief)
    _, again = run([see(person, (0,)), see(person, (2,))], belief=belief)
    spreads = [spread_m(e) for e in (seen[-1], *unseen, *again)]
    assert np.all(np.diff(spreads[:6]) > 0)
    assert spreads[7] < spreads[6] < spreads[5]


def test_unseen_people_are_carried_and_say_so() -> None:
    person = standing((0.0, 0.0))
    belief, _ = run(see(person) for _ in range(10))
    _, estimates = run([{}], belief=belief)
    assert estimates[0].track_ids.tolist() == [1]
    assert not estimates[0].measured.any()
    assert error_m(estimates[0], person)[0, 0] < 0.005


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


def test_who_could_be_anywhere_is_followed_but_not_shown() -> None:
    belief, _ = run(see(standing((0.0, 0.0))) for _ in range(10))
    belief, estimates = run([{}] * 20, belief=belief)
    assert len(estimates[2]) == 1
    assert len(estimates[-1]) == 0
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


def test_who_left_the_sight_of_all_cameras_is_gone_after_a_second() -> None:
    belief, _ = run(see(standing((0.0, 0.0))) for _ in range(10))
    _, estimates = run([{}] * 30, belief=belief)
    assert [len(estimates[i]) for i in (5, 29)] == [1, 0]


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
