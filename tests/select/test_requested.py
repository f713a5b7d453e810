"""Looks that are asked for: one camera more, that shows whom they are for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.select.test_awake import KNOWN, RIG, situation
from tests.select.test_expected_information import outlook, person

from e3pose.model.look_request import NO_REQUEST, LookRequest
from e3pose.select.expected_information import foresee
from e3pose.select.requested import asked_for, with_requested

SEEN = outlook(np.stack([person(0, 0), person(1, -1)]), RIG)
NOW = situation(foresee(RIG, SEEN, 0.04), KNOWN)
ONE = np.arange(5) == 0


def test_nothing_is_added_where_nothing_is_asked_for() -> None:
    assert (with_requested(ONE, NOW, NO_REQUEST) == ONE).all()


def test_a_second_camera_is_added_and_no_third() -> None:
    found = with_requested(ONE, NOW, LookRequest(2.0))
    assert found[0] and found.sum() == 2
    assert (with_requested(found, NOW, LookRequest(2.0)) == found).all()


def test_only_cameras_that_can_be_reached_are_added() -> None:
    there = replace(NOW, online=ONE)
    assert (with_requested(ONE, there, LookRequest(2.0)) == ONE).all()


def test_a_policy_without_foresight_decides_alone() -> None:
    blind = replace(NOW, foresight=None)
    assert (with_requested(ONE, blind, LookRequest(2.0)) == ONE).all()


def test_who_is_asked_for_weighs_alone_where_they_are_there() -> None:
    assert NOW.foresight is not None
    weights = asked_for(NOW.foresight, LookRequest(2.0, (int(SEEN.expected.track_ids[1]),))).weights
    before = NOW.foresight.weights
    assert weights[1] == before[1] > weights[0] == 0
    assert (asked_for(NOW.foresight, LookRequest(2.0, (99,))).weights == before).all()
