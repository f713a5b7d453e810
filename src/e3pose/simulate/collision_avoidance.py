"""Collision avoidance of walking people, one short time step at a time.

People head for where they want to go, foresee who or what they would pass too closely within the
next seconds and give way sideways, and never close in on anything that is already at arm's length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.simulate.occluders import Occluder

PERSON_RADIUS_M = 0.27  # two people pass with the middles of their bodies 0.54 m apart at the least
SEAT_RADIUS_M = 0.34
MARGIN_M = 0.12  # people plan to pass with this much more than they need
FORESIGHT_S = 2.2
GIVE_WAY_MPS2 = 4.0
RESPONSE_S = 0.45
MAX_ACCELERATION_MPS2 = 3.0
MAX_SPEED_MPS = 1.9
PUSH_PER_S = 3.0  # speed of backing off per metre of overlap
TURN_RATE = 2.0  # radians per second at most
TURN_RESPONSE_S = 0.3
TURN_ACCELERATION = 9.0
NOWHERE = 1e6  # where people who are away wait


@dataclass(slots=True)
class Group:
    """Everybody's state; the arrays change as time goes by.

    Attributes:
        xy: `(num_people, 2)` metres.
        velocity: `(num_people, 2)` metres per second.
        heading: `(num_people,)` radians.
        turning: `(num_people,)` radians per second.
        goal: `(num_people, 2)` metres.
        pace: `(num_people,)` wanted speed; 0 stands still.
        facing: `(num_people,)` desired heading of a standing person, NaN for any.
        stops: `(num_people,)` whether they slow down at the goal.
        own_seat: `(num_people,)` the seat that is no obstacle to them, -1 for none.
    """

    xy: Floats
    velocity: Floats
    heading: Floats
    turning: Floats
    goal: Floats
    pace: Floats
    facing: Floats
    stops: NDArray[np.bool_]
    own_seat: NDArray[np.int64]

    @classmethod
    def of(cls, number: int) -> Group:
        """Return `number` people, all of them nowhere."""
        nowhere = NOWHERE * (1 + np.arange(number, dtype=np.float64))
        xy = np.repeat(nowhere[:, None], 2, axis=1)
        flat = np.zeros(number)
        return cls(
            xy, np.zeros((number, 2)), flat.copy(), flat.copy(), xy.copy(), flat.copy(),
            np.full(number, np.nan), np.ones(number, dtype=bool), np.full(number, -1),
        )  # fmt: skip


def advance(
    group: Group, seats_xy: Floats, occluders: Sequence[Occluder], interval_s: float
) -> None:
    """Let a short time pass: everybody turns, speeds up or gives way, and moves."""
    walking = group.pace > 0
    to_goal = group.goal - group.xy
    distance = np.maximum(np.hypot(to_goal[:, 0], to_goal[:, 1]), 1e-9)
    pace = np.where(group.stops, np.minimum(group.pace, 1.3 * distance + 0.05), group.pace)
    direction = to_goal / distance[:, None]
    error = _turn(group, walking & (distance > 0.15), direction, interval_s)
    # Nobody walks backwards: far off course, people first turn on the spot.
    pace = np.where(walking, pace * np.clip(1.25 * np.cos(error), 0.0, 1.0), 0.0)
    acceleration = (direction * pace[:, None] - group.velocity) / RESPONSE_S
    others = _neighbours(group, seats_xy, occluders)
    acceleration += np.where(walking, 1.0, 0.0)[:, None] * _give_way(group.velocity, *others[:3])
    size = np.maximum(np.hypot(acceleration[:, 0], acceleration[:, 1]), 1e-9)
    acceleration *= np.minimum(1.0, MAX_ACCELERATION_MPS2 / size)[:, None]
    velocity = group.velocity + acceleration * interval_s
    speed = np.maximum(np.hypot(velocity[:, 0], velocity[:, 1]), 1e-9)
    velocity *= np.minimum(1.0, MAX_SPEED_MPS / speed)[:, None]
    velocity[(~walking) & (speed < 0.05)] = 0.0
    velocity = _keep_apart(velocity, walking, *others)
    group.velocity = velocity
    group.xy = group.xy + velocity * interval_s


def _turn(group: Group, walking: NDArray[np.bool_], direction: Floats, interval_s: float) -> Floats:
    """Turn everybody towards where they go or want to face; return the error left in radians."""
    moving = np.hypot(group.velocity[:, 0], group.velocity[:, 1]) > 0.4
    ahead = np.where(moving[:, None], group.velocity, direction)
    wanted = np.arctan2(ahead[:, 1], ahead[:, 0])
    asked = ~walking & np.isfinite(group.facing)
    wanted = np.where(asked, np.nan_to_num(group.facing), wanted)
    error = np.where(walking | asked, _wrapped(wanted - group.heading), 0.0)
    rate = np.clip(error / TURN_RESPONSE_S, -TURN_RATE, TURN_RATE)
    change = TURN_ACCELERATION * interval_s
    group.turning = group.turning + np.clip(rate - group.turning, -change, change)
    group.heading = group.heading + group.turning * interval_s
    course = np.arctan2(direction[:, 1], direction[:, 0]) - group.heading
    return np.where(walking & ~moving, _wrapped(course), 0.0)


def _neighbours(
    group: Group, seats_xy: Floats, occluders: Sequence[Occluder]
) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """Return offsets `(num_people, num_others, 2)`, velocities, clearances and who moves."""
    number = len(group.xy)
    offsets = [group.xy[None] - group.xy[:, None]]
    clearances = [np.full((number, number), 2 * PERSON_RADIUS_M)]
    np.fill_diagonal(clearances[0], -1.0)
    if len(seats_xy):
        offsets.append(seats_xy[None] - group.xy[:, None])
        clearance = np.full((number, len(seats_xy)), PERSON_RADIUS_M + SEAT_RADIUS_M)
        people = np.flatnonzero(group.own_seat >= 0)
        clearance[people, group.own_seat[people]] = -1.0
        clearances.append(clearance)
    for occluder in occluders:
        offsets.append((occluder.nearest(group.xy) - group.xy)[:, None])
        clearances.append(np.full((number, 1), PERSON_RADIUS_M))
    offset = np.concatenate(offsets, axis=1)
    velocity = np.zeros_like(offset)
    velocity[:, :number] = group.velocity
    moves = np.zeros(offset.shape[1], dtype=bool)
    moves[:number] = group.pace > 0
    return offset, velocity, np.concatenate(clearances, axis=1), moves


def _give_way(
    velocity: Floats,
    offset: Floats,
    other: Floats,
    clearance: Floats,
) -> Floats:
    """Return the acceleration `(num_people, 2)` sideways that avoids passing too closely."""
    closing = velocity[:, None] - other
    rate = (closing**2).sum(axis=-1)
    when = np.clip((offset * closing).sum(axis=-1) / np.maximum(rate, 1e-6), 0.0, FORESIGHT_S)
    miss = offset - closing * when[..., None]
    gap = np.hypot(miss[..., 0], miss[..., 1])
    need = clearance + MARGIN_M
    urgency = np.where((when > 0) & (clearance > 0), np.clip(1 - gap / need, 0.0, 1.0), 0.0)
    urgency *= np.exp(-when / 1.2)
    # Head-on, both step to their right.
    right = np.stack([closing[..., 1], -closing[..., 0]], axis=-1)
    right /= np.sqrt(np.maximum(rate, 1e-6))[..., None]
    away = -miss / np.maximum(gap, 1e-9)[..., None]
    away = np.where((gap < 0.05)[..., None], right, away)
    return np.asarray(GIVE_WAY_MPS2 * (away * urgency[..., None]).sum(axis=1))


def _keep_apart(
    velocity: Floats,
    walking: NDArray[np.bool_],
    offset: Floats,
    other: Floats,
    clearance: Floats,
    moves: NDArray[np.bool_],
) -> Floats:
    """Return velocities without the part that closes in on what is near already."""
    distance = np.hypot(offset[..., 0], offset[..., 1])
    near = walking[:, None] & (distance < clearance + 0.10)
    if not near.any():
        return velocity
    velocity = velocity.copy()
    for person, thing in np.argwhere(near):
        towards = offset[person, thing] / max(float(distance[person, thing]), 1e-9)
        share = 0.5 if moves[thing] else 1.0
        closing = float((velocity[person] - other[person, thing]) @ towards)
        gap = float(distance[person, thing] - clearance[person, thing])
        allowed = PUSH_PER_S * gap  # slow down with the distance left; back off when overlapping
        if closing > allowed:
            velocity[person] -= share * (closing - allowed) * towards
    return velocity


def _wrapped(angle: Floats) -> Floats:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
