"""The records of whole people and of poses: rows, defaults, and what they refuse."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.model.people import People
from e3pose.model.pose import Poses2D
from e3pose.wire.arrays import packed_people, people_of
from e3pose.wire.site_messages import Poses

JOINTS_M = np.arange(30.0).reshape(2, 5, 3)
COVARIANCE_M2 = np.broadcast_to(np.diag([0.25, 0.5, 0.75]), (2, 5, 3, 3))
PEOPLE = People(np.array([7, 4]), JOINTS_M, full_covariance_m2=COVARIANCE_M2)


def test_what_is_not_given_is_as_unknown_as_it_can_be() -> None:
    lacking = JOINTS_M.copy()
    lacking[1, 2] = np.nan
    people = People(np.array([7, 4]), lacking)
    assert people.scores.tolist() == [[1] * 5, [1, 1, 0, 1, 1]]
    assert (people.measured == (people.scores > 0)).all()
    assert np.isnan(people.sigma_m).all() and np.isnan(people.covariance_m2).all()


def test_sigma_follows_the_covariance_and_the_other_way_round() -> None:
    np.testing.assert_allclose(PEOPLE.sigma_m, 0.5**0.5)
    wider = replace(PEOPLE, full_covariance_m2=4 * COVARIANCE_M2)
    np.testing.assert_allclose(wider.sigma_m, 2**0.5)
    plain = replace(PEOPLE, full_covariance_m2=None)
    np.testing.assert_allclose(plain.covariance_m2, np.broadcast_to(np.eye(3) / 2, (2, 5, 3, 3)))


def test_rows_are_taken_and_joined_with_all_that_belongs_to_them() -> None:
    moving = replace(PEOPLE, dynamics=np.ones((2, 5, 6)))
    first, second = moving[:1], moving[np.array([False, True])]
    assert second.track_ids.tolist() == [4] and second.dynamics is not None
    np.testing.assert_array_equal(second.joints_m, JOINTS_M[1:])
    again = People.joined([first, People.empty(5), second], 5)
    assert again.track_ids.tolist() == [7, 4] and again.dynamics is not None
    np.testing.assert_array_equal(again.sigma_m, PEOPLE.sigma_m)
    assert People.joined([first, replace(second, dynamics=None)], 5).dynamics is None
    assert len(People.joined([], 5)) == 0


def test_people_of_other_numbers_do_not_fit_their_joints() -> None:
    for name in ("track_ids", "measured", "sigma_m"):
        with pytest.raises(InputError, match=name):
            replace(PEOPLE, full_covariance_m2=None, **{name: getattr(PEOPLE, name)[:1]})


def test_a_message_keeps_everything_but_scores() -> None:
    sent = replace(PEOPLE, measured=np.arange(10).reshape(2, 5) % 2 > 0)
    found = people_of(Poses(3, 0, tuple("abcde"), *packed_people(sent)))
    assert found.joints_m.dtype == np.float32
    for name in ("track_ids", "joints_m", "measured", "scores"):
        np.testing.assert_array_equal(getattr(found, name), getattr(sent, name))
    np.testing.assert_array_equal(found.sigma_m, sent.sigma_m.astype(np.float32))


def made(positions: Any, scores: Any) -> Any:
    """Return poses of two components, or people of three; others are refused as the first."""
    if positions.shape[-1:] == (3,) and positions.ndim == 3:
        return People(np.arange(len(positions)), positions, scores)
    return Poses2D(positions, scores)


def positions_of(poses: Any) -> Any:
    return poses.keypoints_px if isinstance(poses, Poses2D) else poses.joints_m


@each_case("components", [2, 3])
def test_missing_is_nan_with_score_zero_however_it_is_said(components: int) -> None:
    positions = np.ones((2, 3, components))
    scores = np.full((2, 3), 0.5)
    positions[0, 0, 0] = np.nan  # a position without a number cannot have a score
    positions[0, 1, 0] = np.inf
    scores[1, 2] = 0.0  # nor can one without a score have a position
    poses = made(positions, scores)
    assert len(poses) == 2 and poses.scores.tolist() == [[0, 0, 0.5], [0.5, 0.5, 0]]
    missing = np.isnan(positions_of(poses)).all(axis=-1)
    assert missing.tolist() == [[True, True, False], [False, False, True]]
    assert np.isfinite(positions_of(poses)[~missing]).all()
    assert positions[1, 2, 0] == 1.0, "the caller's arrays stay as they are"


def test_nobody_is_a_normal_view() -> None:
    for nobody, components in ((Poses2D.empty(17), 2), (People.empty(17), 3)):
        assert len(nobody) == 0 and nobody.scores.shape == (0, 17)
        assert positions_of(nobody).shape == (0, 17, components)


@each_case("components", [2, 3])
@each_case("score", [-0.01, 1.01, float("nan"), float("inf")])
def test_score_outside_zero_to_one_is_refused(components: int, score: float) -> None:
    with pytest.raises(InputError, match=r"(Poses2D|People).*outside"):
        made(np.zeros((1, 2, components)), np.array([[0.5, score]]))


def test_wrong_shape_is_refused_with_both_shapes() -> None:
    with pytest.raises(InputError, match=r"positions have shape \(2, 3\)"):
        made(np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.raises(InputError, match=r"expected \(num_persons, num_joints, 3\)"):
        People(np.arange(2), np.zeros((2, 3, 2)), np.zeros((2, 3)))
    with pytest.raises(InputError, match=r"scores have shape \(3, 2\), expected \(2, 3\)"):
        made(np.zeros((2, 3, 3)), np.zeros((3, 2)))
