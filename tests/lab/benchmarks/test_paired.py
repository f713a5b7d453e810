"""Paired gains and energy savings on data of known answer."""

from __future__ import annotations

import numpy as np
import pytest

from paired import (
    errors_with_misses,
    gain_percent,
    mean_interval,
    saving_percent,
)

RNG = np.random.default_rng(5)


def test_interval_is_students() -> None:
    # Mean 2, standard deviation 1, three values: t of 2 degrees of freedom is 4.303.
    interval = mean_interval(np.array([1.0, 2.0, 3.0]))
    assert interval.mean == 2
    assert interval.high - 2 == pytest.approx(4.303 / 3**0.5, abs=1e-3)
    assert interval.low == pytest.approx(4 - interval.high)
    alone = mean_interval(np.array([7.0]))
    assert (alone.low, alone.mean, alone.high) == (7, 7, 7)


def test_interval_holds_the_truth_as_often_as_it_says() -> None:
    held = 0
    for _ in range(1000):
        interval = mean_interval(RNG.normal(3.0, 2.0, 8))
        held += interval.low <= 3.0 <= interval.high
    assert 930 <= held <= 970


def test_pairs_cancel_what_recordings_have_in_common() -> None:
    reference = RNG.uniform(10, 100, 20)
    gain = gain_percent(reference, 0.8 * reference)
    assert gain.mean == pytest.approx(20) and gain.high - gain.low < 1e-9
    assert gain_percent(reference, 1.1 * reference).mean == pytest.approx(-10)


def test_energy_at_equal_error_is_read_off_the_references_curve() -> None:
    # The reference errs 60 / energy; the other needs half the energy for the same.
    counts = np.repeat([[1.0], [1.5], [2.0], [3.0]], 10, axis=1)
    level = RNG.uniform(0.9, 1.1, 10)
    saving = saving_percent(counts, 60 * level / counts, np.ones(10), 30 * level)
    assert saving is not None and saving.mean == pytest.approx(50, abs=0.1)
    assert saving.low <= saving.mean <= saving.high
    worse = saving_percent(counts, 60 * level / counts, np.full(10, 2.5), 30 * level)
    assert worse is not None and worse.mean == pytest.approx(-25, abs=0.1)


def test_an_error_that_the_reference_never_made_has_no_saving() -> None:
    counts = np.repeat([[1.0], [3.0]], 4, axis=1)
    assert saving_percent(counts, 60 / counts, np.ones(4), np.full(4, 10.0)) is None
    assert saving_percent(counts, 60 / counts, np.ones(4), np.full(4, 90.0)) is None


def test_losing_people_is_no_gain() -> None:
    kept, lost = errors_with_misses([40.0, 20.0, None], [1.0, 0.9, 0.0])[:2]
    assert kept == 40 and lost == pytest.approx(68)
    assert errors_with_misses([None], [None])[0] == 500
