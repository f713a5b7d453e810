"""Offsets of many cameras from the shifts of pairs."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.calibrate.synchronise import (
    disagreement,
    incidence,
    spanning_tree_offsets,
    subsample_peak,
)


@each_case("peak", [3.0, 3.3, 2.6])
def test_peak_of_a_parabola_is_found_between_samples(peak: float) -> None:
    values = 5.0 - (np.arange(7, dtype=np.float64) - peak) ** 2
    best = int(values.argmax())
    assert best + subsample_peak(values, best) == pytest.approx(peak)


def test_peak_at_an_end_stays_there() -> None:
    assert subsample_peak(np.array([3.0, 2.0, 1.0]), 0) == 0.0
    assert subsample_peak(np.array([1.0, 2.0, 3.0]), 2) == 0.0


def test_most_certain_pairs_win_in_either_direction() -> None:
    pairs = [(2, 1, -0.5), (0, 2, 2.0), (0, 1, 9.0), (3, 0, -4.0)]
    assert spanning_tree_offsets(4, pairs).tolist() == [0.0, 1.5, 2.0, 4.0]


def test_camera_that_no_pair_links_with_the_first_has_no_offset() -> None:
    offsets = spanning_tree_offsets(4, [(2, 3, 1.0), (0, 1, 5.0)])
    assert offsets[:2].tolist() == [0.0, 5.0]
    assert np.isnan(offsets[2:]).all()


def test_disagreement_is_the_weighted_root_mean_square_of_a_cameras_pairs() -> None:
    pairs = [(0, 1, 1.0), (0, 2, 2.0), (1, 2, 1.4), (0, 3, 7.0)]
    rows = incidence(4, pairs)
    misses = rows @ np.array([0.0, 1.0, 2.0, 7.0]) - np.array([shift for *_, shift in pairs])
    found = disagreement(rows, misses, np.array([1.0, 1.0, 3.0, 1.0]))
    assert found[:3] == pytest.approx([0.0, 0.4 * np.sqrt(0.75), 0.4 * np.sqrt(0.75)])
    assert np.isnan(found[3])
