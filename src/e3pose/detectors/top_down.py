"""Top-down detectors: one network finds boxes of people, another the keypoints in each.

The two files lie in one folder, whatever they are called: which is which follows from their
outputs, and the skeleton from the number of keypoints.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.detectors.base import Image, check_image, poses_in_image
from e3pose.detectors.duplicates import without_duplicates
from e3pose.detectors.fit import letterbox
from e3pose.detectors.inference import FLOATS, Network, first_operators, load_network
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import SKELETONS, Skeleton

# Keypoint heads of top-down networks: SimCC and heatmaps.
#
# Li et al., "SimCC: a Simple Coordinate Classification Perspective for Human Pose Estimation",
# ECCV 2022; Jiang et al., "RTMPose: Real-Time Multi-Person Pose Estimation based on MMPose", 2023;
# Xu et al., "ViTPose: Simple Vision Transformer Baselines for Human Pose Estimation", NeurIPS
# 2022.


def read_simcc(
    simcc_x: NDArray[np.floating], simcc_y: NDArray[np.floating], input_size: tuple[int, int]
) -> tuple[Floats, Floats]:
    """Return keypoints and scores of classified coordinates.

    Every pixel of the input is split into as many classes along each axis (two, in RTMPose).

    Args:
        simcc_x: `(num_joints, classes)` how likely each column is.
        simcc_y: `(num_joints, classes)` how likely each row is.
        input_size: `(width, height)` of the input, pixels.

    Returns:
        `(num_joints, 2)` pixels of the input, and `(num_joints,)` the lower of both likelihoods.
    """
    places = np.stack([simcc_x.argmax(axis=1), simcc_y.argmax(axis=1)], axis=-1)
    splits = np.array([simcc_x.shape[1], simcc_y.shape[1]]) / input_size
    scores = np.minimum(simcc_x.max(axis=1), simcc_y.max(axis=1)).astype(np.float64)
    return places / splits, scores


def read_heatmaps(
    heatmaps: NDArray[np.floating], input_size: tuple[int, int]
) -> tuple[Floats, Floats]:
    """Return keypoints and scores of heatmaps, whose first and last cells are those of the input.

    The peak is refined by a parabola through the logarithms beside it, exact for a Gaussian; the
    mapping of cells to pixels is that of unbiased data processing (Huang et al., CVPR 2020).

    Args:
        heatmaps: `(num_joints, rows, columns)`.
        input_size: `(width, height)` of the input, pixels.

    Returns:
        `(num_joints, 2)` pixels of the input, and `(num_joints,)` the heights of the peaks.
    """
    maps = np.asarray(heatmaps, dtype=np.float64)
    joints, rows, columns = maps.shape
    peak = maps.reshape(joints, -1).argmax(axis=1)
    row, column = np.divmod(peak, columns)
    each = np.arange(joints)
    logs = np.log(np.maximum(maps, 1e-10))
    x = column + _beside(logs[each, row], column)
    y = row + _beside(logs[each, :, column], row)
    scale = (np.array(input_size) - 1) / (np.array([columns, rows]) - 1)
    return np.stack([x, y], axis=-1) * scale, maps.reshape(joints, -1).max(axis=1)


def _beside(lines: Floats, at: NDArray[np.int64]) -> Floats:
    """Return `(num_joints,)` how far from a cell the top of the parabola through it lies.

    Args:
        lines: `(num_joints, cells)` along one axis.
        at: `(num_joints,)` the highest cell; at an end it stays there.
    """
    each, last = np.arange(len(at)), lines.shape[1] - 1
    inner = np.clip(at, 1, max(last - 1, 1))
    if last < 2:
        return np.zeros(len(at))
    before, here, after = (lines[each, inner + step] for step in (-1, 0, 1))
    bend = before - 2 * here + after
    top = np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, 1.0), 0.0)
    return np.where(inner == at, np.clip(top, -0.5, 0.5), 0.0)


def heads_of(shapes: Sequence[tuple[int | None, ...]]) -> str:
    """Return which head has outputs of these shapes: `simcc`, `heatmaps`, or none (empty)."""
    if len(shapes) == 2 and all(len(shape) == 3 for shape in shapes):
        return "simcc"
    if len(shapes) == 1 and len(shapes[0]) == 4:
        return "heatmaps"
    return ""


# Person boxes from outputs `dets` and `labels` of MMDeploy's detectors: RTMDet and YOLOX.
#
# Lyu et al., "RTMDet: An Empirical Study of Designing Real-Time Object Detectors", 2022; Ge et
# al., "YOLOX: Exceeding YOLO Series in 2021". The exported networks suppress overlapping boxes
# themselves (`detection_onnxruntime_static`). RTMDet's images are normalised, YOLOX's are not.
# Nothing else in the two files differs in name or shape but what the image goes through first:
# RTMDet's convolution, or the slices from which YOLOX makes four images of half the size.

SIDE = 320  # pixels, where the network leaves it free: RTMDet-nano's
GREY = 114  # beyond the image, as in training
MEAN_BGR = np.array([103.53, 116.28, 123.675], dtype=np.float32)
DEVIATION_BGR = np.array([57.375, 57.12, 58.395], dtype=np.float32)
RTMDET, YOLOX = "Conv", "Slice"  # the operator that reads the image
PERSON = 0  # of COCO's labels
PERSON_SCORE = 0.3  # of the publisher's example
MAX_PEOPLE = 20  # each costs a run of the keypoint network


class PersonBoxes:
    """Float `(1, 3, height, width)` BGR in; `(1, N, 5)` boxes with a score and `(1, N)` labels out.

    The input of RTMDet is normalised, that of YOLOX is 0..255; boxes are x, y of two corners in
    pixels of the input.

    Raises:
        InputError: when the network's input or outputs are others.
    """

    def __init__(self, network: Network) -> None:
        self._network = network
        shape, outputs = network.input_shape, network.output_shapes
        boxes = [i for i, s in enumerate(outputs) if len(s) == 3 and s[2] in (5, None)]
        labels = [i for i, s in enumerate(outputs) if len(s) == 2]
        image = len(shape) == 4 and shape[1] in (3, None) and network.input_dtype in FLOATS
        if not (image and len(outputs) == 2 and boxes and labels):
            found = f"input {list(shape)}, outputs {[list(output) for output in outputs]}"
            raise InputError(
                str(network.path), found, "float [1, 3, H, W], dets [1, N, 5] and labels [1, N]"
            )
        self._boxes, self._labels = boxes[0], labels[0]
        first = first_operators(network.path)
        if not first & {RTMDET, YOLOX}:
            found = f"an image that is first read by {', '.join(sorted(first)) or 'nothing'}"
            wanted = f"{RTMDET} as in RTMDet, or {YOLOX} as in YOLOX"
            raise InputError(str(network.path), found, wanted)
        self._normalised = YOLOX not in first

    def find(self, image: Image) -> NDArray[np.float64]:
        """Return `(num_persons, 4)` x, y of two corners in pixels of an RGB image.

        By falling score; measured from the outer edge of the first pixel.
        """
        height, width = self._network.input_shape[2:]
        fit = letterbox((image.shape[1], image.shape[0]), (width or SIDE, height or SIDE))
        pixels = fit.apply(image, GREY)[..., ::-1].astype(np.float32)
        if self._normalised:
            pixels = (pixels - MEAN_BGR) / DEVIATION_BGR
        tensor = pixels.transpose(2, 0, 1)[None].astype(FLOATS[self._network.input_dtype])
        outputs = self._network.run(np.ascontiguousarray(tensor))
        boxes, labels = outputs[self._boxes], outputs[self._labels]
        if boxes.ndim != 3 or boxes.shape[2] != 5 or labels.shape != boxes.shape[:2]:
            raise self._error([boxes.shape, labels.shape])
        rows = boxes[0].astype(np.float64)
        kept = (labels[0] == PERSON) & (rows[:, 4] > PERSON_SCORE) & np.isfinite(rows).all(axis=1)
        rows = rows[kept]
        rows = rows[np.argsort(-rows[:, 4], kind="stable")][:MAX_PEOPLE]
        corners = fit.to_image(rows[:, :4].reshape(-1, 2, 2) - 0.5) + 0.5
        return corners.reshape(-1, 4)

    def _error(self, shapes: Any) -> InputError:
        found = f"outputs {[list(shape) for shape in shapes]}"
        return InputError(str(self._network.path), found, "dets [1, N, 5] and labels [1, N]")


RTMPOSE, VITPOSE = "rtmpose", "vitpose"
HEADS = {RTMPOSE: "simcc", VITPOSE: "heatmaps"}
BY_COUNT = {len(SKELETONS[name]): SKELETONS[name] for name in ("coco17", "halpe26", "coco133")}
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
        self._network = network
        self.provider, self.threads = network.provider, network.threads
        shape, outputs = network.input_shape, network.output_shapes
        self.head = heads_of(outputs)
        count = outputs[0][1] if self.head else None
        image = len(shape) == 4 and shape[1] in (3, None) and network.input_dtype in FLOATS
        if not image or count not in BY_COUNT:
            counts = "17, 26 or 133"
            raise InputError(
                str(network.path),
                f"input {list(shape)}, outputs {[list(output) for output in outputs]}",
                f"float [1, 3, H, W], then simcc_x and simcc_y [1, K, classes], or heatmaps "
                f"[1, K, rows, columns], of K = {counts} keypoints",
            )
        self.skeleton: Skeleton = BY_COUNT[count]
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
        self.threads = person.threads
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
    """Return each person once: two boxes may show the same person.

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


def files_of(folder: Path) -> list[Path]:
    """Return the two `.onnx` files of a folder; raise `InputError` if it has others."""
    if not folder.is_dir():
        wants = "a folder with a network for people's boxes and one for keypoints"
        found = "found a file" if folder.exists() else "no such folder"
        raise InputError(f"{folder}: {found}, expected {wants}")
    files = sorted(folder.glob("*.onnx"))
    if len(files) != 2:
        wants = "two: one that finds people as boxes, one that finds keypoints"
        raise InputError(str(folder), f"{len(files)} .onnx files", wants)
    return files


def open_top_down(
    files: Sequence[Path], wanted: str = "", provider: str = "auto", threads: int | None = None
) -> tuple[str, TopDown]:
    """Load two networks; return which kind the detector is, and the detector.

    Args:
        files: one for boxes and one for keypoints, in any order.
        wanted: a key of `HEADS` that it must be; empty for any.
        provider: where they run.
        threads: CPU threads.

    Raises:
        InputError: when they are others.
    """
    networks = [load_network(file, provider, threads) for file in files]
    if heads_of(networks[0].output_shapes):  # the other finds the boxes, or says that it does not
        networks.reverse()
    boxes, person = PersonBoxes(networks[0]), OnePerson(networks[1])
    kind = next(name for name, head in HEADS.items() if head == person.head)
    if wanted and kind != wanted:
        raise InputError(str(networks[1].path), f"a network of the kind {kind}", wanted)
    return kind, TopDown(boxes, person)
