"""Measures of a body from its pose: heights as shares of the stature, inclinations, speed.

A figure is a value and its standard deviation; what no known joint tells is NaN. Heights are over
the floor, or over the bed or seat that the person is on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.model.proportions import KINDS, LEAST_M, MOST_M, RIGID, STATURE_M

UNSTATED_M = 0.05  # standard deviation of a joint whose own is not known
ONE_SIDE_M = 0.05  # one hip is so far from the middle of both
LEAST_LIMB_M = 0.05
FIGURES = ("hips", "shoulders", "head", "trunk", "thighs", "shanks", "speed")
HIPS, SHOULDERS, HEAD, TRUNK, THIGHS, SHANKS, SPEED = range(len(FIGURES))
_SHARES = tuple((names, kind.share) for names, kind in KINDS.items() if kind.give == RIGID)
STATURE_SPREAD = 0.12  # of the logarithm of the stature of somebody who comes in
LENGTH_SPREAD = 0.08  # of that of one limb about its share
SLOTS_OF_ONE = 25.0  # so many slots in a row say as much as one independent look
LEAST_SPREAD = 0.02  # nobody's stature is known better


@dataclass(frozen=True, slots=True, eq=False)
class Joints:
    """Where the joints that a body's figures need stand on the joint axis; -1 where there is none.

    Attributes:
        hips, shoulders, knees, ankles, wrists: left and right.
        head: joints of the head.
        limbs: `(num_limbs, 2)` rigid limbs.
        shares: `(num_limbs,)` their lengths as shares of the stature.
    """

    hips: tuple[int, int]
    shoulders: tuple[int, int]
    knees: tuple[int, int]
    ankles: tuple[int, int]
    wrists: tuple[int, int]
    head: tuple[int, ...]
    limbs: NDArray[np.int64]
    shares: Floats


def joints_of(names: tuple[str, ...]) -> Joints:
    """Return where the joints of a skeleton are, by their names."""
    place = {name: index for index, name in enumerate(names)}

    def both(joint: str) -> tuple[int, int]:
        return place.get(f"left_{joint}", -1), place.get(f"right_{joint}", -1)

    limbs, shares = [], []
    for (first, second), share in _SHARES:
        for side in ("left", "right"):
            ends = place.get(f"{side}_{first}", -1), place.get(f"{side}_{second}", -1)
            if min(ends) >= 0:
                limbs.append(ends)
                shares.append(share)
    head = tuple(place[n] for n in ("nose", "left_ear", "right_ear", "head") if n in place)
    return Joints(
        both("hip"), both("shoulder"), both("knee"), both("ankle"), both("wrist"), head,
        np.array(limbs, dtype=np.int64).reshape(-1, 2), np.array(shares),
    )  # fmt: skip


class Stature(NamedTuple):
    """Knowledge of the statures of people: mean and precision of their logarithms.

    Attributes:
        mean: `(num_persons,)`.
        precision: `(num_persons,)`.
    """

    mean: Floats
    precision: Floats

    @property
    def m(self) -> Floats:
        """`(num_persons,)` metres."""
        return np.asarray(np.clip(np.exp(self.mean), LEAST_M, MOST_M))


USUAL = (float(np.log(STATURE_M)), STATURE_SPREAD**-2)  # of somebody who comes in


def stature_after(before: Stature, joints: Joints, joints_m: Floats, sigma_m: Floats) -> Stature:
    """Return the knowledge of statures after a pose of each person.

    Args:
        before: what was known.
        joints: of the skeleton.
        joints_m: `(num_persons, num_joints, 3)` metres, NaN where unknown.
        sigma_m: `(num_persons, num_joints)` standard deviation along an axis.
    """
    first, second = joints.limbs.T
    length_m = np.linalg.norm(joints_m[:, first] - joints_m[:, second], axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.hypot(sigma_m[:, first], sigma_m[:, second]) / length_m
        weight = 1 / (LENGTH_SPREAD**2 + off**2) / SLOTS_OF_ONE
        said = np.log(length_m / joints.shares)
    known = (length_m > LEAST_LIMB_M) & np.isfinite(weight)
    weight = np.where(known, weight, 0.0)
    total = weight.sum(axis=1)
    told = (np.where(known, said, 0.0) * weight).sum(axis=1) / np.maximum(total, 1e-12)
    gain = total / (before.precision + total)
    precision = np.minimum(before.precision + total, LEAST_SPREAD**-2)
    return Stature(before.mean + gain * (told - before.mean), precision)


def figures(
    joints: Joints, joints_m: Floats, sigma_m: Floats, stature_m: Floats, surface_m: Floats
) -> tuple[Floats, Floats]:
    """Return the measures of bodies by their poses, all but their speed.

    Args:
        joints: of the skeleton.
        joints_m: `(num_persons, num_joints, 3)` metres, NaN where unknown.
        sigma_m: `(num_persons, num_joints)` standard deviation along an axis.
        stature_m: `(num_persons,)`.
        surface_m: `(num_persons,)` height of what each is on.

    Returns:
        `(num_persons, 7)` the values of `FIGURES`, heights as shares of the stature and
        inclinations against the vertical in degrees, and their standard deviations; NaN where
        unknown.
    """
    shape = (len(joints_m), len(FIGURES))
    value, spread = np.full(shape, np.nan), np.full(shape, np.nan)
    parts = (joints.hips, joints.shoulders, joints.head, joints.knees, joints.ankles)
    hips, shoulders, head, knees, ankles = (middle(joints_m, sigma_m, part) for part in parts)
    for figure, (place_m, sigma) in ((HIPS, hips), (SHOULDERS, shoulders), (HEAD, head)):
        value[:, figure] = (place_m[:, 2] - surface_m) / stature_m
        spread[:, figure] = sigma / stature_m
    for figure, top, low in (
        (TRUNK, shoulders, hips), (THIGHS, hips, knees), (SHANKS, knees, ankles)
    ):  # fmt: skip
        along_m = top[0] - low[0]
        length_m = np.sqrt((along_m**2).sum(axis=1))
        length_m[~(length_m > LEAST_LIMB_M)] = np.nan
        upright = np.clip(along_m[:, 2] / length_m, -1.0, 1.0)
        value[:, figure] = np.degrees(np.arccos(upright))
        spread[:, figure] = np.degrees(np.hypot(top[1], low[1]) / length_m)
    return value, spread


class Carriage(NamedTuple):
    """The carriage of a body; NaN where no known joint tells.

    Attributes:
        hips_m: height of the middle of the hips over the floor, or the bed or seat.
        trunk_deg: inclination of the trunk against the vertical.
        arms_raised: how many wrists are higher than their shoulder.
    """

    hips_m: float
    trunk_deg: float
    arms_raised: float


def carriage(joints: Joints, joints_m: Floats, surface_m: float) -> Carriage:
    """Return how one person holds the body.

    Args:
        joints: of the skeleton.
        joints_m: `(num_joints, 3)` metres, NaN where unknown.
        surface_m: height of what the person is on.
    """
    sure = np.zeros((1, len(joints_m)))
    value, _ = figures(joints, joints_m[None], sure, np.ones(1), np.full(1, surface_m))
    sides = zip(joints.wrists, joints.shoulders, strict=True)
    up_m = [joints_m[low, 2] - joints_m[top, 2] for low, top in sides if min(low, top) >= 0]
    known = [height_m for height_m in up_m if np.isfinite(height_m)]
    raised = float(sum(height_m > 0 for height_m in known)) if known else float("nan")
    return Carriage(float(value[0, HIPS]), float(value[0, TRUNK]), raised)


def middle(joints_m: Floats, sigma_m: Floats, which: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Return the middle of some joints of each person and its standard deviation.

    Args:
        joints_m: `(num_persons, num_joints, 3)` metres, NaN where unknown.
        sigma_m: `(num_persons, num_joints)`.
        which: indices of joints; -1 for those that the skeleton lacks.

    Returns:
        `(num_persons, 3)` and `(num_persons,)` metres; NaN where none of the joints is known.
    """
    rows = [index for index in which if index >= 0]
    if not rows:
        return np.full((len(joints_m), 3), np.nan), np.full(len(joints_m), np.nan)
    places_m, sigma = joints_m[:, rows], sigma_m[:, rows]
    known = np.isfinite(places_m[..., 0])
    count = known.sum(axis=1)
    sigma = np.where(np.isfinite(sigma), sigma, UNSTATED_M)
    with np.errstate(invalid="ignore", divide="ignore"):
        place_m = np.where(known[..., None], places_m, 0.0).sum(axis=1) / count[:, None]
        variance = np.where(known, sigma**2, 0.0).sum(axis=1) / count
    alone = (count == 1) & (len(which) == 2)
    return place_m, np.sqrt(variance + np.where(alone, ONE_SIDE_M**2, 0.0))
