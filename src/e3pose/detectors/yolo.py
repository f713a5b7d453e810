"""YOLO-pose networks by their output format, with the user's own weights."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.detectors.base import Image, check_image, poses_in_image
from e3pose.detectors.fit import Fit, letterbox, letterbox_to_side
from e3pose.detectors.focus import Part
from e3pose.detectors.inference import FLOATS, Network, check_image_input
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17

NAME = "yolo-pose"
SIDE = 640  # pixels, where the network leaves it free
MULTIPLE = 32
PERSON_PX = 200.0  # assumed: these networks are trained with people of all sizes
VALUES = 56  # box centre x, y, width, height, score, 17 x (x, y, score)
GREY = 114  # what these networks saw beyond the border in training
MIN_PERSON_SCORE = 0.25
MIN_KEYPOINT_SCORE = 0.25
MAX_OVERLAP = 0.5  # IoU of boxes above which two are one person
MAX_CANDIDATES = 1000  # before boxes are compared, best first


class YoloPose:
    """Float `(1, 3, height, width)` RGB of 0..1 in; `(1, 56, N)` or `(1, N, 56)` out.

    Raises:
        InputError: when the network's input or output is another.
    """

    person_px, long_side, multiple = PERSON_PX, SIDE, MULTIPLE

    def __init__(self, network: Network) -> None:
        self.skeleton = COCO17
        self._network = network
        self.provider, self.threads = network.provider, network.threads
        check_image_input(network, NAME)
        output = network.output_shapes[0]
        if len(output) != 3 or not {VALUES, None} & set(output[1:]):
            raise self._error(output)

    def detect(self, image: Image) -> Poses2D:
        """Return the people in a `(height, width, 3)` RGB image, in its pixels."""
        width, height = check_image(image)
        whole = letterbox((width, height), self._input_size, centred=True)
        return self._detect(image, Part(0, 0, width, height, SIDE), whole)

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        """See `Focusing.detect_part`; the network leaves no ties."""
        check_image(image)
        if None in self._network.input_shape[2:]:
            return self._detect(image, part, letterbox_to_side(part.size, part.long_side, MULTIPLE))
        return self._detect(image, part, letterbox(part.size, self._input_size, centred=True))

    @property
    def _input_size(self) -> tuple[int, int]:
        height, width = self._network.input_shape[2:]
        return width or SIDE, height or SIDE

    def _detect(self, image: Image, part: Part, fit: Fit) -> Poses2D:
        pixels = fit.apply(part.cut(image), GREY).transpose(2, 0, 1)[None] / np.float32(255)
        dtype = FLOATS[self._network.input_dtype]
        rows = self._rows(self._network.run(np.ascontiguousarray(pixels, dtype=dtype))[0])
        rows = rows[keep_people(rows[:, :4], rows[:, 4])]
        triples = rows[:, 5:].reshape(-1, 17, 3)
        # Measured from the outer edge of the first pixel.
        keypoints = fit.to_image(triples[..., :2] - 0.5)
        found = poses_in_image(keypoints, triples[..., 2], part.size, MIN_KEYPOINT_SCORE)
        return part.in_image(found)

    def _rows(self, output: NDArray[Any]) -> NDArray[np.float64]:
        """Return the `(N, 56)` candidates, whichever way round the network gives them."""
        if output.ndim != 3 or VALUES not in output.shape[1:]:
            raise self._error(output.shape)
        rows = output[0].T if output.shape[1] == VALUES else output[0]
        return np.asarray(rows, dtype=np.float64)

    def _error(self, found: tuple[int | None, ...]) -> InputError:
        return InputError(
            f"{self._network.path}: output: found {list(found)}, expected [1, {VALUES}, N] or "
            f"[1, N, {VALUES}] for {NAME}"
        )


def keep_people(boxes: NDArray[np.float64], scores: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the indices of boxes that are people, one each, best first.

    Args:
        boxes: `(N, 4)` centre x, y, width, height in pixels.
        scores: `(N,)`.
    """
    import cv2

    sound = np.isfinite(boxes).all(axis=1) & (scores > MIN_PERSON_SCORE)
    best = np.flatnonzero(sound)
    best = best[np.argsort(-scores[best], kind="stable")][:MAX_CANDIDATES]
    if not len(best):
        return best
    corners = np.concatenate([boxes[best, :2] - boxes[best, 2:] / 2, boxes[best, 2:]], axis=1)
    kept = cv2.dnn.NMSBoxes(corners.tolist(), scores[best].tolist(), MIN_PERSON_SCORE, MAX_OVERLAP)
    return best[np.asarray(kept, dtype=np.int64).reshape(-1)]
