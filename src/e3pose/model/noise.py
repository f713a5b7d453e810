"""Noise of a detector: sigma by score, and how long errors persist."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError

# One keypoint that no other resembles has a standard error of 0.7 in the logarithm of sigma, but
# the errors of joints and slots resemble each other: 100 stand for about ten of these.
KNOWN_WEIGHT, ASSUMED_WEIGHT = 100.0, 20.0
LEAST_SCORE = 0.1  # below this keypoints are as good as missing, and detectors rarely report any
SURE_SCORE = 0.3  # from this on a keypoint may place a camera
IMAGE_PX = 1032.0  # of the images that the limits of the estimators are stated in
SHORTEST_S, LONGEST_S = 1e-3, 100.0  # of correlation times
DIGITS, ROUNDING = 12, 1e-9  # of shares: decimal ones stay decimal


@dataclass(frozen=True, slots=True)
class ErrorMemory:
    """How much of a detector's errors lasts, and how long.

    The error of a joint in a view is a sum of three parts: one that is new in every slot, one that
    decays quickly and one that lasts seconds. The two that last are first-order autoregressive.
    The defaults are the autocorrelation of OpenPose's residuals to a smoother over all views.

    Attributes:
        lasting_share: share of the variance that lasts seconds.
        lasting_s: correlation time of that part: until its correlation is down to 1/e.
        quick_share: share of the variance that decays quickly.
        quick_s: correlation time of that part, shorter than `lasting_s`.

    Raises:
        InputError: when the shares are not in [0, 1] together, or the times do not rise.
    """

    lasting_share: float = 0.45
    lasting_s: float = 2.5
    quick_share: float = 0.45
    quick_s: float = 0.1

    def __post_init__(self) -> None:
        for name in ("lasting_share", "quick_share"):
            share = getattr(self, name)
            if not 0 <= share <= 1:
                raise InputError(name, share, "a share of the variance, 0 to 1")
        both = self.lasting_share + self.quick_share
        if both > 1 + ROUNDING:
            raise InputError("lasting_share + quick_share", both, "at most 1 together")
        for name in ("lasting_s", "quick_s"):
            seconds = getattr(self, name)
            if not SHORTEST_S <= seconds <= LONGEST_S:
                raise InputError(name, seconds, f"{SHORTEST_S:g} to {LONGEST_S:g} seconds")
        if self.quick_s >= self.lasting_s:
            raise InputError("quick_s", self.quick_s, f"less than lasting_s, {self.lasting_s:g}")

    @property
    def new_share(self) -> float:
        """The share of the variance that is new in every slot."""
        return max(0.0, round(1 - self.lasting_share - self.quick_share, DIGITS))

    @property
    def parts(self) -> tuple[tuple[float, float], ...]:
        """Share of the variance and correlation time in seconds of each part, the shortest first.

        The time of the part that is new in every slot is 0.
        """
        return (
            (self.new_share, 0.0),
            (self.quick_share, self.quick_s),
            (self.lasting_share, self.lasting_s),
        )

    def correlation(self, apart_s: Floats) -> Floats:
        """Return how errors correlate that are `apart_s` > 0 seconds apart, `(*batch)`."""
        quick = self.quick_share * np.exp(-apart_s / self.quick_s)
        return np.asarray(quick + self.lasting_share * np.exp(-apart_s / self.lasting_s))


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Expected keypoint error of one detector.

    Attributes:
        scores: `(num_knots,)` rising keypoint scores.
        sigma_px: `(num_knots,)` standard deviation of either coordinate at those scores, in pixels
            of an image `image_px` wide or high, whichever is more; between knots it is linear.
        image_px: the size of the images that `sigma_px` was measured on.
        weight: keypoints that this counts for against what the filter learns of its detectors.
        memory: how long the errors last.

    Raises:
        InputError: when the knots do not rise or a sigma is not positive.
    """

    scores: Floats
    sigma_px: Floats
    image_px: float
    weight: float = KNOWN_WEIGHT
    memory: ErrorMemory = ErrorMemory()

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

    def in_images_of(self, image_px: float) -> Noise:
        """Return the same noise in pixels of images of another size."""
        sigma_px = self.sigma_px * (image_px / self.image_px)
        return replace(self, sigma_px=sigma_px, image_px=image_px)

    def of(self, scores: Floats, scale: Floats | float = 1.0) -> Floats:
        """Return sigma in pixels, `(*batch)`, by score.

        Args:
            scores: `(*batch)` in [0, 1].
            scale: multiplies the sigma, such as by the size of a person.
        """
        return np.asarray(np.interp(scores, self.scores, self.sigma_px) * scale)
