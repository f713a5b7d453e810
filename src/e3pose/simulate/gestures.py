"""Arm motion: hanging, swinging, resting on the thighs, gesturing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.simulate.gait import smoothstep

RAMP_S = 0.8  # time to raise the arms and to let them sink
SWING = 0.38  # radians of arm swing at a brisk walk
# Flexion, abduction, twist, elbow (radians; see `Posture.arms`).
HANGING = np.array([0.05, 0.14, 0.25, 0.28])
SEATED = np.array([0.55, 0.12, 0.30, 0.95])


@dataclass(frozen=True, slots=True)
class Gesture:
    """An arm pose with an oscillation around it.

    Attributes:
        pose: flexion, abduction, twist, elbow in radians.
        swing: amplitude of the oscillation of each.
        rate_hz: its frequency.
        both: whether both arms do it.
    """

    pose: tuple[float, float, float, float]
    swing: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    rate_hz: float = 1.0
    both: bool = False


GESTURES = {
    "wave": Gesture((0.1, 1.25, -1.45, 1.45), (0.0, 0.05, 0.0, 0.40), 1.5),
    "point": Gesture((1.35, 0.20, 0.10, 0.15), (0.06, 0.10, 0.0, 0.05), 0.4),
    "talk": Gesture((0.45, 0.25, 0.40, 1.45), (0.15, 0.08, 0.25, 0.30), 0.8, both=True),
    "phone": Gesture((0.75, 0.35, 0.45, 2.25), (0.03, 0.03, 0.0, 0.03), 0.3),
    "reach": Gesture((2.45, 0.15, 0.0, 0.35), (0.12, 0.08, 0.0, 0.15), 0.5, both=True),
    "crossed": Gesture((0.50, 0.05, 1.15, 1.75), (0.02, 0.02, 0.0, 0.02), 0.25, both=True),
    "hips": Gesture((-0.35, 0.75, 0.95, 1.55), (0.02, 0.02, 0.0, 0.02), 0.25, both=True),
}
# What people do with their hands for minutes; nobody does it who is not asked to.
HELD = {
    "plate": Gesture((0.40, 0.12, 0.55, 1.55), (0.04, 0.03, 0.03, 0.06), 0.25),
    "cup": Gesture((0.55, 0.25, 0.50, 1.85), (0.18, 0.05, 0.05, 0.30), 0.12),
    "lean": Gesture((0.75, 0.18, 0.25, 0.60), (0.04, 0.03, 0.03, 0.05), 0.15, both=True),
    "work": Gesture((0.70, 0.18, 0.60, 1.15), (0.10, 0.05, 0.10, 0.12), 0.50, both=True),
    "eat": Gesture((0.65, 0.15, 0.65, 1.60), (0.15, 0.05, 0.10, 0.35), 0.20, both=True),
}
CALM = ("talk", "phone", "crossed", "point")  # gestures that people make seated


@dataclass(frozen=True, slots=True)
class Gesturing:
    """One gesture in time: from `start_s` to `stop_s`, by the left arm, the right one or both."""

    name: str
    start_s: float
    stop_s: float
    left: bool


def move_arms(
    times_s: Floats, rhythm: Floats, seated: Floats, gestures: tuple[Gesturing, ...]
) -> Floats:
    """Return arm angles `(num_times, 2, 4)`.

    Args:
        times_s: `(num_times,)`.
        rhythm: `(num_times,)` of the gait, -1 to 1: the arms swing against the feet.
        seated: `(num_times,)` 0 standing to 1 seated.
        gestures: what is done on top.
    """
    rest = HANGING + (SEATED - HANGING) * seated[:, None]
    arms = np.repeat(rest[:, None], 2, axis=1)
    for index, side in enumerate((1.0, -1.0)):
        swing = -side * rhythm * SWING
        arms[:, index, 0] += swing
        arms[:, index, 3] += np.maximum(swing, 0) * 0.6 + np.abs(rhythm) * 0.08
    for gesturing in gestures:
        gesture = GESTURES.get(gesturing.name) or HELD[gesturing.name]
        weight = smoothstep((times_s - gesturing.start_s) / RAMP_S)
        weight = weight * smoothstep((gesturing.stop_s - times_s) / RAMP_S)
        active = weight > 0
        phase = 2 * np.pi * gesture.rate_hz * (times_s[active] - gesturing.start_s)
        for index in (0, 1):
            if gesture.both or gesturing.left == (index == 0):
                wave = np.sin(phase + 0.9 * index)[:, None] * np.array(gesture.swing)
                target = np.array(gesture.pose) + wave
                arms[active, index] += weight[active, None] * (target - arms[active, index])
    return arms
