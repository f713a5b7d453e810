"""Detect in crops of the people who are expected, put beside each other in one input.

People who are apart leave much between them that a rectangle around all shows to the network, and
one scale suits them all badly. A mosaic shows each at its own, in one call.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, sqrt

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.detectors.base import Image
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D

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
        """Return those who are expected in an image as they are expected in the mosaic."""
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
    """Return a mosaic of people; those whose boxes overlap share a crop.

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
