"""Expected error of the estimator against its actual error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.evaluate.figures import Expected
from e3pose.evaluate.metrics import MATCH_LIMIT_M, mean_errors_m
from e3pose.model.uncertainty import distance_within_m, expected_distance_m
from e3pose.recording import Recording

if TYPE_CHECKING:
    from e3pose.pipeline import SlotRecord


MM = 1000.0
BAND = 0.9


def expected_figures(recording: Recording, records: Sequence[SlotRecord]) -> Expected:
    """Return the expected error of shown joints, against the actual one where truth is known.

    With truth in the recording's own skeleton also of the joints of people matched within 500 mm.
    """
    known = [record for record in records if np.isfinite(record.covariance_m2).any()]
    error_mm = foreseen_mm = None
    if known:
        covariance = np.concatenate([_joints(record.covariance_m2) for record in known])
        error_mm = MM * float(np.nanmean(expected_distance_m(covariance)))
    foreseen = [record.reasons.error_m for record in records if record.reasons is not None]
    if np.isfinite(foreseen).any():
        foreseen_mm = MM * float(np.nanmean(foreseen))
    truth = recording.truth
    if truth is None or truth.skeleton != recording.skeleton or not known:
        return Expected(error_mm, foreseen_mm)
    first, stop = recording.scored_slots or (0, recording.num_slots)
    pairs = [
        _matched(record, truth.joints_m[record.slot])
        for record in known
        if first <= record.slot < stop
    ]
    expected, within, actual = (np.concatenate(part) for part in zip(*pairs, strict=True))
    if not len(actual):
        return Expected(error_mm, foreseen_mm)
    return Expected(
        error_mm,
        foreseen_mm,
        matched_mm=MM * float(expected.mean()),
        actual_mm=MM * float(actual.mean()),
        coverage_90=100 * float((actual <= within).mean()),
    )


def _matched(record: SlotRecord, truth_m: Floats) -> tuple[Floats, Floats, Floats]:
    """Return expected errors, 90 % distances and actual errors of the joints of matched people."""
    from scipy.optimize import linear_sum_assignment

    joints_m = record.poses.joints_m
    gain = np.maximum(MATCH_LIMIT_M - mean_errors_m(joints_m, truth_m), 0.0)
    persons, actors = linear_sum_assignment(gain, maximize=True)
    right = gain[persons, actors] > 0
    persons, actors = persons[right], actors[right]
    actual = np.linalg.norm(joints_m[persons] - truth_m[actors], axis=-1)
    covariance = record.covariance_m2[persons]
    known = np.isfinite(actual) & np.isfinite(covariance).all(axis=(-1, -2))
    spread = covariance[known]
    return expected_distance_m(spread), distance_within_m(spread, BAND), actual[known]


def _joints(covariance_m2: Floats) -> Floats:
    return covariance_m2.reshape(-1, 3, 3)
