"""The record of whole people: its rows, its defaults, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from e3pose.base.errors import InputError
from e3pose.model.people import People
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
