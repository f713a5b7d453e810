"""Semantic feedback: the people expected in a camera's view, sent with its orders."""

from __future__ import annotations

from dataclasses import dataclass

from e3pose.base.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedView:
    """Where the people in one camera's view will be.

    Attributes:
        keypoints_px: `(num_persons, num_joints, 2)` pixels of the real image, also beyond its
            border; NaN for joints that are behind the camera or unknown.
        reach_px: `(num_persons,)` how far off nine of ten keypoints are at most, pixels.
    """

    keypoints_px: Floats
    reach_px: Floats

    def __len__(self) -> int:
        return len(self.reach_px)
