"""Slow errors of a view: how long they last, what views repeat, and what the next look is worth."""

from __future__ import annotations

import numpy as np
import pytest
from tests.estimate.filter.room import MODEL, NUM_CAMERAS
from tests.interpreted import interpreted
from tests.reference import filter_bias

from e3pose.base.arrays import Floats
from e3pose.estimate.filter import repeated_errors
from e3pose.estimate.filter.bias import memory_terms
from e3pose.estimate.filter.covariance_inflation import MEMORY_S
from e3pose.estimate.filter.lasting import MOST, SPAN, USUAL, Lasting, grown_m2
from e3pose.estimate.filter.outliers import MEASURED_SIGMAS
from e3pose.estimate.filter.posterior import Grades
from e3pose.estimate.filter.repeated_errors import (
    COMMON,
    LEAST_WEIGHT,
    MOST_M,
    STAYS,
)
from e3pose.estimate.filter.shown import grow
from e3pose.model.noise import ErrorMemory
from e3pose.model.projection import project
from e3pose.model.uncertainty import axis_sigma_m

TERMS = memory_terms(ErrorMemory())

find_repeated = interpreted(repeated_errors.find_repeated)
weigh_biases = interpreted(repeated_errors.weigh_biases)
weigh_views = interpreted(repeated_errors.weigh_views)


def test_lasting_error_is_learned_and_fades() -> None:
    true = np.full((1, 17, 2), 6.0)
    learned = np.zeros((1, 17, 2))
    sigma, sure, since = np.full((1, 17), 8.0), np.zeros((1, 17)), np.array([0.2])
    for _ in range(60):
        learned = filter_bias.fade(learned, 0.2, TERMS)
        learned = filter_bias.learn(learned, true - learned, sigma, sure, since, TERMS)
    assert 0.6 < (learned / true).mean() < 1.0  # the fading holds it back
    assert np.allclose(filter_bias.fade(learned, TERMS.lasting_s, TERMS), learned * np.exp(-1))
    first = filter_bias.learn(0 * true, true, sigma, sure, np.array([np.inf]), TERMS)
    np.testing.assert_allclose(first, TERMS.most * true)  # no more than what lasts


def test_doubtful_people_and_wild_keypoints_teach_little() -> None:
    def taught(error_px: float, projected_variance_px2: float) -> float:
        learned = filter_bias.learn(
            np.zeros((1, 1, 2)),
            np.array([[[error_px, 0.0]]]),
            np.full((1, 1), 5.0),
            np.full((1, 1), projected_variance_px2),
            np.array([0.2]),
            TERMS,
        )
        return float(learned[0, 0, 0])

    assert taught(5, 1000) < 0.1 * taught(5, 0)
    assert taught(500, 0) == pytest.approx(taught(5.0 * MEASURED_SIGMAS, 0))


def test_looks_in_quick_succession_are_worth_less() -> None:
    factors = filter_bias.inflation(np.array([0.0, 1 / 60, 1 / 25, 0.2, 2.0, np.inf]), TERMS)
    assert np.isfinite(factors).all()
    assert (np.diff(factors) <= 0).all()
    assert factors[-1] == pytest.approx(TERMS.fresh + TERMS.quick, rel=1e-3)


def test_inflation_is_that_of_a_noise_with_memory() -> None:
    """The mean of n looks of an AR(1) noise has the variance that n inflated looks have."""
    n, step_s = 4000, 0.04
    keep = np.exp(-step_s / TERMS.quick_s)
    lags = np.arange(1, n)
    variance = (1 + 2 * ((1 - lags / n) * keep**lags).sum()) / n
    inflated = (filter_bias.inflation(np.array(step_s), TERMS) - TERMS.fresh) / TERMS.quick / n
    assert inflated == pytest.approx(variance, rel=0.01)


def test_looks_count_fully_far_apart_where_nothing_lasts_and_at_once_where_all_is_new() -> None:
    for quick in (0.0, 0.5, 1.0):
        terms = memory_terms(ErrorMemory(lasting_share=0.0, quick_share=quick))
        assert filter_bias.inflation(np.array(np.inf), terms) == pytest.approx(1.0)
    terms = memory_terms(ErrorMemory(lasting_share=0.0, quick_share=0.0))
    np.testing.assert_allclose(filter_bias.inflation(np.array([0.0, 0.04, 10.0]), terms), 1.0)
    assert terms.most == 0.0 and terms.removed == 0.0  # and no bias is learned


def test_no_more_than_was_tuned_becomes_a_bias() -> None:
    usual = memory_terms(ErrorMemory(lasting_share=0.45, quick_share=0.1))
    assert memory_terms(ErrorMemory(lasting_share=0.9, quick_share=0.1)) == usual


def after(share: float, seconds: float = 30.0) -> Lasting:
    found = Lasting()
    for _ in range(round(seconds / 0.1)):
        found = found.after(share, 0.1)
    return found


def test_biases_count_as_far_as_they_are_larger_than_usual() -> None:
    assert after(USUAL / 2).excess == 0.0
    assert after(USUAL + SPAN / 2).excess == pytest.approx(0.5, abs=0.01)
    assert after(9.0).excess == MOST
    assert 0 < after(USUAL + SPAN).after(0.0, 0.1).excess < 1 - 0.1 / MEMORY_S * USUAL


def test_slots_without_people_and_after_a_pause_say_nothing() -> None:
    begun = after(USUAL + SPAN)
    assert begun.after(np.nan, 0.1).excess == pytest.approx(begun.excess)
    assert begun.after(0.0, MEMORY_S).excess == begun.excess
    assert Lasting().after(9.0, np.nan).excess == pytest.approx(0.0)


JOINT = np.array([0.2, -0.3, 1.1, 0.0, 0.0, 0.0])
SIGMA_PX = np.linspace(2.0, 5.0, NUM_CAMERAS)


def weights(last_seen_s: Floats, delivered: float = 1.0) -> Floats:
    found = np.empty(NUM_CAMERAS)
    weigh_views(last_seen_s, np.full(NUM_CAMERAS, delivered), SIGMA_PX, TERMS, found)
    return found


def added(last_seen_s: Floats) -> Floats:
    covariance_m2 = np.empty((3, 3))
    find_repeated(JOINT, weights(last_seen_s), MODEL.rig.projections, MOST_M, covariance_m2)
    return covariance_m2


def test_it_is_the_inverse_of_what_the_views_tell() -> None:
    last_seen_s = np.linspace(0.0, 2.0, NUM_CAMERAS)
    _, depth, jacobian = project(JOINT[:3], MODEL.rig.projections)
    assert (depth > 0).all()
    variance = STAYS * TERMS.most * SIGMA_PX**2 * np.exp(2 * last_seen_s / TERMS.lasting_s)
    information = np.einsum("c,cka,ckb->ab", 1 / variance, jacobian, jacobian)
    expected = np.linalg.inv(information + np.eye(3) / MOST_M**2)
    np.testing.assert_allclose(added(last_seen_s), expected, rtol=1e-9)


def test_more_views_leave_less_and_old_ones_count_for_less() -> None:
    new, old = np.zeros(NUM_CAMERAS), np.full(NUM_CAMERAS, 1.0)
    one = np.where(np.arange(NUM_CAMERAS) == 0, 0.0, np.inf)
    assert np.trace(added(new)) < np.trace(added(old)) < 3 * MOST_M**2
    assert np.trace(added(new)) < np.trace(added(one)) < 3 * MOST_M**2


def test_nobody_who_looked_leaves_the_most_and_errors_that_do_not_last_nothing() -> None:
    assert weights(np.full(NUM_CAMERAS, np.inf)).max() == 0.0
    assert weights(np.zeros(NUM_CAMERAS), 0.9 * LEAST_WEIGHT).max() == 0.0
    np.testing.assert_allclose(added(np.full(NUM_CAMERAS, np.inf)), MOST_M**2 * np.eye(3))
    terms, found = memory_terms(ErrorMemory(lasting_share=0.0)), np.empty(NUM_CAMERAS)
    weigh_views(np.zeros(NUM_CAMERAS), np.ones(NUM_CAMERAS), SIGMA_PX, terms, found)
    covariance_m2 = np.empty((3, 3))
    find_repeated(JOINT, found, MODEL.rig.projections, MOST_M, covariance_m2)
    assert np.sqrt(np.trace(covariance_m2)) == pytest.approx(0.0, abs=1e-3)


def test_biases_that_are_learned_leave_more() -> None:
    plain, lasting, share = weights(np.zeros(NUM_CAMERAS)), np.empty(NUM_CAMERAS), np.zeros(2)
    biases_px = np.zeros((NUM_CAMERAS, 2))
    biases_px[1] = 3.0, 4.0
    seen_s = np.zeros(NUM_CAMERAS)
    weigh_biases(biases_px, seen_s, SIGMA_PX, TERMS, plain, lasting, share)
    stays = STAYS * TERMS.most * SIGMA_PX[1] ** 2
    assert lasting[1] == pytest.approx(1 / (stays + COMMON * 12.5))
    np.testing.assert_allclose(np.delete(lasting, 1), np.delete(plain, 1))
    assert share.tolist() == pytest.approx([12.5 / SIGMA_PX[1] ** 2, NUM_CAMERAS])
    weigh_biases(biases_px, seen_s + 1.0, SIGMA_PX, TERMS, plain, lasting, share)
    assert share[1] == NUM_CAMERAS  # looks of a second ago say nothing of now


def test_what_is_stated_grows_as_errors_last() -> None:
    grades, sigma_m = Grades.empty(2, 17), np.empty((2, 17))
    own_m2 = np.tile(np.diag([1e-4, 2e-4, 3e-4]), (2, 17, 1, 1))
    own_m2[1, 3] = np.nan  # a joint that was never measured
    grades.stated_m2[:], grades.repeated_m2[:] = 1.5 * own_m2, 0.5 * own_m2
    grades.lasting_m2[:] = 2.0 * own_m2
    factor = grow(0.4, own_m2, grades, sigma_m)
    stated_m2 = own_m2 + grown_m2(grades.repeated_m2, grades.lasting_m2, 0.4)
    np.testing.assert_allclose(grades.stated_m2, stated_m2)
    np.testing.assert_allclose(sigma_m, axis_sigma_m(stated_m2))
    assert factor == pytest.approx(np.sqrt(2.1))
    assert grow(0.4, own_m2[:0], Grades.empty(0, 17), sigma_m[:0]) == 0.0
