"""A detector of one's own: whoever has a `skeleton` and can `detect` finds people in images.

Run: python examples/04_own_detector.py
On the command line: e3pose detect a.mp4 b.mp4 --model examples/04_own_detector.py:Lamps ...
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.detectors import make_detector
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17

BRIGHT = 200  # of 255


class Lamps:
    """Finds the one who carries lamps at both wrists: the two brightest halves of an image."""

    skeleton = COCO17

    def detect(self, image: NDArray[np.uint8]) -> Poses2D:
        """Return the people of an RGB image `(height, width, 3)`, in its pixels."""
        keypoints_px = np.full((1, len(COCO17), 2), np.nan)
        scores = np.zeros((1, len(COCO17)))
        middle = image.shape[1] // 2
        for name, first in (("right_wrist", 0), ("left_wrist", middle)):
            half = image[:, first : first + middle].min(axis=-1)
            rows, columns = np.nonzero(half > BRIGHT)
            if len(rows):
                joint = COCO17.index(name)
                keypoints_px[0, joint] = columns.mean() + first, rows.mean()
                scores[0, joint] = 1.0
        return Poses2D(keypoints_px, scores) if scores.any() else Poses2D.empty(len(COCO17))


def main() -> None:
    """Print where the lamps of a drawn image are."""
    image = np.zeros((120, 160, 3), dtype=np.uint8)
    image[40:44, 30:34] = image[60:64, 120:124] = 255
    view = make_detector(f"{__file__}:Lamps").detect(image)
    for name in ("right_wrist", "left_wrist"):
        x, y = view.keypoints_px[0, COCO17.index(name)]
        print(f"{name}: {x:.1f}, {y:.1f}")


if __name__ == "__main__":
    main()
