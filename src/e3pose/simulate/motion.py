"""Whole-body motion, sampled at the slots of a recording."""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.simulate.activities import GRID_HZ, Life
from e3pose.simulate.body import Body, Posture, joints_of
from e3pose.simulate.episodes import with_episodes
from e3pose.simulate.gait import Gait, plan_gait, smoothstep
from e3pose.simulate.gestures import RAMP_S, move_arms

SEAT_HEIGHT_M = 0.45
HIP_OVER_SEAT_M = 0.09
STOPPED, LEAST_M = (5, 6, 7, 8, 9, 10, 13, 14), 0.02  # joints of COCO-17; over the floor
STRAIGHTNESS = 0.988  # share of its full length that a standing leg has
SOFT_M = 0.006  # rounding where the pelvis passes from one leg's reach to the other's
SMOOTH_S = 0.10  # a path is smoothed with a Gaussian of this width


def move(
    body: Body, life: Life, times_s: Floats, slots_s: Floats, rng: np.random.Generator
) -> Floats:
    """Return the joints `(num_slots, 17, 3)` of one person in metres, NaN while away.

    Args:
        body: the person's bones.
        life: what the person does on the grid.
        times_s: `(num_times,)` the grid.
        slots_s: `(num_slots,)` times within the grid at which the body is wanted.
        rng: for small involuntary movements.
    """
    joints = np.full((len(slots_s), 17, 3), np.nan)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], life.present.view(np.int8), [0]])))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if stop - start < 2:
            continue
        inside = (slots_s >= times_s[start] - 1e-9) & (slots_s <= times_s[stop - 1] + 1e-9)
        stay = slice(int(start), int(stop))
        joints[inside] = _stay(body, life, stay, times_s[stay], slots_s[inside], rng)
    return joints


def _stay(
    body: Body,
    life: Life,
    stay: slice,
    times_s: Floats,
    slots_s: Floats,
    rng: np.random.Generator,
) -> Floats:
    """Return the joints at `slots_s` of one uninterrupted stay in the scene."""
    root = _smooth(life.xy[stay])
    heading = _smooth(np.unwrap(life.heading[stay])[:, None])[:, 0]
    seated = smoothstep(life.seated[stay])
    gait = plan_gait(times_s, root, heading, body.leg, body.ankle_height, bool(rng.uniform() < 0.5))
    speed = np.linalg.norm(np.gradient(root, times_s, axis=0), axis=-1)
    gestures = tuple(g for g in life.gestures if times_s[0] - RAMP_S <= g.start_s <= times_s[-1])
    arms = move_arms(times_s, gait.rhythm, seated, gestures)
    drift = _drift(times_s, rng, 10)
    arms += 0.06 * drift[:, None, :4] * np.array([[1.0], [-0.8]])
    posture = Posture(
        pelvis_m=_pelvis(body, root, heading, seated, gait, drift),
        pelvis=np.stack(
            [heading - 0.09 * gait.rhythm, np.zeros_like(heading), 0.05 * gait.sway], axis=-1
        ),
        torso=np.stack(
            [
                heading + 0.11 * gait.rhythm + 0.05 * drift[:, 4],
                _lean(life.seated[stay], seated, speed) + 0.02 * drift[:, 5],
                0.015 * drift[:, 6] - 0.02 * gait.sway,
            ],
            axis=-1,
        ),
        head=np.stack(
            [
                heading + 0.28 * drift[:, 7] * np.exp(-speed),
                0.08 + 0.08 * drift[:, 8],
                0.03 * drift[:, 9],
            ],
            axis=-1,
        ),
        knees=heading,
        ankles_m=gait.ankles_m,
        arms=arms,
    )
    posture = with_episodes(body, posture, times_s, root, heading, tuple(life.episodes))
    joints = joints_of(body, _sampled(posture, times_s, slots_s))
    if life.episodes:  # arms and knees are not posed against the floor: it stops them
        joints[:, STOPPED, 2] = np.maximum(joints[:, STOPPED, 2], LEAST_M)
    return joints


def _pelvis(
    body: Body, root: Floats, heading: Floats, seated: Floats, gait: Gait, drift: Floats
) -> Floats:
    """Return the point between the hips: over the feet, as high as both legs reach."""
    left = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    back = (0.93 * body.thigh - 0.02) * smoothstep(1.15 * seated)
    xy = root + left * (0.022 * gait.sway + 0.012 * drift[:, 0] * (1 - seated))[:, None]
    xy = xy - ahead * (back - 0.01 * drift[:, 1] * (1 - seated))[:, None]
    standing = body.ankle_height + STRAIGHTNESS * body.leg
    heights = [np.full(len(root), standing)]
    for foot, side in enumerate((1.0, -1.0)):
        hip = xy + side * body.hip_half * left
        across = np.linalg.norm(gait.ankles_m[:, foot, :2] - hip, axis=-1)
        reach = np.sqrt(np.maximum((0.996 * body.leg) ** 2 - across**2, 0.01))
        heights.append(gait.ankles_m[:, foot, 2] + reach)
    stacked = np.stack(heights)
    lowest = stacked.min(axis=0)
    height = lowest - SOFT_M * np.log(np.exp(-(stacked - lowest) / SOFT_M).sum(axis=0))
    height = height + (SEAT_HEIGHT_M + HIP_OVER_SEAT_M - height) * seated
    return np.concatenate([xy, np.minimum(_smooth(height[:, None]), lowest[:, None])], axis=-1)


def _lean(progress: Floats, seated: Floats, speed: Floats) -> Floats:
    """Return how far the torso leans forward: most while sitting down or getting up."""
    return (
        0.03 + 0.04 * np.minimum(speed, 1.5) + 0.55 * np.sin(np.pi * progress) ** 2 - 0.1 * seated
    )


def _drift(times_s: Floats, rng: np.random.Generator, number: int) -> Floats:
    """Return slow aimless movements `(num_times, number)` of about unit size."""
    rate = rng.uniform(0.05, 0.45, (6, number))
    phase = rng.uniform(0, 2 * np.pi, (6, number))
    waves = [np.sin(2 * np.pi * np.outer(times_s, r) + p) for r, p in zip(rate, phase, strict=True)]
    return np.asarray(np.sum(waves, axis=0) / np.sqrt(3.0))


def _smooth(values: Floats) -> Floats:
    """Smooth `(num_times, components)` along time with a Gaussian; ends keep their value."""
    half = int(3 * SMOOTH_S * GRID_HZ)
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / (SMOOTH_S * GRID_HZ)) ** 2)
    kernel /= kernel.sum()
    padded = np.pad(values, ((half, half), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, kernel, mode="valid") for column in padded.T], axis=-1)


def _sampled(posture: Posture, times_s: Floats, slots_s: Floats) -> Posture:
    """Return the posture at other times, interpolated linearly."""
    upper = np.clip(np.searchsorted(times_s, slots_s), 1, len(times_s) - 1)
    lower = upper - 1
    share = np.clip((slots_s - times_s[lower]) / (times_s[upper] - times_s[lower]), 0.0, 1.0)

    def at(values: Floats) -> Floats:
        weight = share.reshape(-1, *(1,) * (values.ndim - 1))
        return np.asarray(values[lower] * (1 - weight) + values[upper] * weight)

    return Posture(
        at(posture.pelvis_m), at(posture.pelvis), at(posture.torso), at(posture.head),
        at(posture.knees), at(posture.ankles_m), at(posture.arms),
    )  # fmt: skip
