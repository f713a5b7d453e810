"""Top-down detectors: one network finds boxes of people, another the keypoints in each.

The two files lie in one folder, whatever they are called: which is which follows from their
outputs, and the skeleton from the number of keypoints.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.detectors.base import Image, check_image, poses_in_image
from e3pose.detectors.duplicates import without_duplicates
from e3pose.detectors.inference import FLOATS, Network, load_network
from e3pose.detectors.keypoint_heads import heads_of, read_heatmaps, read_simcc
from e3pose.detectors.person_boxes import MAX_PEOPLE, PersonBoxes
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17, HALPE26, Skeleton

RTMPOSE, VITPOSE = "rtmpose", "vitpose"
HEADS = {RTMPOSE: "simcc", VITPOSE: "heatmaps"}
SKELETONS_BY_COUNT = {len(skeleton): skeleton for skeleton in (COCO17, HALPE26)}
INPUT_SIZE = (192, 256)  # where the network leaves it free
PADDING = 1.25  # of a box, as in training
MEAN_RGB = np.array([123.675, 116.28, 103.53], dtype=np.float32)
DEVIATION_RGB = np.array([58.395, 57.12, 57.375], dtype=np.float32)
MIN_KEYPOINT_SCORE = 0.3
# Of people who were expected in a box, where no other network saw anybody; not measured.
FEWEST = 4  # keypoints of a person


class OnePerson:
    """Float `(1, 3, height, width)` RGB, normalised, in; SimCC or heatmaps of one person out.

    Attributes:
        skeleton: of its keypoints, by their number.

    Raises:
        InputError: when the network's input or outputs are others.
    """

    def __init__(self, network: Network) -> None:
        self._network, self.provider = network, network.provider
        shape, outputs = network.input_shape, network.output_shapes
        self.head = heads_of(outputs)
        count = outputs[0][1] if self.head else None
        image = len(shape) == 4 and shape[1] in (3, None) and network.input_dtype in FLOATS
        if not image or count not in SKELETONS_BY_COUNT:
            counts = " or ".join(map(str, SKELETONS_BY_COUNT))
            raise InputError(
                str(network.path),
                f"input {list(shape)}, outputs {[list(output) for output in outputs]}",
                f"float [1, 3, H, W], then simcc_x and simcc_y [1, K, classes], or heatmaps "
                f"[1, K, rows, columns], of K = {counts} keypoints",
            )
        self.skeleton: Skeleton = SKELETONS_BY_COUNT[count]
        self._size = shape[3] or INPUT_SIZE[0], shape[2] or INPUT_SIZE[1]

    def keypoints(self, image: Image, box: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Return keypoints `(num_joints, 2)` in pixels of the image, and scores `(num_joints,)`.

        Args:
            image: `(height, width, 3)` RGB.
            box: `(4,)` x, y of two corners, from the outer edge of the first pixel.
        """
        import cv2

        to_input = crop(box, self._size, whole_cells=self.head == "heatmaps")
        seen = cv2.warpAffine(image, to_input, self._size, flags=cv2.INTER_LINEAR)
        tensor = ((np.asarray(seen) - MEAN_RGB) / DEVIATION_RGB).transpose(2, 0, 1)[None]
        dtype = FLOATS[self._network.input_dtype]
        outputs = self._network.run(np.ascontiguousarray(tensor, dtype=dtype))
        if self.head == "simcc":
            keypoints, scores = read_simcc(outputs[0][0], outputs[1][0], self._size)
        else:
            keypoints, scores = read_heatmaps(outputs[0][0], self._size)
        if len(scores) != len(self.skeleton):
            raise InputError(
                str(self._network.path), f"{len(scores)} keypoints", f"{len(self.skeleton)}"
            )
        return (keypoints - to_input[:, 2]) / to_input[0, 0], scores


class TopDown:
    """Finds boxes of people, then the keypoints in each, one after the other."""

    def __init__(self, boxes: PersonBoxes, person: OnePerson) -> None:
        self.skeleton, self.provider = person.skeleton, person.provider
        self._boxes, self._person = boxes, person

    def detect(self, image: Image) -> Poses2D:
        """Return the people in a `(height, width, 3)` RGB image, in its pixels."""
        check_image(image)
        return self._in_boxes(image, self._boxes.find(image))

    def detect_in_boxes(self, image: Image, boxes: NDArray[np.float64]) -> Poses2D:
        """See `InBoxes.detect_in_boxes`; the network that finds boxes does not run."""
        check_image(image)
        return different_people(self._in_boxes(image, boxes[:MAX_PEOPLE]))

    def _in_boxes(self, image: Image, boxes: NDArray[np.float64]) -> Poses2D:
        found = [self._person.keypoints(image, box) for box in boxes]
        if not found:
            return Poses2D.empty(len(self.skeleton))
        keypoints, scores = (np.stack(part) for part in zip(*found, strict=True))
        size = image.shape[1], image.shape[0]
        return poses_in_image(keypoints, scores, size, MIN_KEYPOINT_SCORE)


def different_people(found: Poses2D) -> Poses2D:
    """Return those who are there, each once: two boxes may show the same person.

    Args:
        found: what was found in each box; hardly anything in one without anybody.

    Returns:
        The people with at least `FEWEST` keypoints; of those with the same keypoints the one with
        the highest scores.
    """
    enough = (found.scores > 0).sum(axis=1) >= FEWEST
    return without_duplicates(Poses2D(found.keypoints_px[enough], found.scores[enough]))


def crop(
    box: NDArray[np.float64], input_size: tuple[int, int], whole_cells: bool = False
) -> NDArray[np.float64]:
    """Return the `(2, 3)` affine map from pixels of an image to those of a network's input.

    The box, padded and widened to the input's proportions, fills the input; x and y are scaled
    alike.

    Args:
        box: `(4,)` x, y of two corners, from the outer edge of the first pixel.
        input_size: `(width, height)`.
        whole_cells: the input ends with the centres of its outer pixels, as for heatmaps of
            unbiased data processing, rather than with their edges.
    """
    middle = (box[:2] + box[2:]) / 2 - 0.5  # both count from pixel centres
    sides = np.maximum(box[2:] - box[:2], 1.0) * PADDING
    target = np.array(input_size, dtype=np.float64) - (1 if whole_cells else 0)
    scale = float((target / sides).min())
    centre = target / 2
    return np.array([[scale, 0, 0], [0, scale, 0]]) + np.column_stack(
        [np.zeros((2, 2)), centre - scale * middle]
    )


def network_files(folder: Path) -> list[Path]:
    """Return the network files of a folder."""
    return sorted(folder.glob("*.onnx"))


def open_top_down(
    folder: Path, wanted: str = "", provider: str = "auto", threads: int | None = None
) -> tuple[str, TopDown]:
    """Load the two networks of a folder; return which kind it is, and the detector.

    Args:
        folder: has two `.onnx` files, one for boxes and one for keypoints.
        wanted: a key of `HEADS` that it must be; empty for any.
        provider: where they run.
        threads: CPU threads.

    Raises:
        InputError: when the folder has other files than these.
    """
    if not folder.is_dir():
        wants = "a folder with a network for people's boxes and one for keypoints"
        found = "found a file" if folder.exists() else "no such folder"
        raise InputError(f"{folder}: {found}, expected {wants}")
    files = network_files(folder)
    if len(files) != 2:
        wants = "two: one that finds people as boxes, one that finds keypoints"
        raise InputError(str(folder), f"{len(files)} .onnx files", wants)
    networks = [load_network(file, provider, threads) for file in files]
    if heads_of(networks[0].output_shapes):  # the other finds the boxes, or says that it does not
        networks.reverse()
    boxes, person = PersonBoxes(networks[0]), OnePerson(networks[1])
    kind = next(name for name, head in HEADS.items() if head == person.head)
    if wanted and kind != wanted:
        raise InputError(str(folder), f"a network of the kind {kind}", wanted)
    return kind, TopDown(boxes, person)
