"""Episodes: what a person does besides walking, standing and sitting, by key postures.

Key postures are in shares of the stature, relative to where the person stands and faces. Between
two of them a body moves along `u ** ease` where it falls, and smoothly where it is in control.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.simulate.body import Body, Posture
from e3pose.simulate.gait import smoothstep

FALL_EASE = 1.6  # of `u ** ease`: 0.46 of 1.7 m in 0.58 s end at 2.1 m/s
BLEND_S = 0.3  # in which the posture of somebody who stands or walks becomes the first key
LOW = 0.15  # pelvis, share of the stature: on the floor
Arms = tuple[float, float, float, float]
HANG: Arms = (0.05, 0.1, 0.1, 0.2)
Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Key:
    """A posture that a body passes.

    Attributes:
        after_s: how long after the key before.
        pelvis: ahead, left and up, shares of the stature.
        feet: the same of the left ankle; the right one mirrors it unless `right` is given.
        right: of the right ankle.
        pitch: of the trunk forward, radians.
        roll: of the trunk to the right, radians.
        turn: of the whole body to the left, radians.
        arms: flexion, abduction, twist and bend of both.
        ease: power of the time share on the way here; 0 for a smooth movement.
        lift_m: surface that the body is on, metres over the floor.
    """

    after_s: float
    pelvis: Triple = (0.0, 0.0, 0.53)
    feet: Triple = (0.0, 0.06, 0.045)
    right: Triple | None = None
    pitch: float = 0.05
    roll: float = 0.0
    turn: float = 0.0
    arms: Arms = HANG
    ease: float = 0.0
    lift_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Episode:
    """What one person does from a time on.

    Attributes:
        kind: its name in `episode_kinds.EPISODES`.
        start_s: when the first key begins.
        keys: the postures.
        down_s: when the body reaches the floor after `start_s`; NaN where it never does.
    """

    kind: str
    start_s: float
    keys: tuple[Key, ...]
    down_s: float = float("nan")

    @property
    def stop_s(self) -> float:
        """When the last key is reached."""
        return self.start_s + sum(key.after_s for key in self.keys)


STAND = Key(0.5)


def planned(
    kind: str,
    keys: Sequence[Key],
    start_s: float,
    rng: np.random.Generator,
    stays_s: float = 0.0,
    gets_up: tuple[Key, ...] = (),
) -> Episode:
    """Return an episode as one person does it.

    Args:
        kind: of the keys.
        keys: the postures; see `episode_kinds`.
        start_s: when it begins.
        rng: how people differ.
        stays_s: how long they stay in the last posture.
        gets_up: what they do then.
    """
    varied = [_varied(key, rng) for key in keys]
    passed_s = np.cumsum([key.after_s for key in varied])
    low = [key.pelvis[2] < LOW and key.lift_m == 0 for key in varied]
    down_s = start_s + float(passed_s[low.index(True)]) if True in low else float("nan")
    last = replace(varied[-1], after_s=stays_s, ease=0.0)
    return Episode(kind, start_s, (*varied, last, *gets_up), down_s)


def _varied(key: Key, rng: np.random.Generator) -> Key:
    """Return a key as another person would do it."""
    ahead, left, up = key.pelvis
    return replace(
        key,
        after_s=key.after_s * float(rng.uniform(0.9, 1.1)),
        pelvis=(ahead + float(rng.normal(0, 0.015)), left + float(rng.normal(0, 0.015)), up),
        pitch=key.pitch + float(rng.normal(0, 0.06)),
        roll=key.roll + float(rng.normal(0, 0.06)),
        arms=tuple(np.add(key.arms, rng.normal(0, 0.12, 4)).tolist()),
    )


def with_episodes(
    body: Body,
    posture: Posture,
    times_s: Floats,
    root_m: Floats,
    heading: Floats,
    episodes: tuple[Episode, ...],
) -> Posture:
    """Return a posture with episodes in place of what the body does meanwhile.

    Args:
        body: its lengths.
        posture: over `times_s`.
        times_s: `(num_times,)`.
        root_m: `(num_times, 2)` where the person stands.
        heading: `(num_times,)` radians.
        episodes: of this person.
    """
    for episode in episodes:
        inside = (times_s > episode.start_s) & (times_s < episode.stop_s + BLEND_S)
        if inside.any():
            made = _made(body, episode, times_s[inside], root_m[inside], heading[inside])
            begin = smoothstep(np.clip((times_s[inside] - episode.start_s) / BLEND_S, 0, 1))
            end = smoothstep(np.clip((episode.stop_s + BLEND_S - times_s[inside]) / BLEND_S, 0, 1))
            posture = _mixed(posture, made, inside, np.minimum(begin, end))
    return posture


def _mixed(posture: Posture, made: Posture, inside: Flags, share: Floats) -> Posture:
    def mix(before: Floats, within: Floats) -> Floats:
        weight = share.reshape(-1, *(1,) * (before.ndim - 1))
        mixed = before.copy()
        mixed[inside] = before[inside] * (1 - weight) + within * weight
        return np.asarray(mixed)

    return Posture(
        mix(posture.pelvis_m, made.pelvis_m), mix(posture.pelvis, made.pelvis),
        mix(posture.torso, made.torso), mix(posture.head, made.head),
        mix(posture.knees, made.knees), mix(posture.ankles_m, made.ankles_m),
        mix(posture.arms, made.arms),
    )  # fmt: skip


def _made(
    body: Body, episode: Episode, times_s: Floats, root_m: Floats, heading: Floats
) -> Posture:
    """Return the postures of an episode at some times."""
    keys = (replace(STAND, after_s=0.0), *episode.keys)
    ends = episode.start_s + np.cumsum([key.after_s for key in keys])
    upper = np.clip(np.searchsorted(ends, times_s), 1, len(keys) - 1)
    span = np.maximum(ends[upper] - ends[upper - 1], 1e-6)
    share = np.clip((times_s - ends[upper - 1]) / span, 0, 1)
    ease = np.array([key.ease for key in keys])[upper]
    share = np.where(ease > 0, share ** np.maximum(ease, 1e-3), smoothstep(share))

    def at(values: list[object]) -> Floats:
        table = np.array(values, dtype=np.float64)
        weight = share.reshape(-1, *(1,) * (table.ndim - 1))
        return np.asarray(table[upper - 1] * (1 - weight) + table[upper] * weight)

    tall = body.stature
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    left = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    lift_m = at([key.lift_m for key in keys])

    def placed(local: Floats) -> Floats:
        xy = root_m + tall * (local[:, :1] * ahead + local[:, 1:2] * left)
        return np.concatenate([xy, (tall * local[:, 2] + lift_m)[:, None]], axis=-1)

    right = [key.right or (key.feet[0], -key.feet[1], key.feet[2]) for key in keys]
    ankles_m = np.stack([placed(at([key.feet for key in keys])), placed(at(list(right)))], axis=1)
    yaw = heading + at([key.turn for key in keys])
    pitch, roll = at([key.pitch for key in keys]), at([key.roll for key in keys])
    trunk = np.stack([yaw, pitch, roll], axis=-1)
    arms = at([key.arms for key in keys])
    return Posture(
        pelvis_m=placed(at([key.pelvis for key in keys])),
        pelvis=trunk,
        torso=trunk,
        head=np.stack([yaw, 0.7 * pitch, 0.7 * roll], axis=-1),
        knees=yaw,
        ankles_m=ankles_m,
        arms=np.stack([arms, arms], axis=1),
    )
