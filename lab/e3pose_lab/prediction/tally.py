"""Sums of prediction errors and their figures (docs/reference/predictor-metrics.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.model.camera import Rig
from e3pose.predict.base import Prediction
from e3pose.select.occlusion import box_iou, person_boxes
from e3pose_lab.prediction.motion import HIPS

MM = 1000.0
# Borders between groups of joints by the error that the predictor expects, metres.
CLAIM_BORDERS_M = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32)


@dataclass(frozen=True, slots=True, eq=False)
class Tally:
    """Sums that add up over windows and recordings, `(num_leads,)` unless said otherwise.

    Attributes:
        wanted: joints whose future is known.
        found: of these, predicted ones.
        error_m: their distances.
        rooted: joints that are given relative to the middle of the hips.
        rooted_error_m: their distances.
        claimed: joints for which the predictor stated an expected error.
        claim_m: these expected errors.
        within: joints no farther off than stated.
        within_twice: joints no farther off than twice that.
        boxes: people in views.
        iou: overlap of their predicted boxes with the actual ones.
        windows: windows with a known future, in which one joint suffices.
        grouped: `(num_groups,)` joints by stated error, between `CLAIM_BORDERS_M`.
        grouped_claim_m: `(num_groups,)` their stated errors.
        grouped_error_m: `(num_groups,)` their actual errors.
    """

    wanted: Floats
    found: Floats
    error_m: Floats
    rooted: Floats
    rooted_error_m: Floats
    claimed: Floats
    claim_m: Floats
    within: Floats
    within_twice: Floats
    boxes: Floats
    iou: Floats
    windows: Floats
    grouped: Floats
    grouped_claim_m: Floats
    grouped_error_m: Floats

    @classmethod
    def zero(cls, num_leads: int) -> Tally:
        """Return the tally of nothing."""
        groups = len(CLAIM_BORDERS_M) + 1
        lengths = (groups if f.name.startswith("grouped") else num_leads for f in fields(cls))
        return cls(*(np.zeros(length) for length in lengths))

    def __add__(self, other: Tally) -> Tally:
        return Tally(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))


def tally(predicted: Prediction, actual_m: Floats, rig: Rig, boxes: Floats) -> Tally:
    """Compare predictions with what happened.

    Args:
        predicted: of `(num_leads, num_windows, 14)` body joints.
        actual_m: `(num_leads, num_windows, 14, 3)` metres, NaN where unknown.
        rig: the cameras.
        boxes: `(num_cameras, num_leads, num_windows, 4)` the actual boxes, NaN where not in view.
    """
    known = np.asarray(np.isfinite(actual_m).all(axis=-1))
    joints_m = np.where(known[..., None], predicted.joints_m, np.nan)
    distance = np.linalg.norm(joints_m - actual_m, axis=-1)
    rooted = np.linalg.norm(_rooted(joints_m) - _rooted(actual_m), axis=-1)
    claim = np.where(np.isfinite(distance), predicted.error_m, np.nan)
    overlap, counted = _overlap(joints_m, rig, boxes)
    with np.errstate(invalid="ignore"):
        within, within_twice = distance <= claim, distance <= 2 * claim
    claimed = np.isfinite(claim)
    return Tally(
        wanted=_count(known),
        found=_count(np.isfinite(distance)),
        error_m=_sum(distance),
        rooted=_count(np.isfinite(rooted)),
        rooted_error_m=_sum(rooted),
        claimed=_count(claimed),
        claim_m=_sum(claim),
        within=_count(within),
        within_twice=_count(within_twice),
        boxes=counted,
        iou=overlap,
        windows=known.any(axis=-1).sum(axis=-1).astype(np.float64),
        grouped=_by_claim(claim[claimed], np.ones(int(claimed.sum()))),
        grouped_claim_m=_by_claim(claim[claimed], claim[claimed]),
        grouped_error_m=_by_claim(claim[claimed], distance[claimed]),
    )


def figures(total: Tally, leads: Sequence[int]) -> dict[str, dict[str, float]]:
    """Return the figures by name and lead; one that cannot be had is absent."""
    ratios = {
        "mpjpe_mm": (MM * total.error_m, total.found),
        "root_relative_mpjpe_mm": (MM * total.rooted_error_m, total.rooted),
        "coverage": (total.found, total.wanted),
        "box_iou": (total.iou, total.boxes),
        "expected_mm": (MM * total.claim_m, total.claimed),
        "within_expected": (total.within, total.claimed),
        "within_twice_expected": (total.within_twice, total.claimed),
    }
    by_name = {
        name: {
            str(lead): float(part / whole)
            for lead, part, whole in zip(leads, parts, wholes, strict=True)
            if whole > 0
        }
        for name, (parts, wholes) in ratios.items()
    }
    return {name: by_lead for name, by_lead in by_name.items() if by_lead}


def calibration(total: Tally) -> list[dict[str, float]]:
    """Return stated beside actual errors, over all leads: `expected_mm`, `actual_mm`, `joints`.

    One entry per group of joints with like stated errors; a group without joints is absent, and
    all are for a predictor that states none.
    """
    return [
        {"expected_mm": MM * claim / count, "actual_mm": MM * error / count, "joints": count}
        for count, claim, error in zip(
            total.grouped.tolist(),
            total.grouped_claim_m.tolist(),
            total.grouped_error_m.tolist(),
            strict=True,
        )
        if count > 0
    ]


def _rooted(body_m: Floats) -> Floats:
    return np.asarray(body_m - body_m[..., HIPS, :].mean(axis=-2, keepdims=True))


def _overlap(joints_m: Floats, rig: Rig, boxes: Floats) -> tuple[Floats, Floats]:
    """Return the summed IoU and the number of people in views, per lead."""
    overlap = np.zeros(len(joints_m))
    counted = np.zeros(len(joints_m))
    for camera, actual in zip(rig.cameras, boxes, strict=True):
        in_view = np.isfinite(actual).all(axis=-1)
        iou = box_iou(person_boxes(camera.project(joints_m), camera.image_size), actual)
        overlap += np.where(in_view, iou, 0.0).sum(axis=-1)
        counted += in_view.sum(axis=-1)
    return overlap, counted


def _by_claim(claim_m: Floats, values: Floats) -> Floats:
    groups = np.digitize(claim_m, CLAIM_BORDERS_M)
    sums = np.bincount(groups, weights=values, minlength=len(CLAIM_BORDERS_M) + 1)
    return np.asarray(sums, dtype=np.float64)


def _sum(values: Floats) -> Floats:
    return np.asarray(np.nansum(values, axis=tuple(range(1, values.ndim))))


def _count(flags: NDArray[np.bool_]) -> Floats:
    return np.asarray(flags.sum(axis=tuple(range(1, flags.ndim))), dtype=np.float64)
