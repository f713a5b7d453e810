"""Keypoint heads of top-down networks: SimCC and heatmaps.

Li et al., "SimCC: a Simple Coordinate Classification Perspective for Human Pose Estimation", ECCV
2022; Jiang et al., "RTMPose: Real-Time Multi-Person Pose Estimation based on MMPose", 2023; Xu et
al., "ViTPose: Simple Vision Transformer Baselines for Human Pose Estimation", NeurIPS 2022.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats


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
