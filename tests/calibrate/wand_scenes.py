"""A wand that is carried about before cameras, as they see it."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.calibrate.wand import Wand
from e3pose.model.camera import Rig
from e3pose.model.rigs import ring_rig


def ring(seed: int, cameras: int = 4) -> Rig:
    return ring_rig(cameras, 4.0, 2.2, (1280, 720), np.random.default_rng(seed))


def carried(rig: Rig, wand: Wand, seed: int, times: int = 150, noise_px: float = 0.7) -> Floats:
    """Return what cameras see of a wand that is turned and carried about, some of it hidden."""
    rng = np.random.default_rng([seed, 1])
    middle = rng.uniform([-1.5, -1.5, 0.3], [1.5, 1.5, 2.0], (times, 3))
    direction = rng.normal(size=(times, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    along_m = wand.places_m - wand.length_m / 2
    points = middle[:, None] + along_m[:, None] * direction[:, None]
    pixels = rig.project(points.reshape(-1, 3)).reshape(len(rig), times, -1, 2)
    pixels = pixels + rng.normal(0, noise_px, pixels.shape)
    seen = np.stack([camera.sees(points.reshape(-1, 3)) for camera in rig.cameras])
    hidden = ~seen.reshape(pixels.shape[:-1]) | (rng.random(pixels.shape[:-1]) < 0.1)
    wild = rng.random(pixels.shape[:-1]) < 0.02  # something else of the colour
    pixels[wild] += rng.normal(0, 80, (int(wild.sum()), 2))
    return np.where(hidden[..., None], np.nan, pixels)
