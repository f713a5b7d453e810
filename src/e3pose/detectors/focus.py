"""Detect in the part of an image where people are expected, at the network's best scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, sqrt
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.detectors.base import Image, check_image
from e3pose.detectors.fit import letterbox_to_side
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D

# Detect in crops of the people who are expected, put beside each other in one input.
#
# People who are apart leave much between them that a rectangle around all shows to the network,
# and one scale suits them all badly. A mosaic shows each at its own, in one call.

GAP = 8  # pixels of the input between crops; of 0 to 32 none found more people than others
MOST_TILES = 8  # more take long to pack, and hardly leave anything out
TRIES = 4  # at making all crops smaller, until they cost no more than they may


@dataclass(frozen=True, slots=True)
class Tile:
    """One crop and where the mosaic shows it, which is inside the crop and the mosaic.

    Attributes:
        box: left, top, right, bottom in pixels of the image.
        corner: `(x, y)` of the pixel of the mosaic with the crop's top-left pixel.
        size: `(width, height)` in the mosaic.
    """

    box: tuple[int, int, int, int]
    corner: tuple[int, int]
    size: tuple[int, int]

    @property
    def scale(self) -> Floats:
        """`(2,)` pixels of the mosaic per pixel of the image, along x and y."""
        left, top, right, bottom = self.box
        return np.array(self.size) / (right - left, bottom - top)

    def to_mosaic(self, points: NDArray[np.float64]) -> Floats:
        """Map `(*batch, 2)` pixels of the image; both count from pixel centres."""
        return np.asarray((points + 0.5 - self.box[:2]) * self.scale + self.corner - 0.5)

    def to_image(self, points: NDArray[np.float64]) -> Floats:
        """Map `(*batch, 2)` pixels of the mosaic; the inverse of `to_mosaic`."""
        return np.asarray((points + 0.5 - self.corner) / self.scale + self.box[:2] - 0.5)

    def holds(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which of `(*batch, 2)` pixels of the mosaic are in the tile."""
        place = points + 0.5 - self.corner
        with np.errstate(invalid="ignore"):
            return np.asarray(((place >= 0) & (place < self.size)).all(axis=-1))


@dataclass(frozen=True, slots=True)
class Mosaic:
    """Crops of an image in one input.

    Attributes:
        tiles: the crops; neither their boxes nor their places overlap.
        size: `(width, height)` in pixels.
        groups: of each tile, which of the people who are expected are in it.
        relative_size: of the people in it, to that which they should have; at most 1.
    """

    tiles: tuple[Tile, ...]
    size: tuple[int, int]
    groups: tuple[tuple[int, ...], ...]
    relative_size: float

    @property
    def pixels(self) -> int:
        """Of the network's input."""
        return self.size[0] * self.size[1]

    def draw(self, image: Image) -> Image:
        """Return the `(height, width, 3)` mosaic of an image, black between crops."""
        import cv2

        canvas = np.zeros((self.size[1], self.size[0], 3), dtype=np.uint8)
        for tile in self.tiles:
            left, top, right, bottom = tile.box
            shrinks = tile.size[0] < right - left
            method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
            crop = cv2.resize(image[top:bottom, left:right], tile.size, interpolation=method)
            (x, y), (width, height) = tile.corner, tile.size
            canvas[y : y + height, x : x + width] = crop
        return canvas

    def expected(self, view: ExpectedView) -> ExpectedView:
        """Return people expected in an image as they are expected in the mosaic."""
        points = np.full(view.keypoints_px.shape, np.nan)
        reach = np.zeros(view.reach_px.shape)
        for tile, group in zip(self.tiles, self.groups, strict=True):
            members = list(group)
            points[members] = tile.to_mosaic(view.keypoints_px[members])
            reach[members] = view.reach_px[members] * tile.scale.mean()
        return ExpectedView(points, reach)

    def in_image(self, poses: Poses2D) -> Poses2D:
        """Return poses in pixels of the mosaic as those of the image.

        A person is in the tile with most of the scores; keypoints outside of it are dropped.
        """
        keypoints_px, scores = poses.keypoints_px.copy(), poses.scores.copy()
        inside = np.array([tile.holds(keypoints_px) for tile in self.tiles])
        most = (inside * scores).sum(axis=2).argmax(axis=0)  # (num_persons,)
        for person, number in enumerate(most.tolist()):
            seen = inside[number, person] & (scores[person] > 0)
            places = self.tiles[number].to_image(keypoints_px[person])
            keypoints_px[person] = np.where(seen[:, None], places, np.nan)
            scores[person] = np.where(seen, scores[person], 0.0)
        there = (scores > 0).any(axis=1)
        return Poses2D(keypoints_px[there], scores[there])


def mosaic_of(
    boxes: NDArray[np.float64],
    sizes_px: NDArray[np.float64],
    person_px: float,
    largest_scale: float,
    multiple: int,
    most_pixels: float,
) -> Mosaic | None:
    """Return a mosaic of people; people whose boxes overlap share a crop.

    So nobody is in two crops. The people of a crop have the network's size in their geometric
    mean, or all crops are smaller by the same factor to cost no more than they may.

    Args:
        boxes: `(num_persons, 4)` left, top, right, bottom inside the image; people with NaN are in
            no crop.
        sizes_px: `(num_persons,)` of the people, in pixels of the image.
        person_px: how large people should be in the network's input.
        largest_scale: at which crops are shown.
        multiple: sides of the mosaic are multiples of this.
        most_pixels: of the mosaic.

    Returns:
        The mosaic; None if it had one crop, or too many, or they do not fit.
    """
    groups = apart(boxes)
    if not 2 <= len(groups) <= MOST_TILES:
        return None
    rects = [rect for rect, _ in groups]
    means_px = [float(np.exp(np.log(sizes_px[list(members)]).mean())) for _, members in groups]
    relative = 1.0
    for _ in range(TRIES):
        scales = [min(relative * person_px / mean, largest_scale) for mean in means_px]
        sizes = [
            (max(round(scale * (right - left)), 1), max(round(scale * (bottom - top)), 1))
            for scale, (left, top, right, bottom) in zip(scales, rects, strict=True)
        ]
        corners, (width, height) = pack(sizes, multiple)
        if width * height <= most_pixels:
            tiles = (Tile(*each) for each in zip(rects, corners, sizes, strict=True))
            members = tuple(members for _, members in groups)
            return Mosaic(tuple(tiles), (width, height), members, relative)
        relative *= min(0.98, sqrt(most_pixels / (width * height)))
    return None


def apart(
    boxes: NDArray[np.float64],
) -> list[tuple[tuple[int, int, int, int], tuple[int, ...]]]:
    """Return rectangles of whole pixels that do not overlap, and whose boxes are in each.

    Args:
        boxes: `(num_boxes, 4)` left, top, right, bottom; those with NaN are left out.
    """
    found: list[tuple[tuple[int, int, int, int], tuple[int, ...]]] = []
    for number in np.flatnonzero(np.isfinite(boxes).all(axis=1)).tolist():
        left, top = np.floor(boxes[number, :2]).astype(int).tolist()
        right, bottom = np.ceil(boxes[number, 2:]).astype(int).tolist()
        members: tuple[int, ...] = (number,)
        while True:  # a rectangle that grows may meet further ones
            met = [
                (rect, others)
                for rect, others in found
                if left < rect[2] and rect[0] < right and top < rect[3] and rect[1] < bottom
            ]
            if not met:
                break
            found = [each for each in found if each not in met]
            rects = np.array([rect for rect, _ in met] + [(left, top, right, bottom)])
            left, top = rects[:, :2].min(axis=0).tolist()
            right, bottom = rects[:, 2:].max(axis=0).tolist()
            members = tuple(sorted(members + tuple(one for _, others in met for one in others)))
        found.append(((left, top, right, bottom), members))
    return found


def pack(
    sizes: Sequence[tuple[int, int]], multiple: int
) -> tuple[list[tuple[int, int]], tuple[int, int]]:
    """Return where rectangles lie in a small one around all, and its size.

    Args:
        sizes: `(width, height)` of each.
        multiple: the sides of the one around all are multiples of this.

    Returns:
        `(x, y)` of the top-left corner of each, `GAP` or more apart, and `(width, height)`.
    """
    best: tuple[list[tuple[int, int]], tuple[int, int]] | None = None
    lowest = ceil(max(height for _, height in sizes) / multiple) * multiple
    width = ceil(max(width for width, _ in sizes) / multiple) * multiple
    widest = sum(width + GAP for width, _ in sizes) - GAP
    while best is None or width * lowest < best[1][0] * best[1][1]:
        corners, height = _fill(sizes, width)
        height = ceil(height / multiple) * multiple
        if best is None or width * height < best[1][0] * best[1][1]:
            best = corners, (width, height)
        if width >= widest:
            break
        width += multiple
    return best


def _fill(sizes: Sequence[tuple[int, int]], width: int) -> tuple[list[tuple[int, int]], int]:
    """Lay rectangles as high up as they go, high ones first; return corners and the height."""
    corners = [(0, 0)] * len(sizes)
    skyline = [(0, width + GAP, 0)]  # begin, end and height of what is filled, from the left
    for number in sorted(range(len(sizes)), key=lambda n: (-sizes[n][1], n)):
        wide, high = sizes[number][0] + GAP, sizes[number][1] + GAP
        y, x = min(
            (max(top for begin, end, top in skyline if begin < x + wide and x < end), x)
            for x, _, _ in skyline
            if x + wide <= width + GAP
        )
        corners[number] = x, y
        skyline = sorted(
            [(begin, min(end, x), top) for begin, end, top in skyline if begin < x]
            + [(x, x + wide, y + high)]
            + [(max(begin, x + wide), end, top) for begin, end, top in skyline if end > x + wide]
        )
    return corners, max(top for _, _, top in skyline) - GAP


MARGIN = 0.15  # of a person's size, around keypoints: heads and feet reach beyond
LARGEST_SCALE = 2.0  # enlarging more shows no more
SMALLEST_PERSON_PX = 16.0  # somebody smaller is not what the scale is chosen for


@dataclass(frozen=True, slots=True)
class Part:
    """A rectangle of an image, and how large the network gets it.

    Attributes:
        left: first column.
        top: first row.
        width: columns.
        height: rows.
        long_side: of the network's input in pixels, where the network leaves it free.
    """

    left: int
    top: int
    width: int
    height: int
    long_side: int

    @property
    def size(self) -> tuple[int, int]:
        """`(width, height)`."""
        return self.width, self.height

    @property
    def box(self) -> tuple[int, int, int, int]:
        """Left, top, right and bottom."""
        return self.left, self.top, self.left + self.width, self.top + self.height

    def cut(self, image: Image) -> Image:
        """Return the part of a `(height, width, 3)` image."""
        columns = slice(self.left, self.left + self.width)
        return image[self.top : self.top + self.height, columns]

    def in_image(self, poses: Poses2D) -> Poses2D:
        """Return poses in pixels of the part as those of the image."""
        return Poses2D(poses.keypoints_px + (self.left, self.top), poses.scores)


class InputSize(Protocol):
    """The input of a network whose scale is free.

    Attributes:
        person_px: how large people should be in its input, between the keypoints farthest apart;
            larger ones cost more than they tell.
        long_side: of its input for a whole image, pixels.
        multiple: the sides of its input are multiples of this.
    """

    person_px: float
    long_side: int
    multiple: int


@runtime_checkable
class Focusing(InputSize, Protocol):
    """A detector that can detect in a part of an image."""

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        """Return the people in a part of `image`, in pixels of `image`.

        Those who are expected may help to find joints.
        """
        ...


class InParts(Focusing):
    """A detector for which a whole image is one part of it."""

    def detect(self, image: Image) -> Poses2D:
        """Return the people in a `(height, width, 3)` RGB image, in its pixels."""
        width, height = check_image(image)
        return self.detect_part(image, Part(0, 0, width, height, self.long_side))


@runtime_checkable
class InBoxes(Protocol):
    """A detector that finds the keypoints of one person at a time, in a box around each."""

    def detect_in_boxes(self, image: Image, boxes: NDArray[np.float64]) -> Poses2D:
        """Return the people in these boxes, in pixels of `image`; nobody where nobody is.

        Args:
            image: `(height, width, 3)` RGB.
            boxes: `(num_persons, 4)` x, y of two corners, from the outer edge of the first pixel.
        """
        ...


def uses_feedback(detector: Any) -> bool:
    """Return whether a detector uses feedback about where people are expected."""
    return isinstance(detector, Focusing | InBoxes)


def check_feedback(detector: Any, name: str) -> None:
    """Raise `InputError` unless a detector of this name uses feedback."""
    if not uses_feedback(detector):
        found = f"with {name[:80] or 'a detector'}, which detects in whole images alone"
        raise InputError("feedback", found, "a detector with detect_part or detect_in_boxes")


def detect_expected(detector: Any, image: Any, expected: ExpectedView | None) -> Poses2D:
    """Return the people in an image, of whom some are expected.

    Args:
        detector: a `Detector`; one that is neither `Focusing` nor `InBoxes` detects in the whole
            image.
        image: what it detects in.
        expected: who is expected where; None detects in the whole image.
    """
    look: Part | Mosaic | None = None
    if expected is not None and uses_feedback(detector):
        height, width = image.shape[:2]
        if isinstance(detector, InBoxes):
            inside, seen = boxes_of(expected, (width, height))
            if seen.any():
                return detector.detect_in_boxes(image, inside[seen])
        else:
            look = look_at(expected, (width, height), detector)
    if look is None or expected is None:
        whole: Poses2D = detector.detect(image)
        return whole
    if isinstance(look, Mosaic):
        (width, height), shown = look.size, look.expected(expected)
        input_ = Part(0, 0, width, height, max(look.size))
        return look.in_image(detector.detect_part(look.draw(image), input_, shown))
    found: Poses2D = detector.detect_part(image, look, expected)
    return found


def look_at(
    expected: ExpectedView, image_size: tuple[int, int], network: InputSize
) -> Part | Mosaic | None:
    """Return where to look for everybody who is expected: in one part, or in crops of them.

    Crops are for networks whose input may have any size (`free_input`). The way with larger people
    is chosen, up to the size that the network needs, else that with fewer pixels of input; neither
    has more than detection in the whole image.

    Args:
        expected: who is expected where.
        image_size: `(width, height)` in pixels.
        network: that detects.

    Returns:
        Where; None for the whole image.
    """
    boxes, sizes_px = boxes_of(expected, image_size), _sizes_px(expected)
    part, relative_size = _part(boxes, sizes_px, image_size, network)
    if not getattr(network, "free_input", False):
        return part
    inside, seen = boxes
    mosaic = mosaic_of(
        np.where(seen[:, None], inside, np.nan),
        sizes_px,
        network.person_px,
        LARGEST_SCALE,
        network.multiple,
        _input_pixels(None, image_size, network),
    )
    if mosaic is None:
        return part
    pixels = _input_pixels(part, image_size, network)
    better = (-mosaic.relative_size, mosaic.pixels) < (-relative_size, pixels)
    return mosaic if better else part


def _part(
    boxes: tuple[NDArray[np.float64], NDArray[np.bool_]],
    sizes_px: NDArray[np.float64],
    image_size: tuple[int, int],
    network: InputSize,
) -> tuple[Part | None, float]:
    """Return the part of an image with everybody who is expected; None for the whole image.

    It is enlarged or shrunk so that people have the network's size in their geometric mean, as
    far as that costs no more than detection in the whole image. Also returned is the size of people
    in it to that wanted, at most 1.
    """
    inside, seen = boxes
    if not seen.any():
        return None, 1.0
    left, top = np.floor(inside[seen, :2].min(axis=0)).astype(int).tolist()
    right, bottom = np.ceil(inside[seen, 2:].max(axis=0)).astype(int).tolist()
    width, height = max(right - left, 1), max(bottom - top, 1)
    whole = network.long_side / max(image_size)
    most = whole * sqrt(image_size[0] * image_size[1] / (width * height))
    mean_px = float(np.exp(np.log(sizes_px[seen]).mean()))
    wanted = min(network.person_px / mean_px, LARGEST_SCALE)
    scale = min(wanted, most)
    side = ceil(scale * max(width, height) / network.multiple) * network.multiple
    if (width, height) == image_size and side >= network.long_side:
        return None, min(whole / wanted, 1.0)
    return Part(left, top, width, height, side), scale / wanted


def _input_pixels(part: Part | None, image_size: tuple[int, int], network: InputSize) -> int:
    part = part or Part(0, 0, *image_size, network.long_side)
    width, height = letterbox_to_side(part.size, part.long_side, network.multiple).input_size
    return width * height


def boxes_of(
    expected: ExpectedView, image_size: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return `(num_persons, 4)` boxes with margins, cut at the image, and which are in it."""
    points = expected.keypoints_px
    known = np.isfinite(points)
    low = np.where(known, points, np.inf).min(axis=1)
    high = np.where(known, points, -np.inf).max(axis=1)
    margin = MARGIN * (high - low).max(axis=1) + expected.reach_px
    with np.errstate(invalid="ignore"):
        boxes = np.concatenate([low - margin[:, None], high + margin[:, None]], axis=1)
    inside = np.clip(boxes, 0, np.array([*image_size, *image_size]))
    return inside, np.asarray((inside[:, 2:] > inside[:, :2]).all(axis=1))


def _sizes_px(expected: ExpectedView) -> NDArray[np.float64]:
    """Return `(num_persons,)` people's sizes, between the keypoints farthest apart."""
    points = expected.keypoints_px
    known = np.isfinite(points)
    low = np.where(known, points, np.inf).min(axis=1)
    high = np.where(known, points, -np.inf).max(axis=1)
    return np.asarray(np.maximum((high - low).max(axis=1), SMALLEST_PERSON_PX))
