"""Episodes: what a person does besides walking, standing and sitting, by key postures.

Key postures are in shares of the stature, relative to where the person stands and faces. Between
two of them a body moves along `u ** ease` where it falls, and smoothly where it is in control.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.base.errors import InputError
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
    """An activity of one person from a time on.

    Attributes:
        kind: its name in `EPISODES`.
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
        keys: the postures.
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
    """Return a posture in which episodes replace the body's other activity.

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


# Kinds of episodes: falls, and what looks like one.
#
# Falls take the times of 25 falls of old people that cameras in care homes filmed (Choi, Wakeling
# and Robinovitch, *J. Biomech.* 48, 2015, 911-920): 1.27 s (0.65) from losing balance to the
# impact of the pelvis, of which 0.58 s (0.26) of descent, and 2.14 m/s (0.63) of the pelvis at
# impact.

DESCENT_S, DESCENT_SPREAD_S = 0.583, 0.255
STAGGER_S, STAGGER_SPREAD_S = 0.69, 0.4  # from losing balance to the start of the descent
BED_M, SOFA_M = 0.50, 0.42  # surfaces over the floor
REACH: Arms = (1.4, 0.2, 0.0, 0.4)
BACK: Arms = (-0.5, 0.5, 0.0, 0.3)
REST: Arms = (0.3, 0.5, 0.2, 0.7)
PROP: Arms = (1.5, 0.15, 0.0, 0.1)
DOWN: Arms = (1.2, 0.0, 0.2, 0.3)
OVER: Arms = (2.95, 0.5, 0.0, 0.2)

CHAIR = Key(1.2, (-0.22, 0.0, 0.31), pitch=0.1, arms=REST)
PRONE = Key(0.5, (0.46, 0.0, 0.075), (0.0, 0.06, 0.04), pitch=1.52, arms=OVER)
SUPINE = Key(0.5, (-0.36, 0.0, 0.06), (0.09, 0.07, 0.045), pitch=-1.5, arms=REST)
LEFT = Key(
    0.5, (0.0, 0.33, 0.115), (-0.06, -0.08, 0.04), (0.07, -0.09, 0.09), 0.1, -1.45, arms=DOWN
)
RIGHT = Key(0.5, (0.0, -0.33, 0.115), (0.07, 0.09, 0.09), (-0.06, 0.08, 0.04), 0.1, 1.45, arms=DOWN)
SEATED = (CHAIR, replace(CHAIR, after_s=2.5))
FLOOR = Key(0.5, (-0.12, 0.0, 0.065), (0.30, 0.08, 0.045), pitch=-0.1, arms=REST)
KNEEL = Key(1.0, (0.0, 0.0, 0.29), (-0.22, 0.06, 0.03), pitch=0.1)
FOURS = Key(0.9, (0.05, 0.0, 0.27), (-0.2, 0.06, 0.03), pitch=1.42, arms=PROP)
SQUAT = Key(0.9, (-0.08, 0.0, 0.2), (0.0, 0.08, 0.045), pitch=0.6, arms=DOWN)


def _fall(rng: np.random.Generator, end: Key, first: tuple[Key, ...] = (STAND,)) -> list[Key]:
    """Lose balance, fall to a posture and settle in it."""
    stagger_s = float(np.clip(rng.normal(STAGGER_S, STAGGER_SPREAD_S), 0.15, 2.0))
    descent_s = float(np.clip(rng.normal(DESCENT_S, DESCENT_SPREAD_S), 0.38, 1.2))
    last = first[-1]
    lean = 0.12 * np.sign(end.pitch) if abs(end.pitch) > 1 else 0.05
    swaying = replace(
        last,
        after_s=stagger_s,
        pitch=last.pitch + lean,
        roll=0.1 * end.roll,
        pelvis=(
            last.pelvis[0] + 0.06 * np.sign(end.pelvis[0]),
            0.15 * end.pelvis[1],
            last.pelvis[2] - 0.01,
        ),
        arms=REACH if end.pitch >= 0 else BACK,
    )
    impact = replace(
        end, after_s=descent_s, pitch=0.8 * end.pitch, roll=0.85 * end.roll, ease=FALL_EASE
    )
    return [*first, swaying, impact, replace(end, after_s=0.35)]


def _slide(rng: np.random.Generator) -> list[Key]:
    """Slide down a wall and sink to one side."""
    leaning = replace(STAND, after_s=0.8, pelvis=(-0.05, 0.0, 0.51), pitch=-0.1)
    down = replace(FLOOR, after_s=float(rng.uniform(1.8, 4.0)))
    slumped = replace(
        down, after_s=1.5, roll=float(rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.3))
    )
    return [leaning, down, slumped]


def _bed(rng: np.random.Generator, lift_m: float = BED_M) -> list[Key]:
    """Sit down on a bed and lie along it."""
    lying = Key(
        1.6, (-0.34, 0.12, 0.06), (-0.32, 0.56, 0.05), (-0.32, 0.55, 0.05), -1.5, 0.0,
        float(np.pi / 2), REST, 0.0, lift_m,
    )  # fmt: skip
    raised = replace(
        lying, after_s=float(rng.uniform(0.8, 1.4)), pitch=-0.6, pelvis=(-0.3, 0.05, 0.08)
    )
    return [CHAIR, raised, lying]


def _from_bed(rng: np.random.Generator) -> list[Key]:
    """Roll off the bed onto the floor before it."""
    lying = _bed(rng)
    edge = replace(lying[-1], after_s=3.0, pelvis=(-0.12, 0.1, 0.09))
    end = replace(
        lying[-1], after_s=float(np.clip(rng.normal(0.55, 0.1), 0.35, 0.9)),
        lift_m=0.0, ease=FALL_EASE,
        pelvis=(0.1, 0.1, 0.08), feet=(0.05, 0.5, 0.05), right=(0.15, 0.48, 0.05), pitch=-1.4,
    )  # fmt: skip
    return [*lying, edge, end, replace(end, after_s=0.4, ease=0.0)]


def _play(rng: np.random.Generator) -> list[Key]:
    """Drop to the floor, roll and jump up again, as children do."""
    keys: list[Key] = []
    for end in rng.permutation(3)[:2]:
        down = (PRONE, FLOOR, LEFT)[int(end)]
        keys += [
            replace(down, after_s=float(rng.uniform(0.5, 0.9)), ease=1.3),
            replace(down, after_s=float(rng.uniform(0.3, 1.6))),
            replace(SQUAT, after_s=0.5),
            replace(STAND, after_s=0.5),
        ]
    return keys


def _crawl(rng: np.random.Generator) -> list[Key]:
    steps = [
        replace(
            FOURS,
            after_s=0.6,
            pelvis=(0.05 + 0.16 * i, 0.0, 0.27),
            feet=(-0.2 + 0.16 * i, 0.06, 0.03),
        )
        for i in range(int(rng.integers(4, 9)))
    ]
    return [KNEEL, *steps, replace(KNEEL, pelvis=steps[-1].pelvis, feet=steps[-1].feet)]


def _jump(rng: np.random.Generator) -> list[Key]:
    low = replace(STAND, after_s=0.3, pelvis=(-0.03, 0.0, 0.44), pitch=0.3)
    high = replace(STAND, after_s=0.28, pelvis=(0.0, 0.0, 0.66), feet=(0.0, 0.06, 0.16), arms=OVER)
    return [low, high, replace(low, after_s=0.28, ease=1.6), STAND] * int(rng.integers(1, 4))


def _lie_down(rng: np.random.Generator) -> list[Key]:
    end = (SUPINE, PRONE, LEFT)[int(rng.integers(3))]
    sitting = replace(FLOOR, after_s=1.2)
    return [KNEEL, sitting, replace(end, after_s=float(rng.uniform(1.2, 2.2)))]


def _kneel(rng: np.random.Generator) -> list[Key]:
    return [
        KNEEL,
        replace(KNEEL, after_s=float(rng.uniform(2, 6)), pitch=float(rng.uniform(0.1, 1.0))),
    ]


def _tie(rng: np.random.Generator) -> list[Key]:
    tie = Key(0.9, (-0.02, 0.0, 0.3), (0.15, 0.06, 0.045), (-0.22, -0.06, 0.03), 0.85, arms=DOWN)
    return [tie, replace(tie, after_s=float(rng.uniform(2, 5)), pitch=1.0)]


def _bend(rng: np.random.Generator) -> list[Key]:
    bent = Key(0.9, (-0.09, 0.0, 0.51), pitch=float(rng.uniform(1.1, 1.6)), arms=PROP)
    return [bent, replace(bent, after_s=float(rng.uniform(0.5, 3)))]


def _sit_hard(rng: np.random.Generator) -> list[Key]:
    return [
        replace(CHAIR, after_s=float(rng.uniform(0.35, 0.5)), ease=1.5),
        replace(CHAIR, after_s=3.0),
    ]


# Episodes by name; each makes keys from random numbers.
FALLS: dict[str, Callable[[np.random.Generator], list[Key]]] = {
    "fall-forward": lambda rng: _fall(rng, PRONE),
    "fall-backward": lambda rng: _fall(rng, SUPINE),
    "fall-left": lambda rng: _fall(rng, LEFT),
    "fall-right": lambda rng: _fall(rng, RIGHT),
    "fall-from-chair": lambda rng: _fall(rng, (PRONE, LEFT)[int(rng.integers(2))], SEATED),
    "fall-from-bed": _from_bed,
    "slide-down": _slide,
}  # fmt: skip
CONTROLS: dict[str, Callable[[np.random.Generator], list[Key]]] = {
    "lie-on-floor": _lie_down,
    "lie-on-bed": _bed,
    "lie-on-sofa": lambda rng: _bed(rng, SOFA_M),
    "sit-on-floor": lambda rng: [KNEEL, FLOOR, replace(FLOOR, after_s=4.0)],
    "sit-hard": _sit_hard,
    "kneel": _kneel,
    "crawl": _crawl,
    "tie-shoes": _tie,
    "pick-up": _bend,
    "squat": lambda rng: [SQUAT, replace(SQUAT, after_s=float(rng.uniform(1, 4)))],
    "jump": _jump,
    "play": _play,
}
EPISODES = {**FALLS, **CONTROLS}
ON_BED = frozenset({"lie-on-bed", "lie-on-sofa", "fall-from-bed"})


def plan_episode(
    kind: str, start_s: float, rng: np.random.Generator, stays_s: float = 0.0
) -> Episode:
    """Plan an episode.

    Args:
        kind: a name in `EPISODES`.
        start_s: when it begins.
        rng: how people differ.
        stays_s: how long they stay in the last posture.

    Raises:
        InputError: for an unknown kind.
    """
    if kind not in EPISODES:
        raise InputError("simulate: episode", repr(kind[:40]), f"one of {', '.join(EPISODES)}")
    keys = EPISODES[kind](rng)
    return planned(kind, keys, start_s, rng, stays_s, _up(keys[-1], rng))


def _up(last: Key, rng: np.random.Generator) -> tuple[Key, ...]:
    """Get up: from the floor over hands and knees, from a bed over its edge."""
    if last.pelvis[2] >= 0.5:
        return ()
    if last.lift_m or last.pelvis[2] >= LOW:
        return replace(CHAIR, after_s=1.8), replace(STAND, after_s=1.4)
    slow = float(rng.uniform(0.8, 1.6))
    return tuple(
        replace(key, after_s=slow * after_s)
        for key, after_s in ((FOURS, 1.6), (KNEEL, 1.0), (STAND, 1.4))
    )
