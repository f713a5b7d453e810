"""MoveNet MultiPose Lightning: up to six people, COCO-17."""

from __future__ import annotations

import numpy as np

from e3pose.base.errors import InputError
from e3pose.detectors.base import Image, check_image, poses_in_image
from e3pose.detectors.fit import Fit, letterbox, letterbox_to_side
from e3pose.detectors.focus import InParts, Part
from e3pose.detectors.inference import Network
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17

NAME = "movenet-multipose"
LONG_SIDE = 512  # pixels; more finds smaller people and costs in proportion to its square
MULTIPLE = 32
# tuned: px | lab/experiments/2026-11-27-crops-of-people.md: of the demo's videos and pizza, whole,
#   in parts and in crops | 160, as in its training: a quarter more pixels; 128: finds fewer
PERSON_PX = 136.0
VALUES = 56  # 17 x (y, x, score), four of a box, a person's score
MIN_PERSON_SCORE = 0.2
MIN_KEYPOINT_SCORE = 0.2


class MoveNet(InParts):
    """The published network: int32 `(1, height, width, 3)` in, float32 `(1, people, 56)` out.

    Raises:
        InputError: when the network's input or output is another.
    """

    person_px, long_side, multiple = PERSON_PX, LONG_SIDE, MULTIPLE

    def __init__(self, network: Network) -> None:
        self.skeleton = COCO17
        self._network = network
        self.provider, self.threads = network.provider, network.threads
        shape = network.input_shape
        self.free_input = None in shape[1:3]
        if (
            len(shape) != 4
            or shape[3] not in (3, None)
            or network.input_dtype not in ("int32", "uint8")
        ):
            raise InputError(
                f"{network.path}: input: found {network.input_dtype} {list(shape)}, expected int32 "
                f"or uint8 [1, height, width, 3] for {NAME}"
            )
        output = network.output_shapes[0]
        if len(output) != 3 or output[2] not in (VALUES, None):
            raise self._error(output)

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        """See `Focusing.detect_part`; the network leaves no ties."""
        check_image(image)
        fit = self._fit(part.size, part.long_side)
        people = self._network.run(fit.apply(part.cut(image), 0)[None].astype(np.int32))[0]
        if people.ndim != 3 or people.shape[2] != VALUES:
            raise self._error(people.shape)
        people = people[0][people[0, :, 55] > MIN_PERSON_SCORE]
        triples = people[:, :51].reshape(-1, 17, 3).astype(np.float64)
        # Fractions of the padded input, 0 at the outer edge of the first pixel.
        keypoints = fit.to_image(triples[..., 1::-1] * fit.input_size - 0.5)
        found = poses_in_image(keypoints, triples[..., 2], part.size, MIN_KEYPOINT_SCORE)
        return part.in_image(found)

    def content_size(self, image_size: tuple[int, int]) -> tuple[int, int]:
        """Return `(width, height)` that an image of a size has in the network's input."""
        return self._fit(image_size, LONG_SIDE).content_size

    def _fit(self, image_size: tuple[int, int], long_side: int) -> Fit:
        height, width = self._network.input_shape[1:3]
        if height is None or width is None:
            return letterbox_to_side(image_size, long_side, MULTIPLE)
        return letterbox(image_size, (width, height))

    def _error(self, found: tuple[int | None, ...]) -> InputError:
        return InputError(
            f"{self._network.path}: output: found {list(found)}, expected [1, people, {VALUES}] "
            f"for {NAME}"
        )
