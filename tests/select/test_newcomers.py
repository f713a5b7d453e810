"""People who have just come in: who could start them, and that they are paid for once."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case
from tests.rigs import looking

from e3pose.model.overlap import overlap
from e3pose.select.expected_information import FIRST_VIEW, Entrants, expected_entrants

WAIT_S, SLOT_S = 0.14, 0.08
EACH = np.eye(3, dtype=bool)


RIG = looking((4, 0), (0, 4), (3, 3))


def entrants(*ordered: list[int], people: int = 1, age_s: float = 0.0) -> Entrants:
    """Camera 0 saw somebody new `age_s` ago; the cameras of the next slots are `ordered`."""
    flight = np.array([np.isin(range(3), cameras) for cameras in ordered], dtype=bool)
    return expected_entrants(
        RIG,
        np.array([people, 0, 0]),
        np.array([age_s + (len(ordered) + 1) * SLOT_S, np.inf, np.inf]),
        WAIT_S,
        SLOT_S,
        flight.reshape(-1, 3),
    )


def sets(*cameras: list[int]) -> NDArray[np.bool_]:
    return np.array([np.isin(range(3), each) for each in cameras])


def test_cameras_overlook_what_others_see_as_far_as_they_face_it() -> None:
    shares = overlap(looking((4, 0), (3, 3), (-30, 0)))
    assert shares[0, 1] > 0.3
    assert (np.diag(shares) == 0).all()
    assert (overlap(looking((4, 0), (-4, 0), away=True)) == 0).all()


def test_nobody_to_start_is_normal() -> None:
    nobody = expected_entrants(
        RIG, np.zeros(3, np.int64), np.full(3, np.inf), WAIT_S, SLOT_S, np.zeros((2, 3), bool)
    )
    assert nobody.starts(EACH).tolist() == [0.0] * 3


def test_while_the_detection_waits_another_camera_completes_the_pair() -> None:
    alone, other = entrants().starts(sets([0], [1]))
    assert other == pytest.approx(overlap(RIG)[0, 1])
    assert alone == pytest.approx(FIRST_VIEW)


def test_once_it_has_waited_too_long_two_cameras_in_one_slot_start_the_person() -> None:
    found = entrants([], [], [])
    one, two, both = found.starts(sets([1], [2], [0, 1]))
    assert both == pytest.approx(overlap(RIG)[0, 1])
    assert one == pytest.approx(FIRST_VIEW * overlap(RIG)[0, 1])
    assert two == pytest.approx(FIRST_VIEW * overlap(RIG)[0, 2])


def test_a_look_in_flight_is_a_partner_for_another_camera_and_not_for_itself() -> None:
    free, found = entrants([], []), entrants([], [1])
    np.testing.assert_allclose(found.weights, free.weights)
    assert found.starts(sets([0]))[0] > free.starts(sets([0]))[0]
    assert found.starts(sets([1]))[0] == pytest.approx(free.starts(sets([1]))[0])


@each_case("ordered", [([1], []), ([], [0, 1]), ([], [1], [0])])
def test_an_entrant_is_paid_once(ordered: tuple[list[int], ...]) -> None:
    free = entrants(*([] for _ in ordered))
    paid = entrants(*ordered)
    met = overlap(RIG)[0, 1]
    assert paid.weights[0] == pytest.approx((1 - met) * free.weights[0])
    subsets = sets([0], [1], [2], [0, 1], [0, 2], [0, 1, 2])
    assert (paid.starts(subsets)[3:] < free.starts(subsets)[3:]).all()


def test_looks_too_far_apart_start_nobody() -> None:
    assert entrants([], [1], [], [0], []).weights[0] == 1.0


def test_everybody_new_counts() -> None:
    one, three = entrants(), entrants(people=3)
    np.testing.assert_allclose(three.starts(EACH), 3 * one.starts(EACH))
