"""Cameras that tests of different parts share."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from e3pose.model.camera import Camera, Rig


def towards(
    name: str,
    centre: ArrayLike,
    target: ArrayLike = (0.0, 0.0, 1.0),
    size: tuple[int, int] = (1000, 800),
    focal: float = 900.0,
    lens: ArrayLike = (),
    fisheye: bool = False,
) -> Camera:
    """A level camera at a place that looks at another."""
    K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
    place = np.array(centre, dtype=np.float64)
    forward = np.array(target, dtype=np.float64) - place
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    return Camera.from_world_to_camera(name, size, K, R, -R @ place, np.array(lens), fisheye)


def on_circle(radius_m: float, height_m: float, angle: float) -> list[float]:
    """Return a place on a circle around the z axis."""
    return [radius_m * np.cos(angle), radius_m * np.sin(angle), height_m]


def around(angles: Iterable[float], radius_m: float, height_m: float, name: str = "c") -> Rig:
    """Cameras at `angles`, radians, on a circle, that look at the middle of a room."""
    places = (on_circle(radius_m, height_m, angle) for angle in angles)
    return Rig(tuple(towards(f"{name}{index}", place) for index, place in enumerate(places)))


def looking(*places: tuple[float, float], away: bool = False) -> Rig:
    """Cameras 1 m high at these places, looking at the middle, or away from it."""
    targets = ((2 * x, 2 * y, 1.0) if away else (0.0, 0.0, 1.0) for x, y in places)
    cameras = (
        towards(f"c{index}", (*place, 1.0), target)
        for index, (place, target) in enumerate(zip(places, targets, strict=True))
    )
    return Rig(tuple(cameras))
