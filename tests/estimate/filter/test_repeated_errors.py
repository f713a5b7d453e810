"""The uncertainty that errors leave which views repeat."""

from __future__ import annotations

import numpy as np
import pytest
from tests.estimate.filter.room import MODEL, NUM_CAMERAS

from e3pose.base.arrays import Floats
from e3pose.estimate.filter.bias import memory_terms
from e3pose.estimate.filter.repeated_errors import (
    COMMON,
    LEAST_WEIGHT,
    MOST_M,
    STAYS,
    find_repeated,
    weigh_biases,
    weigh_views,
)
from e3pose.model.noise import ErrorMemory
from e3pose.model.projection import project

TERMS = memory_terms(ErrorMemory())
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


def test_nobody_who_looked_leaves_the_most() -> None:
    assert weights(np.full(NUM_CAMERAS, np.inf)).max() == 0.0
    assert weights(np.zeros(NUM_CAMERAS), 0.9 * LEAST_WEIGHT).max() == 0.0
    np.testing.assert_allclose(added(np.full(NUM_CAMERAS, np.inf)), MOST_M**2 * np.eye(3))


def test_a_detector_whose_errors_do_not_last_leaves_nothing() -> None:
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
