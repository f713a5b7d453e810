"""Histories as the network takes them: the compiled form against plain numpy."""

from __future__ import annotations

import numpy as np
from tests.cases import each_case
from tests.reference import normalise as plain

from e3pose.base.arrays import Floats
from e3pose.predict.normalise import NUM_COMMON
from e3pose_lab.prediction.normalise import Normalised, fill_gaps, normalise


def histories(seed: int, num_slots: int = 10) -> Floats:
    """Return people with gaps, one who is missing and joints that are light years away."""
    rng = np.random.default_rng(seed)
    people = rng.normal(scale=0.4, size=(6, NUM_COMMON, 3))
    walk = np.cumsum(rng.normal(scale=0.02, size=(num_slots, 6, NUM_COMMON, 3)), axis=0)
    history = people + walk
    history[rng.random(history.shape[:3]) < 0.3] = np.nan
    history[:, 1] = np.nan
    history[:, 2, 4] = np.nan
    history[3, 3] = np.nan
    history[5, 4, :3] = 1e6
    history[:, 5, :4] = 0.25  # no width: faces nowhere
    return history


@each_case("seed", range(5))
def test_gaps_are_closed_as_in_numpy(seed: int) -> None:
    history = histories(seed)
    filled, measured = fill_gaps(history)
    expected, known = plain.fill_gaps(history)
    np.testing.assert_array_equal(measured, known)
    np.testing.assert_allclose(filled, expected, atol=1e-12)


@each_case("num_slots", [1, 4, 10, 13])
@each_case("interval_s", [1 / 25, 1e-3, 2.0])
def test_people_are_described_as_in_numpy(num_slots: int, interval_s: float) -> None:
    history = histories(num_slots, num_slots=max(num_slots, 6))[:num_slots]
    found, expected = (form(history, interval_s, 10) for form in (normalise, plain.normalise))
    for name in Normalised.__dataclass_fields__:
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=2e-6, atol=1e-6, err_msg=name
        )


def test_people_may_have_intervals_of_their_own() -> None:
    intervals_s = np.linspace(0.02, 0.1, 6)
    found = normalise(histories(0), intervals_s, 10).context[:, 1]
    np.testing.assert_allclose(found, np.log(30 * intervals_s), rtol=1e-6)
