"""Choose the most informative views of a board: sharp, spread over the image, tilted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats

BLURRED = 0.6  # a view less sharp than this share of the median is left out while others are there
GRID = (4, 3)  # parts of the picture, across and down, in which corners are asked for
TILTS = 0.05  # log of the ratio of opposite sides from which a board counts as tilted
TILT_SCALE = 1.5  # of a tilt beside places and sizes, when views are told apart
ENOUGH_VIEWS = 15
SMALL = 0.25  # a board this share of the picture's width is small


def choose_views(
    corners_m: Floats,
    corners_px: Floats,
    image_size: tuple[int, int],
    sharpness: Floats,
    max_views: int,
) -> NDArray[np.int64]:
    """Return which views to use, rising.

    Views are taken farthest first: each is the one least like those taken, by place in the picture,
    size and tilt, so that a minute of holding still in the middle counts once.

    Args:
        corners_m: `(num_corners, 3)` on the board.
        corners_px: `(num_views, num_corners, 2)`; NaN where not found.
        image_size: `(width, height)` in pixels.
        sharpness: `(num_views,)` larger is sharper.
        max_views: how many at most.
    """
    features = view_features(corners_m, corners_px, image_size)
    good = np.isfinite(features).all(axis=1)
    sharp = good & (sharpness >= BLURRED * np.median(sharpness))
    candidates = np.flatnonzero(sharp if sharp.sum() >= max_views // 2 else good)
    if len(candidates) <= max_views:
        return np.asarray(candidates, dtype=np.int64)
    seen = np.isfinite(corners_px[candidates, :, 0]).sum(axis=1)
    chosen = [int(np.argmax(seen * sharpness[candidates]))]
    distance = np.full(len(candidates), np.inf)
    while len(chosen) < max_views:
        newest = features[candidates[chosen[-1]]]
        distance = np.minimum(distance, np.linalg.norm(features[candidates] - newest, axis=1))
        chosen.append(int(np.argmax(distance)))
    return np.asarray(np.sort(candidates[chosen]), dtype=np.int64)


def view_features(corners_m: Floats, corners_px: Floats, image_size: tuple[int, int]) -> Floats:
    """Return `(num_views, 5)`: centre x and y, size, and two tilts, each of the order of one."""
    low, high = corners_m[:, :2].min(axis=0), corners_m[:, :2].max(axis=0)
    outline = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    features = np.full((len(corners_px), 5), np.nan)
    for index, view in enumerate(corners_px):
        seen = np.isfinite(view[:, 0])
        H = homography(corners_m[seen, :2], view[seen])
        homogeneous = np.column_stack([outline, np.ones(4)]) @ H.T
        if not np.isfinite(H).all() or not (homogeneous[:, 2] > 1e-9).all():
            continue
        quad = homogeneous[:, :2] / homogeneous[:, 2:]
        sides = np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1)
        middle = view[seen].mean(axis=0) / np.array(image_size)
        size = float(np.sqrt(sides.max() * sides.min()) / max(image_size))
        tilts = np.log(sides[[0, 1]] / sides[[2, 3]])
        features[index] = [*middle, size, *np.clip(TILT_SCALE * tilts, -1, 1)]
    return features


def tilted_views(
    corners_m: Floats, corners_px: Floats, image_size: tuple[int, int]
) -> NDArray[np.bool_]:
    """Return `(num_views, 2)` whether the board is tilted, forwards and to the side.

    Args:
        corners_m: `(num_corners, 3)` on the board.
        corners_px: `(num_views, num_corners, 2)`; NaN where not found.
        image_size: `(width, height)` in pixels.
    """
    tilts = view_features(corners_m, corners_px, image_size)[:, 3:]
    return np.asarray(np.abs(tilts) > TILT_SCALE * TILTS)


def homography(source: Floats, target: Floats) -> Floats:
    """Return `(3, 3)` H with `target ~ H source` for `(n, 2)` points (Hartley-Zisserman 4.1)."""
    if len(source) < 4:
        return np.full((3, 3), np.nan)
    mean, spread = target.mean(axis=0), float(target.std()) or 1.0
    origin, width = source.mean(axis=0), float(source.std()) or 1.0
    x, y = ((source - origin) / width).T
    u, v = ((target - mean) / spread).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    rows_u = np.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], axis=-1)
    rows_v = np.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], axis=-1)
    H = np.linalg.svd(np.concatenate([rows_u, rows_v]))[2][-1].reshape(3, 3)
    into = np.array(
        [[1 / width, 0, -origin[0] / width], [0, 1 / width, -origin[1] / width], [0, 0, 1]]
    )
    back = np.array([[spread, 0, mean[0]], [0, spread, mean[1]], [0, 0, 1]])
    H = back @ H @ into
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(H / H[2, 2])


def covered(corners_px: Floats, image_size: tuple[int, int]) -> NDArray[np.int64]:
    """Return `(3, 4)` counts of corners by part of the picture, top row first."""
    seen = corners_px[np.isfinite(corners_px[..., 0])]
    x = np.clip(seen[:, 0] / image_size[0] * GRID[0], 0, GRID[0] - 1).astype(int)
    y = np.clip(seen[:, 1] / image_size[1] * GRID[1], 0, GRID[1] - 1).astype(int)
    counts = np.zeros((GRID[1], GRID[0]), dtype=np.int64)
    np.add.at(counts, (y, x), 1)
    return counts


def advice(corners_m: Floats, corners_px: Floats, image_size: tuple[int, int]) -> list[str]:
    """Return what to record next for a better calibration, as sentences.

    Args:
        corners_m: `(num_corners, 3)` on the board.
        corners_px: `(num_views, num_corners, 2)` pixels; NaN where not seen.
        image_size: `(width, height)` pixels.
    """
    words = []
    if len(corners_px) < ENOUGH_VIEWS:
        words.append(f"record longer: {len(corners_px)} usable views, {ENOUGH_VIEWS} or more help")
    counts = covered(corners_px, image_size)
    rows, columns = ("top", "middle", "bottom"), ("left", "middle", "middle", "right")
    empty = {
        f"{rows[y]} {columns[x]}".replace("middle middle", "middle")
        for y, x in np.argwhere(counts < 4).tolist()
    }
    if empty:
        places = [f"{r} {c}" for r in rows for c in ("left", "middle", "right")]
        named = [p.replace("middle middle", "middle") for p in places]
        words.append("hold the board to the " + ", ".join(p for p in named if p in empty))
    features = view_features(corners_m, corners_px, image_size)
    features = features[np.isfinite(features).all(axis=1)]
    if len(features):
        tilted = tilted_views(corners_m, corners_px, image_size)
        for axis, how in ((0, "forwards and backwards"), (1, "to the left and to the right")):
            if tilted[:, axis].sum() < 4:
                words.append(f"tilt the board {how} by 20 to 40 degrees")
        if np.quantile(features[:, 2], 0.8) < SMALL:
            words.append("hold the board nearer: it should fill a third of the picture or more")
    return words
