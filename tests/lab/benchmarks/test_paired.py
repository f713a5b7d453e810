"""Judges of versions: paired gains, statistics of errors, people who are made up."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import e3pose.evaluate.replay as replaying
import filter_terms
from detector_errors import Keypoints, by_direction, capped, remembered, shared
from e3pose.evaluate.held_out import turns
from e3pose.simulate import SceneSettings, simulate
from filter_terms import Case, figures
from paired import errors_with_misses, gain_percent, mean_interval, saving_percent

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
    for never in (10.0, 90.0):  # an error that the reference never made
        assert saving_percent(counts, 60 / counts, np.ones(10), np.full(10, never)) is None


def test_losing_people_is_no_gain() -> None:
    kept, lost = errors_with_misses([40.0, 20.0, None], [1.0, 0.9, 0.0])[:2]
    assert kept == 40 and lost == pytest.approx(68)
    assert errors_with_misses([None], [None])[0] == 500


INTERVAL_S = 0.04


def keypoints(errors: NDArray[np.float64], sector: NDArray[np.int64] | None = None) -> Keypoints:
    """Errors `(num_series, num_slots, 2)` in centimetres, each series of one joint in one view."""
    number, slots = errors.shape[:2]
    flat = errors.reshape(-1, 2)
    series = np.repeat(np.arange(number), slots)
    ones = np.ones(len(flat))
    return Keypoints(
        flat, flat, ones, 0 * series, 0 * series, series, np.tile(np.arange(slots), number),
        0 * series if sector is None else sector, 0 * ones, 0 * ones, ones < 0, ones > 0, ones > 0,
        ones, ones, ones,
    )  # fmt: skip


def test_errors_that_last_correlate_and_new_ones_do_not() -> None:
    rng = np.random.default_rng(0)
    lasting, new = rng.normal(size=(400, 1, 2)), rng.normal(size=(400, 200, 2))
    for share in (0.0, 0.5, 1.0):
        errors = np.sqrt(share) * lasting + np.sqrt(1 - share) * new
        found = remembered(keypoints(errors), INTERVAL_S)
        assert found == pytest.approx([share] * 4, abs=0.05)


def test_a_lag_never_reaches_from_one_series_to_another() -> None:
    errors = np.repeat(np.random.default_rng(1).normal(size=(1, 60, 2)), 50, axis=0)
    assert np.isnan(remembered(keypoints(errors), INTERVAL_S)[3])  # 5 s of 2.4 s


def test_errors_that_views_share_are_told_from_their_own() -> None:
    rng = np.random.default_rng(3)
    common, own = rng.normal(size=(1, 5000, 2)), rng.normal(size=(3, 5000, 2))
    rows = keypoints(np.sqrt(0.4) * common + np.sqrt(0.6) * own)
    rows = replace(rows, camera=rows.series, series=17 * rows.series)  # one person in three views
    assert shared(rows) == pytest.approx(0.4, abs=0.03)
    assert shared(replace(rows, error_cm=own.reshape(-1, 2))) == pytest.approx(0.0, abs=0.03)


def test_bias_by_direction_is_found() -> None:
    rng = np.random.default_rng(2)
    sector = np.tile(np.arange(8), 1000)
    bias = 3.0 * np.stack([np.cos(sector), np.sin(sector)], axis=-1)
    errors = (bias + rng.normal(size=bias.shape)).reshape(1, -1, 2)
    assert by_direction(keypoints(errors, sector)) == pytest.approx(3.0, abs=0.1)
    assert by_direction(keypoints(errors - bias[None], sector)) < 0.15
    wild = capped(np.array([[300.0, 400.0], [3.0, 4.0]]))
    assert wild == pytest.approx(np.array([[9.0, 12.0], [3.0, 4.0]])), "no more than the cap"


def doubled(record: Any) -> Any:
    """Return the record with everybody there twice, under other names."""
    people = record.people
    joints_m, covariance_m2 = (
        np.concatenate([each, each]) for each in (people.joints_m, people.full_covariance_m2)
    )
    ids = np.concatenate([people.track_ids, people.track_ids + 1000])
    twice = type(people)(track_ids=ids, joints_m=joints_m, full_covariance_m2=covariance_m2)
    return replace(record, people=twice)


@pytest.mark.parametrize("judge", ["truth", "held-out camera"])
def test_a_judge_counts_people_who_are_nobody(judge: str, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = simulate(SceneSettings("ring", people=2, seconds=3.0, fps=10.0), 3)
    rest, by = turns(whole, [whole.rig.camera_ids[0]])[0]
    case = Case("ring", whole, filter_terms.truth_of(whole))
    if judge != "truth":
        case = Case("ring", rest, judges=by)
    replayed = replaying.replay

    def twice(*args: Any) -> Iterator[Any]:
        yield from map(doubled, replayed(*args))

    honest = figures(case, "round-robin", 2.0, 0)
    monkeypatch.setattr(replaying, "replay", twice)
    lying = figures(case, "round-robin", 2.0, 0)
    assert lying["nobody"] > honest["nobody"] + 40
    assert lying["missed"] == honest["missed"]
