"""Slow errors of a view, and what the next look is worth."""

from __future__ import annotations

import numpy as np
import pytest
from tests.reference import filter_bias

from e3pose.estimate.filter import bias
from e3pose.estimate.filter.outliers import MEASURED_SIGMAS
from e3pose.model.noise import ErrorMemory

TERMS = bias.memory_terms(ErrorMemory())


def test_lasting_error_is_learned_and_fades() -> None:
    true = np.full((1, 17, 2), 6.0)
    learned = np.zeros((1, 17, 2))
    sigma, sure, since = np.full((1, 17), 8.0), np.zeros((1, 17)), np.array([0.2])
    for _ in range(60):
        learned = filter_bias.fade(learned, 0.2, TERMS)
        learned = filter_bias.learn(learned, true - learned, sigma, sure, since, TERMS)
    assert 0.6 < (learned / true).mean() < 1.0  # the fading holds it back
    assert np.allclose(filter_bias.fade(learned, TERMS.lasting_s, TERMS), learned * np.exp(-1))


def test_first_look_teaches_no_more_than_what_lasts() -> None:
    error = np.full((1, 17, 2), 4.0)
    sigma, sure, never = np.full((1, 17), 8.0), np.zeros((1, 17)), np.array([np.inf])
    learned = filter_bias.learn(np.zeros((1, 17, 2)), error, sigma, sure, never, TERMS)
    np.testing.assert_allclose(learned, TERMS.most * error)


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


def test_default_memory_gives_the_tuned_constants() -> None:
    assert bias.memory_terms(ErrorMemory()) == bias.MemoryTerms(
        2.5, 0.45, 0.4, 0.45, 0.18, 0.1, 0.045
    )


def test_looks_far_apart_count_fully_where_nothing_lasts() -> None:
    for quick in (0.0, 0.5, 1.0):
        terms = bias.memory_terms(ErrorMemory(lasting_share=0.0, quick_share=quick))
        assert filter_bias.inflation(np.array(np.inf), terms) == pytest.approx(1.0)


def test_new_errors_in_every_slot_are_all_worth_the_same() -> None:
    terms = bias.memory_terms(ErrorMemory(lasting_share=0.0, quick_share=0.0))
    np.testing.assert_allclose(filter_bias.inflation(np.array([0.0, 0.04, 10.0]), terms), 1.0)
    assert terms.most == 0.0 and terms.removed == 0.0  # and no bias is learned


def test_no_more_than_was_tuned_becomes_a_bias() -> None:
    usual = bias.memory_terms(ErrorMemory(lasting_share=0.45, quick_share=0.1))
    assert bias.memory_terms(ErrorMemory(lasting_share=0.9, quick_share=0.1)) == usual
