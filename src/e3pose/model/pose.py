"""Views: the 2D poses of a camera. Missing is NaN with score 0."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError

MISSING_SCORE = 1e-3  # a keypoint less certain than this is missing
MAX_PIXEL = 1e6  # and so is one further out than this
# Seconds after which a camera looks again though the image is unchanged, for the network may have
# missed somebody, who is found so late at most; with less the gate saves fewer looks: at 25 a
# second 2 s leave one in 50. A camera that says more is not believed.
MOST_UNCHANGED_S = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Poses2D:
    """One view: the people a camera saw in one frame.

    Attributes:
        keypoints_px: `(num_persons, num_joints, 2)` pixels in the real (distorted) image; NaN where
            missing.
        scores: `(num_persons, num_joints)` in [0, 1]; 0 where missing.
        unchanged_s: for how long the image is the same as in the look that found them; 0 in that
            look itself.

    Raises:
        InputError: on a wrong shape, or a score outside [0, 1].
    """

    keypoints_px: Floats
    scores: Floats
    unchanged_s: float = 0.0

    def __post_init__(self) -> None:
        keypoints = np.asarray(self.keypoints_px, dtype=np.float64)
        scores = np.asarray(self.scores, dtype=np.float64)
        keypoints, scores = checked_positions("Poses2D", keypoints, scores, components=2)
        object.__setattr__(self, "keypoints_px", keypoints)
        object.__setattr__(self, "scores", scores)

    def __len__(self) -> int:
        return len(self.scores)

    def resized(self, factor: Floats) -> Poses2D:
        """Return the same in an image that is `factor` times as large.

        Args:
            factor: `(2,)` of width and height; the middle of a pixel stays its middle.
        """
        return Poses2D((self.keypoints_px + 0.5) * factor - 0.5, self.scores, self.unchanged_s)

    @classmethod
    def empty(cls, num_joints: int) -> Poses2D:
        """Return a view in which nobody was seen."""
        return cls(np.zeros((0, num_joints, 2)), np.zeros((0, num_joints)))


def checked_positions(
    name: str, positions: NDArray[Any], scores: NDArray[Any], components: int
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return positions and scores of joints with NaN and score 0 wherever one is missing.

    Args:
        name: of the record, for messages.
        positions: `(num_persons, num_joints, components)`.
        scores: `(num_persons, num_joints)` in [0, 1].
        components: of a position: 2 or 3.

    Raises:
        InputError: on a wrong shape, or a score outside [0, 1].
    """
    if positions.ndim != 3 or positions.shape[2] != components:
        raise InputError(
            f"{name}: positions have shape {positions.shape}, "
            f"expected (num_persons, num_joints, {components})"
        )
    if scores.shape != positions.shape[:2]:
        raise InputError(
            f"{name}: scores have shape {scores.shape}, expected {positions.shape[:2]}"
        )
    if not scores.size:
        return positions, scores
    least = scores.min()
    if not (least >= 0 and scores.max() <= 1):  # NaN fails too
        raise InputError(f"{name}: a score lies outside [0, 1] or is NaN")
    if least > 0 and np.isfinite(positions).all():  # nothing is missing
        return positions, scores
    present = (scores > 0) & np.isfinite(positions).all(axis=-1)
    if present.all():
        return positions, scores
    return np.where(present[..., None], positions, np.nan), np.where(present, scores, 0.0)
