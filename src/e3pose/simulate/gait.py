"""Gait: ankle positions while a person walks, turns or stands.

Steps are planned from the path of the body, so a foot on the floor stays where it was put. Time is
measured in steps: the progress of a bout of walking runs from 0 to its number of steps, one more
than the way needs, since the last foot closes up to the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats

STEP_BASE_M = 0.34  # step length at a standstill and its growth with speed, for a leg of 0.84 m
STEP_GROWTH_S = 0.28
TURN_STEP = 1.0  # radians turned on the spot in one step
LIFT_OFF = 1.3  # a foot starts to leave the floor so many steps before the end of its own
LANDING = 0.1  # and is down again so much before the end
BEHIND = 0.12  # share of a step by which feet land behind the place the body will have
WALKING_HALF_M = 0.06  # half the distance between the lines on which the feet land
STANDING_HALF_M = 0.10
MIN_PACE = 0.03  # steps per second below which a person stands
SWING_LIFT_M = 0.13
HALT_S = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class Gait:
    """Feet and rhythm on a time grid.

    Attributes:
        ankles_m: `(num_times, 2, 3)` left and right ankle.
        rhythm: `(num_times,)` -1 to 1: how far the left foot is before the right, 0 when standing.
        sway: `(num_times,)` -1 to 1: towards which side the weight is, left positive.
    """

    ankles_m: Floats
    rhythm: Floats
    sway: Floats


def plan_gait(
    times_s: Floats,
    root_m: Floats,
    heading: Floats,
    leg_m: float,
    ankle_height_m: float,
    first_left: bool,
) -> Gait:
    """Plan the feet of a body that moves along a path.

    Args:
        times_s: `(num_times,)` even grid.
        root_m: `(num_times, 2)` where the body is on the floor.
        heading: `(num_times,)` where it faces, radians without jumps.
        leg_m: length of the leg; long legs make long steps.
        ankle_height_m: of an ankle whose foot is flat on the floor.
        first_left: whether the first step is the left foot's.
    """
    number = len(times_s)
    interval = float(times_s[1] - times_s[0]) if number > 1 else 1.0
    root_m, heading = _walked_on(root_m, heading, interval)
    pace, speed = _pace(root_m, heading, interval, leg_m)
    ankles = np.empty((len(root_m), 2, 3))
    feet = _beside(root_m[0], heading[0], STANDING_HALF_M)
    ankles[:, :, :2] = feet
    ankles[:, :, 2] = ankle_height_m
    rhythm, sway = np.zeros(len(root_m)), np.zeros(len(root_m))
    left = first_left
    moving = np.concatenate([[0], (pace > MIN_PACE).view(np.int8), [0]])
    edges = np.flatnonzero(np.diff(moving)).tolist()
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if stop - start <= 2:  # a flicker
            continue
        travelled = np.concatenate([[0.0], np.cumsum(pace[start : stop - 1]) * interval])
        ways = max(1, round(float(travelled[-1])))
        travelled *= ways / max(float(travelled[-1]), 1e-9)
        progress = _progress(travelled, ways)
        part = slice(start, stop)
        _walk(ankles, part, progress, travelled, root_m[part], heading[part], left, ankle_height_m)
        sign = 1.0 if left else -1.0
        strength = np.minimum(1.0, speed[part] / 0.8) * (
            smoothstep(progress / 0.5) * smoothstep(((ways + 1.0) - progress) / 0.5)
        )
        rhythm[part] = -sign * np.cos(np.pi * progress) * strength
        sway[part] = -sign * np.sin(np.pi * progress) * strength
        left = left if ways % 2 else not left
    return Gait(ankles[:number], rhythm[:number], sway[:number])


def smoothstep(x: Floats) -> Floats:
    """Rise from 0 at x = 0 to 1 at x = 1 with flat ends."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * x * (10 + x * (6 * x - 15)))


def _walked_on(root: Floats, heading: Floats, interval: float) -> tuple[Floats, Floats]:
    """Append how somebody who is out of sight in mid-stride would come to a halt."""
    if len(root) < 2:
        return root, heading
    times = interval * np.arange(1, int(6 * HALT_S / interval))[:, None]
    way = (root[-1] - root[-2]) / interval * HALT_S * (1 - np.exp(-times / HALT_S))
    return np.concatenate([root, root[-1] + way]), np.pad(heading, (0, len(times)), mode="edge")


def _progress(travelled: Floats, ways: int) -> Floats:
    """Return steps done `(num_times,)`, from 0 to `ways + 1`, where the body has gone `travelled`.

    On the way a foot lands half a step before the body gets there; the half step is gained softly
    at the start, and the last foot's closing step at the end.
    """
    soft = min(max(ways / 2, 1.0), 2.0)
    gained = smoothstep(travelled / soft) + smoothstep((travelled - (ways - soft)) / soft)
    return np.asarray(travelled + 0.5 * gained)


def _walk(
    ankles: Floats,
    part: slice,
    progress: Floats,
    travelled: Floats,
    root: Floats,
    heading: Floats,
    left: bool,
    ankle_height_m: float,
) -> None:
    """Write the ankles of one bout of walking, and where they stay after it."""
    ways = round(float(travelled[-1]))
    last = ways + 1
    places = np.arange(1, last + 1, dtype=np.float64)
    places = np.where(places < ways, places - BEHIND, ways)
    x, y, yaw = (
        np.interp(places, travelled, values) for values in (root[:, 0], root[:, 1], heading)
    )
    half = np.where(np.arange(1, last + 1) < ways, WALKING_HALF_M, STANDING_HALF_M)
    for step in range(1, last + 1):
        foot = (step + (0 if left else 1) + 1) % 2  # step 1 is the left foot's if `left`
        side = 1.0 - 2.0 * foot
        target = np.array(
            [
                x[step - 1] - side * half[step - 1] * np.sin(yaw[step - 1]),
                y[step - 1] + side * half[step - 1] * np.cos(yaw[step - 1]),
            ]
        )
        begin = max(step - LIFT_OFF, 0.0)
        first, end = np.searchsorted(progress, [begin, step - LANDING])
        origin = ankles[part.start + first, foot, :2].copy()
        share = (progress[first:end] - begin) / (step - LANDING - begin)
        eased = smoothstep(share)  # slow to leave, as the heel rises first, and soft to land
        rows = slice(part.start + first, part.start + end)
        ankles[rows, foot, :2] = origin + (target - origin) * eased[:, None]
        stride = float(np.linalg.norm(target - origin))
        lift = (0.03 + (SWING_LIFT_M - 0.03) * min(1.0, stride / 1.2)) * min(1.0, stride / 0.05)
        bump = 16 * (share * (1 - share)) ** 2
        ankles[rows, foot, 2] = ankle_height_m + lift * bump
        ankles[part.start + end :, foot, :2] = target
        ankles[part.start + end :, foot, 2] = ankle_height_m


def _pace(root: Floats, heading: Floats, interval: float, leg_m: float) -> tuple[Floats, Floats]:
    """Return steps per second and metres per second, `(num_times,)` each."""
    if len(root) < 2:
        return np.zeros(len(root)), np.zeros(len(root))
    speed = np.linalg.norm(np.gradient(root, interval, axis=0), axis=-1)
    turning = np.abs(np.gradient(heading, interval))
    step_m = (STEP_BASE_M + STEP_GROWTH_S * speed) * leg_m / 0.84
    return speed / step_m + turning / TURN_STEP * np.exp(-speed / 0.3), speed


def _beside(root: Floats, heading: float, half_m: float) -> Floats:
    """Return `(2, 2)` floor points left and right of a body."""
    left = half_m * np.array([-np.sin(heading), np.cos(heading)])
    return np.stack([root + left, root - left])
