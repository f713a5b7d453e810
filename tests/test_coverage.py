"""What cameras show at places is learned, and forgotten only when it changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from e3pose.coverage import CELL_M, MOST_VIEWS, Coverage, learn, with_coverage
from e3pose.filter.existence import DELIVERED_LASTS_S, DELIVERED_PRIOR, DELIVERED_RATE
from e3pose.filter.outlook import Outlook
from e3pose.simulate.rigs import ring_rig

RIG = ring_rig(3, 4.0, 2.0, (640, 480), np.random.default_rng(0))
DT = 0.04
PRIOR = DELIVERED_PRIOR


def people(
    delivered: NDArray[np.float64] | list[list[float]],
    places: list[tuple[float, float]],
    ids: list[int] | None = None,
    last_seen_s: float = 0.0,
) -> Outlook:
    count = len(places)
    joints = np.zeros((count, 17, 3))
    joints[..., :2] = np.array(places).reshape(count, 1, 2)
    return Outlook(
        track_ids=np.array(ids if ids is not None else range(count), dtype=np.int64),
        confirmed=np.ones(count, dtype=bool),
        joints_m=joints,
        covariance_m2=np.broadcast_to(1e-4 * np.eye(3), (count, 17, 3, 3)),
        delivered=np.array(delivered, dtype=np.float64).reshape(count, 3),
        last_seen_s=np.full((count, 3), last_seen_s),
        sigma_px=np.full(3, 5.0),
        unexplained=np.zeros(3, dtype=np.int64),
    )


def watched(
    told: list[float], place: tuple[float, float], slots: int, age_s: float = 0.0
) -> Coverage:
    """Let all cameras look at one person for some slots, each telling its share."""
    coverage = Coverage.none(RIG)
    delivered = np.full(3, PRIOR)
    for _ in range(slots):
        coverage = learn(coverage, people([delivered.tolist()], [place], last_seen_s=age_s), DT)
        faded = PRIOR + np.exp(-DT / DELIVERED_LASTS_S) * (delivered - PRIOR)
        delivered = faded + DELIVERED_RATE * (np.array(told) - faded)
    return coverage


def test_nothing_is_expected_to_differ_before_anything_was_seen() -> None:
    outlook = people([[0.5, 0.9, 0.1]], [(0.0, 0.0)])
    fresh = with_coverage(outlook, Coverage.none(RIG))
    np.testing.assert_array_equal(fresh.delivered, outlook.delivered)


def test_a_camera_that_shows_nobody_at_a_place_is_expected_to_show_nobody_new_there() -> None:
    coverage = watched([0.0, 0.8, 0.4], (1.0, -0.5), 100)
    share = coverage.share(np.array([[1.0, -0.5]]))[0]
    assert share == pytest.approx([0.0, 0.8, 0.4], abs=0.04)
    newcomer = people([[PRIOR] * 3], [(1.0, -0.5)], ids=[77])
    expected = with_coverage(newcomer, coverage).delivered[0]
    assert expected[0] < 0.01 and expected[1] == PRIOR and 0.1 < expected[2] < PRIOR
    elsewhere = people([[PRIOR] * 3], [(-2.0, 2.0)], ids=[77])
    np.testing.assert_allclose(with_coverage(elsewhere, coverage).delivered, PRIOR)


def test_learning_spreads_no_further_than_a_cell() -> None:
    coverage = watched([0.0, 0.0, 0.0], (0.0, 0.0), 50)
    near = coverage.share(np.array([[0.3 * CELL_M, 0.0]]))
    far = coverage.share(np.array([[2.1 * CELL_M, 0.0]]))
    assert near.max() < 0.2 and far.min() == PRIOR


def test_slots_without_views_teach_nothing() -> None:
    coverage = Coverage.none(RIG)
    delivered = np.array([[0.9, 0.1, 0.5]])
    for _ in range(20):
        coverage = learn(coverage, people(delivered, [(0.0, 0.0)]), DT)
        delivered = PRIOR + np.exp(-DT / DELIVERED_LASTS_S) * (delivered - PRIOR)
    assert coverage.views.sum() == 0


def test_people_who_may_be_gone_teach_nothing() -> None:
    assert watched([0.0, 0.0, 0.0], (0.0, 0.0), 30, age_s=1.0).views.sum() == 0


def test_what_is_moved_away_is_found_out() -> None:
    coverage = watched([0.0] * 3, (0.0, 0.0), 500)
    assert coverage.views.max() <= MOST_VIEWS + 1e-9
    after = watched([0.8] * 3, (0.0, 0.0), 150)
    merged = replace(
        coverage,
        told=coverage.told + after.told,
        views=coverage.views + after.views,
    )
    assert merged.share(np.zeros((1, 2))).min() > 0.3


def test_people_far_outside_are_no_error() -> None:
    coverage = watched([0.0, 0.5, 1.0], (500.0, -900.0), 5)
    assert np.isfinite(coverage.share(np.array([[1e5, -1e5]]))).all()
    nobody = people(np.zeros((0, 3)), [])
    assert len(with_coverage(nobody, learn(coverage, nobody, DT))) == 0
