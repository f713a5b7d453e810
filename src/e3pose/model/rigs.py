"""Simulated rigs, and where a rig's cameras look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.camera import Camera, Rig

TARGET_HEIGHT_M = 1.0  # ring cameras look at the middle of a person
FIELD_OF_VIEW_DEG = 52.0  # horizontal; the cameras of Shelf have 51 degrees
UPRIGHT_DOT = 0.999


@dataclass(frozen=True, slots=True)
class Spot:
    """Where a camera of the scene's own stands, the point it looks at, and how wide.

    Attributes:
        x_m: east.
        y_m: north.
        z_m: above the floor.
        target_x_m: east of the point that it looks at.
        target_y_m: north of that point.
        view_deg: horizontal field of view.
        target_z_m: height of the point that it looks at.
        roll_deg: by which it hangs askew, clockwise as it looks.
    """

    x_m: float
    y_m: float
    z_m: float
    target_x_m: float
    target_y_m: float
    view_deg: float = 75.0
    target_z_m: float = TARGET_HEIGHT_M
    roll_deg: float = 0.0


def ring_rig(
    num_cameras: int,
    radius_m: float,
    height_m: float,
    image_size: tuple[int, int],
    rng: np.random.Generator,
) -> Rig:
    """Stand cameras on a ring around the origin, looking at its middle, a little irregularly.

    Args:
        num_cameras: how many.
        radius_m: their distance from the z axis, give or take 3 %.
        height_m: their height above the floor, give or take 10 %.
        image_size: `(width, height)` in pixels.
        rng: where the irregularity comes from.
    """
    K = _intrinsics(image_size, FIELD_OF_VIEW_DEG)
    spacing = 2 * np.pi / num_cameras
    cameras = []
    for index in range(num_cameras):
        wobble = rng.uniform(-1, 1, 5)
        angle = index * spacing + 0.08 * spacing * wobble[0]
        distance = radius_m * (1 + 0.03 * wobble[1])
        centre = np.array(
            [
                distance * np.cos(angle),
                distance * np.sin(angle),
                height_m * (1 + 0.1 * wobble[2]),
            ]
        )
        target = np.array([0.2 * wobble[3], 0.2 * wobble[4], TARGET_HEIGHT_M])
        cameras.append(
            Camera(f"cam{index}", image_size, K, _looking(centre, target), np.zeros(0), False)
        )
    return Rig(tuple(cameras))


def spot_rig(
    spots: Sequence[Spot], image_size: tuple[int, int], rng: np.random.Generator
) -> tuple[Rig, Floats]:
    """Stand cameras where a scene has places for them, a little irregularly.

    Args:
        spots: where they stand and look.
        image_size: `(width, height)` in pixels.
        rng: where the irregularity comes from: up to 5 cm of place and 20 cm of aim.

    Returns:
        The rig, and `(num_cameras,)` the distances in metres that the lenses are focused at.
    """
    cameras, focus_m = [], []
    for index, spot in enumerate(spots):
        wobble = rng.uniform(-1, 1, 5)
        centre = np.array([spot.x_m, spot.y_m, spot.z_m]) + 0.05 * wobble[:3]
        target = np.array([spot.target_x_m, spot.target_y_m, spot.target_z_m])
        target[:2] += 0.2 * wobble[3:]
        K = _intrinsics(image_size, spot.view_deg)
        place = _looking(centre, target)
        if spot.roll_deg:
            c, s = np.cos(np.radians(spot.roll_deg)), np.sin(np.radians(spot.roll_deg))
            place[:3, :3] = place[:3, :3] @ [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
        cameras.append(Camera(f"cam{index}", image_size, K, place, np.zeros(0), False))
        focus_m.append(float(np.linalg.norm(target - centre)))
    return Rig(tuple(cameras)), np.array(focus_m)


def watched_area(rig: Rig) -> tuple[Floats, float]:
    """Return the floor point `(2,)` that a rig looks at, and how far around it people may roam.

    The point is the one nearest to all optical axes; people keep within half the typical distance
    of a camera from it, so that most cameras see most of them.
    """
    axes = np.stack([camera.R[2] for camera in rig.cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    # A weak pull to two metres before each camera decides where the axes leave a direction free.
    before = rig.centers_m + 3.0 * axes
    matrix = across.sum(axis=0) + 0.05 * len(rig) * np.eye(3)
    vector = (across @ rig.centers_m[..., None]).sum(axis=0)[:, 0] + 0.05 * before.sum(axis=0)
    centre = np.linalg.solve(matrix, vector)[:2]
    distance = float(np.median(np.linalg.norm(rig.centers_m[:, :2] - centre, axis=1)))
    return centre, float(np.clip(0.5 * distance, 1.2, 8.0))


def _intrinsics(image_size: tuple[int, int], view_deg: float) -> Floats:
    width, height = image_size
    focal = max(image_size) / 2 / np.tan(np.radians(view_deg / 2))
    return np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])


def _looking(centre_m: Floats, target_m: Floats) -> Floats:
    """Return the `(4, 4)` camera-to-world transform of an upright camera looking at a point."""
    forward = target_m - centre_m
    forward /= np.linalg.norm(forward)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < UPRIGHT_DOT else np.array([1.0, 0.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    T_world_camera[:3, 3] = centre_m
    return T_world_camera
