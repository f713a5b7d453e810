"""Pictures of a board through a known camera."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.calibrate.board import Board
from e3pose.model.camera import Camera

SQUARE_PX = 32  # of the drawing that is warped


def facing(
    camera: Camera, board: Board, middle_m: Floats, tilts: tuple[float, float], roll: float = 0.0
) -> Floats:
    """Return the `(4, 4)` board-to-world transform of a board in front of a camera."""
    turn = cv2.Rodrigues(np.array([tilts[0], tilts[1], 0.0]))[0]
    turn = turn @ cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
    board_in_camera = np.eye(4)
    board_in_camera[:3, :3] = turn
    middle = np.array([board.columns / 2, board.rows / 2, 0.0]) * board.square_m
    board_in_camera[:3, 3] = middle_m - turn @ middle
    return np.asarray(camera.T_world_camera @ board_in_camera)


def render(camera: Camera, board: Board, T_world_board: Floats) -> NDArray[np.uint8]:
    """Return the grey `(height, width)` picture: the ray of each pixel meets the board's plane."""
    drawing = np.where(board.cells(), 20, 235).astype(np.uint8)
    drawing = drawing.repeat(SQUARE_PX // 8, axis=0).repeat(SQUARE_PX // 8, axis=1)
    drawing = np.pad(drawing, SQUARE_PX, constant_values=235)
    width, height = camera.image_size
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
    ideal = camera.normalise(pixels.astype(np.float64))
    rays = np.concatenate([ideal, np.ones((height, width, 1))], axis=-1)
    board_in_camera = np.linalg.inv(camera.T_world_camera) @ T_world_board
    R, t = board_in_camera[:3, :3], board_in_camera[:3, 3]
    depth = (R[:, 2] @ t) / (rays @ R[:, 2])
    place = (rays * depth[..., None] - t) @ R
    where = place[..., :2] * (SQUARE_PX / board.square_m) + SQUARE_PX - 0.5
    where[~np.isfinite(where).all(axis=-1) | (depth <= 0)] = -1e4
    scale = t[2] / camera.K[0, 0] * SQUARE_PX / board.square_m
    soft = cv2.GaussianBlur(drawing, (0, 0), max(0.3, 0.5 * scale))
    picture = cv2.remap(
        soft, where[..., 0].astype(np.float32), where[..., 1].astype(np.float32),
        cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=90,
    )  # fmt: skip
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.7))


def corner_views(
    camera: Camera,
    board: Board,
    number: int,
    rng: np.random.Generator,
    noise_px: float,
    share: tuple[float, float] = (0.2, 0.45),
) -> Floats:
    """Return `(number, num_corners, 2)` corners of boards all over the picture, NaN outside it."""
    width, height = camera.image_size
    views = []
    for _ in range(number):
        distance = board.columns * board.square_m * camera.K[0, 0] / (rng.uniform(*share) * width)
        pixel = rng.uniform([0.12 * width, 0.12 * height], [0.88 * width, 0.88 * height])
        middle = np.array([*camera.normalise(pixel), 1.0])
        middle *= distance / np.linalg.norm(middle)
        tilts = rng.uniform(-0.7, 0.7, 2)
        placed = facing(camera, board, middle, (tilts[0], tilts[1]), rng.uniform(-0.5, 0.5))
        corners = board.corners_m @ placed[:3, :3].T + placed[:3, 3]
        pixels = camera.project(corners) + rng.normal(0, noise_px, (len(corners), 2))
        inside = camera.sees(corners)
        views.append(np.where(inside[:, None], pixels, np.nan))
    seen = [view for view in views if np.isfinite(view[:, 0]).sum() >= 8]
    return np.array(seen)
