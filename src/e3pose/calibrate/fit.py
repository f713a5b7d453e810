"""How well each camera of a solved rig agrees with the others, by itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.calibrate.bundle import Adjusted
from e3pose.model.camera import Rig

GROSS_SIGMAS = 3.0
POOR_OUTLIERS, POOR_MEDIAN = 0.15, 2.0  # share, and times the median over cameras
RAYLEIGH_MEDIAN = 1.1774  # of the length of two independent errors of deviation 1


@dataclass(frozen=True, slots=True, eq=False)
class CameraFit:
    """Agreement of each camera with the others.

    Attributes:
        outliers: `(num_cameras,)` share of observations beyond three standard deviations, as
            measured; NaN without any.
        median: `(num_cameras,)` median length of residuals in standard deviations, as measured.
        factor: how many times as large as stated the errors of keypoints are.
        poor: `(num_cameras,)` which cameras do not agree.
    """

    outliers: Floats
    median: Floats
    factor: float
    poor: NDArray[np.bool_]


def fit_of(adjusted: Adjusted) -> CameraFit:
    """Judge each camera of an adjusted rig.

    Args:
        adjusted: with points.
    """
    size = np.linalg.norm(adjusted.residuals[:, :, 0], axis=-1)
    seen = np.isfinite(size)
    views = seen.sum(axis=0)
    # A point takes three of the two residuals that each view has.
    share = 1 - 1.5 / max(float(views[views >= 2].mean()), 1.6) if (views >= 2).any() else 1.0
    factor = float(np.median(size[seen])) / (RAYLEIGH_MEDIAN * np.sqrt(share))
    factor = max(factor, 1e-6)
    median = np.array([
        np.median(own[known]) / factor if known.any() else np.nan
        for own, known in zip(size, seen, strict=True)
    ])  # fmt: skip
    outliers = np.array([
        (own[known] > GROSS_SIGMAS * factor).mean() if known.any() else np.nan
        for own, known in zip(size, seen, strict=True)
    ])  # fmt: skip
    with np.errstate(invalid="ignore"):
        poor = (outliers > POOR_OUTLIERS) | (median > POOR_MEDIAN * np.nanmedian(median))
    return CameraFit(outliers, median, factor, poor | np.isnan(median))


def disagreeing(rig: Rig, fit: CameraFit, force: bool) -> list[str]:
    """Return a warning of cameras that do not agree with the others, or refuse them."""
    if not fit.poor.any():
        return []
    words = "; ".join(
        f"{rig.camera_ids[i]}: {100 * fit.outliers[i]:.0f} % of its keypoints disagree with the "
        f"other cameras, {fit.median[i]:.1f} standard deviations in the median"
        for i in np.flatnonzero(fit.poor).tolist()
    )
    help_words = "record people who walk through all of the room, one or two at a time"
    if not force:
        raise InputError(
            f"cameras: {words}; expected at most {100 * POOR_OUTLIERS:.0f} %. They are off, or see "
            f"people who are hidden or stay in one place: {help_words}, or write the calibration "
            "nevertheless with --force and let another recording judge it (e3pose calibrate check)"
        )
    return [f"{words}: these cameras may be far off; {help_words}"]
