"""ECPose of EdgeCrafter and RF-DETR Keypoint of Roboflow, as their publishers export them.

Liu et al., "EdgeCrafter: Compact ViTs for Edge Dense Prediction via Task-Specialized Distillation",
2026. A transformer: it has neither a grid nor a suppression of overlapping boxes, and gives no
score for a joint. `orig_target_sizes`, its second input, is the size of the pixels to answer in.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.detectors.base import Image, check_image, poses_in_image
from e3pose.detectors.duplicates import without_duplicates
from e3pose.detectors.fit import stretch
from e3pose.detectors.focus import InParts, Part
from e3pose.detectors.inference import FLOATS, Network, check_image_input
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17

NAME = "ecpose"
SIDE = 640  # pixels, where the network leaves it free
MEAN_RGB = np.array([0.485, 0.456, 0.406], dtype=np.float32)
DEVIATION_RGB = np.array([0.229, 0.224, 0.225], dtype=np.float32)
PERSON = 1  # of two labels; 0 is nobody
MIN_PERSON_SCORE = 0.5  # of the publisher's example
COORDINATES = (2, 3, None)  # of a keypoint: x, y, and in some files a score
JOINTS = len(COCO17)


class EcPose(InParts):
    """Float `(1, 3, height, width)` RGB, normalised, and the input's size in.

    Out come `(1, N)` scores, `(1, N)` labels and `(1, N, 17, 2)` keypoints in pixels of the input.
    The image is stretched to the input. A joint without a score has that of its person.

    Raises:
        InputError: when the network's input or outputs are others.
    """

    person_px, long_side, multiple = np.inf, SIDE, 1  # as large as the input allows
    _wanted = f"scores [1, N], labels [1, N] and keypoints [1, N, {JOINTS}, 2] for {NAME}"

    def __init__(self, network: Network) -> None:
        self.skeleton = COCO17
        self._network = network
        self.provider, self.threads = network.provider, network.threads
        check_image_input(network, NAME)
        named = dict(zip(network.output_names, network.output_shapes, strict=True))
        if not self._fits(named):
            raise self._error(network.output_shapes)

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        """See `Focusing.detect_part`; the network leaves no ties."""
        check_image(image)
        height, width = self._network.input_shape[2:]
        fit = stretch(part.size, (width or SIDE, height or SIDE))
        pixels = (fit.apply(part.cut(image), 0) / np.float32(255) - MEAN_RGB) / DEVIATION_RGB
        dtype = FLOATS[self._network.input_dtype]
        tensor = np.ascontiguousarray(pixels.transpose(2, 0, 1)[None], dtype=dtype)
        outputs = dict(zip(self._network.output_names, self._network.run(tensor), strict=True))
        points, scores = self._people(outputs, fit.input_size)
        # Measured from the outer edge of the first pixel.
        found = poses_in_image(fit.to_image(points - 0.5), scores, part.size)
        return part.in_image(without_duplicates(found))

    def _fits(self, named: Mapping[str, tuple[int | None, ...]]) -> bool:
        points = named.get("keypoints", ())
        right = len(points) == 4 and points[2] in (JOINTS, None) and points[3] in COORDINATES
        return right and len(named) == 3 and {"scores", "labels"} < set(named)

    def _people(
        self, outputs: Mapping[str, NDArray[Any]], input_size: tuple[int, int]
    ) -> tuple[Floats, Floats]:
        """Return `(num_persons, 17, 2)` pixels of the input and `(num_persons, 17)` scores."""
        scores, labels = outputs["scores"], outputs["labels"]
        points = np.asarray(outputs["keypoints"], dtype=np.float64)
        if points.shape[:3] != (1, scores.size, JOINTS) or labels.size != scores.size:
            raise self._error([output.shape for output in outputs.values()])
        people = (scores[0] > MIN_PERSON_SCORE) & (labels[0] == PERSON)
        found = points[0, people]
        if found.shape[-1] == 3:  # else each joint has the score of its person
            return found[..., :2], found[..., 2]
        own = scores[0, people].astype(np.float64)
        return found, np.broadcast_to(own[:, None], found.shape[:2])

    def _error(self, found: Any) -> InputError:
        shapes = str([list(shape) for shape in found])
        return InputError(f"{self._network.path}: outputs", shapes, self._wanted)


class RfDetr(EcPose):
    """The same image in, without a size.

    Out come boxes `dets`, which are not used, `(1, N, classes)` logits `labels`, and `keypoints`
    `(1, N, 17 classes, C)`, those of people last: x and y as shares of the image, then the logit of
    the joint to be found.
    """

    _wanted = f"dets, labels [1, N, C] and keypoints [1, N, {JOINTS} C, 3 or more] for rf-detr"

    def _fits(self, named: Mapping[str, tuple[int | None, ...]]) -> bool:
        return set(named) == {"dets", "labels", "keypoints"} and len(named["keypoints"]) == 4

    def _people(
        self, outputs: Mapping[str, NDArray[Any]], input_size: tuple[int, int]
    ) -> tuple[Floats, Floats]:
        logits, points = outputs["labels"], np.asarray(outputs["keypoints"], dtype=np.float64)
        classes, more = divmod(points.shape[2], JOINTS)
        if more or points.shape[3] < 3 or not 1 <= classes <= logits.shape[-1]:
            raise self._error([output.shape for output in outputs.values()])
        people = points[0, _share(logits[0, :, classes - 1]) > MIN_PERSON_SCORE, -JOINTS:]
        return people[..., :2] * input_size, _share(people[..., 2])


def _share(logits: NDArray[Any]) -> NDArray[Any]:
    return 0.5 + 0.5 * np.tanh(logits / 2)  # no exponential that may overflow
