"""Rigs that tests of different parts share."""

from __future__ import annotations

import numpy as np

from e3pose.model.camera import Camera, Rig


def looking(*places: tuple[float, float], away: bool = False) -> Rig:
    """Cameras 1 m high at these places, looking at the middle, or away from it."""
    K = np.array([[900.0, 0, 500], [0, 900, 400], [0, 0, 1]])
    cameras = []
    for index, place in enumerate(places):
        centre = np.array([*place, 1.0])
        forward = np.array([0, 0, 1.0]) - centre
        forward /= np.linalg.norm(forward) * (-1 if away else 1)
        right = np.cross(forward, [0, 0, 1.0])
        R = np.stack([right, np.cross(forward, right), forward])
        cameras.append(Camera.from_world_to_camera(f"c{index}", (1000, 800), K, R, -R @ centre))
    return Rig(tuple(cameras))
