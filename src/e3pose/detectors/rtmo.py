"""RTMO, one-stage multi-person networks with outputs `dets` and `keypoints` of MMDeploy.

Lu et al., "RTMO: Towards High-Performance One-Stage Real-Time Multi-Person Pose Estimation", CVPR
2024. The exported network suppresses boxes that overlap by more than 0.65
(`pose-detection_rtmo_onnxruntime`), which leaves some people twice: they are compared again.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from e3pose.base.errors import InputError
from e3pose.detectors.base import Image, check_image, poses_in_image
from e3pose.detectors.duplicates import without_duplicates
from e3pose.detectors.fit import letterbox
from e3pose.detectors.focus import InParts, Part
from e3pose.detectors.inference import FLOATS, Network, check_image_input
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17

NAME = "rtmo"
SIDE = 640  # pixels, where the network leaves it free
GREY = 114  # beyond the image, as in training
MIN_PERSON_SCORE = 0.3  # of the publisher's example
MIN_KEYPOINT_SCORE = 0.3


class Rtmo(InParts):
    """Float `(1, 3, height, width)` BGR of 0..255 in; `(1, N, 5)` and `(1, N, 17, 3)` out.

    The first are boxes with a score, the second x, y and score of each joint; pixels of the input.
    A part of an image fills the same input: the grid of the decoder is written into the file.

    Raises:
        InputError: when the network's input or outputs are others.
    """

    person_px, long_side, multiple = np.inf, SIDE, 1  # as large as the input allows

    def __init__(self, network: Network) -> None:
        self.skeleton = COCO17
        self._network = network
        self.provider, self.threads = network.provider, network.threads
        check_image_input(network, NAME)
        self._boxes, self._points = _places(network)

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        """See `Focusing.detect_part`; the network leaves no ties."""
        check_image(image)
        height, width = self._network.input_shape[2:]
        fit = letterbox(part.size, (width or SIDE, height or SIDE))
        pixels = fit.apply(part.cut(image), GREY)[..., ::-1].transpose(2, 0, 1)[None]
        dtype = FLOATS[self._network.input_dtype]
        outputs = self._network.run(np.ascontiguousarray(pixels, dtype=dtype))
        boxes, points = outputs[self._boxes], outputs[self._points]
        if boxes.ndim != 3 or points.shape != (1, boxes.shape[1], len(COCO17), 3):
            raise _error(self._network, [boxes.shape, points.shape])
        people = points[0][boxes[0, :, 4] > MIN_PERSON_SCORE].astype(np.float64)
        # Measured from the outer edge of the first pixel.
        keypoints = fit.to_image(people[..., :2] - 0.5)
        found = poses_in_image(keypoints, people[..., 2], part.size, MIN_KEYPOINT_SCORE)
        return part.in_image(without_duplicates(found))


def _places(network: Network) -> tuple[int, int]:
    """Return which output holds the boxes and which the keypoints."""
    shapes = network.output_shapes
    boxes = [i for i, shape in enumerate(shapes) if len(shape) == 3 and shape[2] in (5, None)]
    points = [
        i
        for i, shape in enumerate(shapes)
        if len(shape) == 4 and shape[2] in (len(COCO17), None) and shape[3] in (3, None)
    ]
    if len(shapes) != 2 or not boxes or not points:
        raise _error(network, shapes)
    return boxes[0], points[0]


def _error(network: Network, found: Any) -> InputError:
    shapes = [list(shape) for shape in found]
    return InputError(
        f"{network.path}: outputs: found {shapes}, expected dets [1, N, 5] and keypoints "
        f"[1, N, {len(COCO17)}, 3] for {NAME}"
    )
