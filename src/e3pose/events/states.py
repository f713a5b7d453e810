"""States of a person: what the body does, with a probability.

A hidden Markov model over prototypes. A prototype is a mean and a spread of each figure of
`events.body`; a figure that is not known says nothing, one that is known badly says little. What
fits no prototype, or too few figures, is `unknown`. Prototypes are human proportions (Winter,
*Biomechanics and Motor Control of Human Movement*) in the postures that the names say.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.events.body import FIGURES, SPEED

STATES = (
    "unknown", "standing", "walking", "sitting", "bending", "crouching", "crawling", "lying",
)  # fmt: skip
UNKNOWN, STANDING, WALKING, SITTING, BENDING, CROUCHING, CRAWLING, LYING = range(len(STATES))


class Prototype(NamedTuple):
    """A posture: `mean` and `spread` of the seven figures, NaN where any value will do."""

    state: int
    mean: tuple[float, ...]
    spread: tuple[float, ...]
    low: bool = False  # the trunk rests on the floor, or on what the person is on


#  hips, shoulders, head: shares of the stature; trunk, thighs, shanks: degrees; speed: m/s
PROTOTYPES = (
    Prototype(STANDING, (0.52, 0.82, 0.93, 6, 8, 6, 0.0), (0.04, 0.06, 0.06, 12, 12, 10, 0.25)),
    Prototype(WALKING, (0.52, 0.81, 0.92, 8, 14, 18, 1.0), (0.04, 0.06, 0.06, 12, 12, 15, 0.4)),
    Prototype(SITTING, (0.31, 0.60, 0.71, 12, 78, 14, 0.0), (0.05, 0.07, 0.08, 15, 18, 20, 0.25)),
    Prototype(
        SITTING, (0.07, 0.36, 0.46, 20, 90, 75, 0.0), (0.04, 0.06, 0.08, 16, 25, 30, 0.25), True
    ),
    Prototype(  # slumped against something, half lying
        LYING, (0.07, 0.24, 0.29, 55, 90, 75, 0.0), (0.04, 0.07, 0.09, 14, 25, 30, 0.25), True
    ),
    Prototype(BENDING, (0.51, 0.60, 0.58, 75, 14, 10, 0.0), (0.04, 0.12, 0.18, 25, 14, 12, 0.4)),
    Prototype(CROUCHING, (0.20, 0.45, 0.54, 38, 85, 40, 0.0), (0.06, 0.07, 0.08, 18, 25, 22, 0.3)),
    Prototype(CROUCHING, (0.29, 0.55, 0.66, 20, 20, 85, 0.0), (0.03, 0.08, 0.09, 22, 22, 20, 0.3)),
    Prototype(CROUCHING, (0.30, 0.50, 0.57, 48, 45, 45, 0.0), (0.03, 0.08, 0.09, 18, 25, 25, 0.3)),
    Prototype(CRAWLING, (0.27, 0.31, 0.34, 82, 18, 85, 0.3), (0.04, 0.06, 0.08, 14, 18, 15, 0.4)),
    Prototype(
        LYING, (0.07, 0.09, 0.11, 88, 88, 88, 0.0), (0.04, 0.05, 0.07, 16, 25, 30, 0.25), True
    ),
)  # fmt: skip
LOW = np.array([p.low for p in PROTOTYPES] + [False])
_STATE = np.array([p.state for p in PROTOTYPES] + [UNKNOWN])
_MEAN = np.array([p.mean for p in PROTOTYPES], dtype=np.float64)
_VARIANCE = np.array([p.spread for p in PROTOTYPES], dtype=np.float64) ** 2
_OF_STATE = np.eye(len(STATES))[_STATE]
# What a figure may be at all: the density of `unknown`.
_ALL_LOG = -np.log([1.1, 1.1, 1.1, 120, 120, 120, 2.0])
# How far the postures of two states are apart by each figure; those of one state not at all.
_APART = (_MEAN[:, None] - _MEAN) ** 2 / (_VARIANCE[:, None] + _VARIANCE)
_OTHERS = _STATE[:-1, None] != _STATE[:-1]
_DOUBT = np.exp(-0.5 * np.nansum(_APART, axis=2))  # that is left where all figures are known
STAYS_S = 1.0  # a state lasts about so long, by reasoning
LASTS_S = 0.4  # errors of a pose last so long: slots within it are one look
LEAST_FIGURES = 3  # with fewer a pose says nothing about the state
NEVER = 1e-9

NOT_KNOWN = np.full(len(PROTOTYPES) + 1, 0.5 / len(PROTOTYPES))
NOT_KNOWN[-1] = 0.5


def advance(share: Floats, value: Floats, spread: Floats, passed_s: Floats) -> Floats:
    """Return the probabilities of the prototypes after a slot.

    Args:
        share: `(num_persons, num_prototypes + 1)` before it; the last is `unknown`.
        value: `(num_persons, 7)` figures, NaN where unknown.
        spread: `(num_persons, 7)` their standard deviations.
        passed_s: `(num_persons,)` since the slot before.
    """
    stays = np.exp(-passed_s / STAYS_S)[:, None]
    share = stays * share + (1 - stays) * NOT_KNOWN
    known = np.isfinite(value) & np.isfinite(spread)
    value, spread = np.where(known, value, 0.0), np.where(known, spread, 0.0)
    variance = _VARIANCE + spread[:, None] ** 2
    off = (value[:, None] - _MEAN) ** 2 / variance + np.log(2 * np.pi * variance)
    fits = -0.5 * (off * known[:, None]).sum(axis=2)
    logs = np.concatenate([fits, (known * _ALL_LOG).sum(axis=1)[:, None]], axis=1)
    # Errors of a pose last: slots in a row count as many looks only in part.
    weight = np.minimum(passed_s / LASTS_S, 1.0) * (known.sum(axis=1) >= LEAST_FIGURES)
    told = share * np.exp(weight[:, None] * (logs - logs.max(axis=1, keepdims=True)))
    told = np.maximum(told, NEVER)
    return np.asarray(told / told.sum(axis=1, keepdims=True))


def states_of(share: Floats, value: Floats) -> Floats:
    """Return the probabilities of the states.

    A figure that is not known may be the one that would tell a posture from that of another state:
    then it is not known which it is. Of the speed alone, which nobody has at first, that is not so.

    Args:
        share: `(num_persons, num_prototypes + 1)`.
        value: `(num_persons, 7)` figures, NaN where unknown.

    Returns:
        `(num_persons, num_states)`.
    """
    known = np.isfinite(value) | (np.arange(len(FIGURES)) == SPEED)
    part = ~known.all(axis=1)
    if part.any():
        apart = np.where(known[part, None, None], _APART, 0.0).sum(axis=3)
        doubt = ((np.exp(-0.5 * apart) - _DOUBT) * _OTHERS).max(axis=2)
        share = share.copy()
        share[part, :-1] *= 1 - doubt
        share[part, -1] = 1 - share[part, :-1].sum(axis=1)
    return np.asarray(share @ _OF_STATE)


def low_of(share: Floats) -> Floats:
    """Return `(num_persons,)`: probability that the trunk rests on the floor or on a bed."""
    return np.asarray(share[:, LOW].sum(axis=1))
