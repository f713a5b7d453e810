"""Who would be shown by a look: against plain products, and as laws."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.arrays import Flags, Floats
from e3pose.select.hidden_people import HiddenPeople
from e3pose.select.kernels.people import hide

SUBSETS = np.array(list(product([False, True], repeat=3)))
EACH = np.eye(3, dtype=bool)


def expected_hidden(needed: Flags, shown: Floats, ordered: Flags) -> HiddenPeople:
    useful, hidden = shown.copy(), np.empty(len(needed))
    hide(useful, needed, ordered, hidden)
    return HiddenPeople(hidden, useful)


def of_one(shown: list[float], needed: list[int], *ordered: list[int]) -> HiddenPeople:
    return expected_hidden(
        np.isin(range(3), needed)[None],
        np.array(shown)[:, None],
        np.array([np.isin(range(3), cameras) for cameras in ordered]).reshape(-1, 3),
    )


def test_only_cameras_that_are_needed_have_somebody_shown() -> None:
    people = of_one([0.9, 0.9, 0.6], [1, 2])
    assert people.reveals(EACH) == pytest.approx([0.0, 0.9, 0.6])
    assert people.reveals(np.ones((1, 3), dtype=bool)) == pytest.approx([1 - 0.1 * 0.4])


def test_people_who_are_shown_anyway_ask_for_nothing() -> None:
    assert of_one([0.9, 0.9, 0.9], []).reveals(SUBSETS).tolist() == [0.0] * 8
    assert HiddenPeople.nobody(3).reveals(SUBSETS).tolist() == [0.0] * 8


@each_case("lead", [2, 4, 6])
def test_who_is_shown_by_looks_in_flight_is_not_paid_again(lead: int) -> None:
    orders: list[list[int]] = [[] for _ in range(lead - 1)]
    orders[0] = [1]
    people = of_one([0.9, 0.9, 0.6], [1, 2], *orders)
    free = of_one([0.9, 0.9, 0.6], [1, 2], *([] for _ in orders))
    np.testing.assert_allclose(people.reveals(SUBSETS), 0.1 * free.reveals(SUBSETS))
    useless = of_one([0.9, 0.9, 0.6], [1, 2], *([0] for _ in orders))
    np.testing.assert_allclose(useless.reveals(SUBSETS), free.reveals(SUBSETS))


@each_case("seed", range(4))
def test_more_cameras_show_more_with_diminishing_returns(seed: int) -> None:
    rng = np.random.default_rng(seed)
    needed, ordered = rng.uniform(size=(4, 3)) < 0.5, rng.uniform(size=(2, 3)) < 0.3
    people = expected_hidden(needed, rng.uniform(0, 1, (3, 4)), ordered)
    value = dict(zip(map(tuple, SUBSETS.tolist()), people.reveals(SUBSETS), strict=True))
    for small in SUBSETS:
        for camera, other in product(range(3), repeat=2):
            if camera != other and not small[camera] and not small[other]:
                first = value[tuple(small | EACH[camera])] - value[tuple(small)]
                more = small | EACH[other]
                later = value[tuple(more | EACH[camera])] - value[tuple(more)]
                assert -1e-12 <= later <= first + 1e-12
