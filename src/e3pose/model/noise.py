"""How far keypoints are off, by their score: what the filter believes of a detector."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.errors import InputError

Floats = NDArray[np.float64]

# One keypoint that no other resembles has a standard error of 0.7 in the logarithm of sigma, but
# the errors of joints and slots resemble each other: 100 stand for about ten of these.
KNOWN_WEIGHT, ASSUMED_WEIGHT = 100.0, 20.0


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Expected keypoint error of one detector.

    Attributes:
        scores: `(num_knots,)` rising keypoint scores.
        sigma_px: `(num_knots,)` standard deviation of either coordinate at those scores, in pixels
            of an image `image_px` wide or high, whichever is more; between knots it is linear.
        image_px: the size of the images that `sigma_px` was measured on.
        weight: keypoints that this counts for against what the filter learns of its detectors.

    Raises:
        InputError: when the knots do not rise or a sigma is not positive.
    """

    scores: Floats
    sigma_px: Floats
    image_px: float
    weight: float = KNOWN_WEIGHT

    def __post_init__(self) -> None:
        scores = np.asarray(self.scores, dtype=np.float64)
        sigma = np.asarray(self.sigma_px, dtype=np.float64)
        if scores.ndim != 1 or len(scores) == 0 or sigma.shape != scores.shape:
            raise InputError(
                f"noise: scores {scores.shape} and sigma_px {sigma.shape}, expected two lists of "
                "one length"
            )
        if not ((np.diff(scores) > 0).all() and (sigma > 0).all() and np.isfinite(sigma).all()):
            raise InputError("noise: expected rising scores and positive sigma_px")
        if not (np.isfinite(self.image_px) and self.image_px > 0):
            raise InputError(f"noise: image_px: found {self.image_px}, expected pixels")
        if not (np.isfinite(self.weight) and self.weight > 0):
            raise InputError(f"noise: weight: found {self.weight}, expected keypoints")
        object.__setattr__(self, "scores", scores)
        object.__setattr__(self, "sigma_px", sigma)

    def of(self, scores: Floats, scale: Floats | float = 1.0) -> Floats:
        """Return the sigma in pixels of keypoints with these scores, times `scale`."""
        return np.asarray(np.interp(scores, self.scores, self.sigma_px) * scale)


# OpenPose: the residuals of its keypoints to a smoother over all views, without labels, in images
# of 1032 x 776 pixels of people 3 to 6 m away.
OPENPOSE = Noise(
    np.array([0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.95]),
    np.array([14.0, 12.7, 12.0, 9.4, 8.2, 6.5, 4.7, 3.1, 2.3]),
    image_px=1032,
)
