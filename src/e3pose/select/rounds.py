"""Rounds in which two ways to run the cameras are compared, one after the other."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeVar

# What it costs and how soon it says something; no site has run long enough to try other values.
# tuned: s | by reasoning, tried on no recording | not measured
STRETCH_S = 8.0
# tuned: stretches | by reasoning, tried on no recording | not measured
STRETCHES = 16  # in a round: a sixteenth of the time is spent the other way
# tuned: s | by reasoning, tried on no recording | not measured
SETTLE_S = 2.0  # of a stretch, in which its people are still those of the one before
# tuned: rounds | by reasoning, tried on no recording: about an hour | not measured
MEMORY = 32.0  # rounds
# tuned: rounds | by reasoning, tried on no recording | not measured
LEAST_ROUNDS = 4
# tuned: of a logarithm | by reasoning, tried on no recording | not measured
LEAST_SPREAD = 0.05  # of one round, in logarithms of an error
# tuned: standard errors | by reasoning, tried on no recording | not measured
BACK = 1.0  # ahead of the other way, to return to the usual one

Kind = TypeVar("Kind", bound="Rounds")


@dataclass(frozen=True, slots=True, eq=False)
class Rounds:
    """The ratio of two errors in the rounds so far.

    Attributes:
        rounds: that were compared, forgotten in time.
        mean: logarithm of the ratio, mean of the rounds.
        variance: of one round.
    """

    rounds: float = 0.0
    mean: float = 0.0
    variance: float = 0.0

    @property
    def error(self) -> float:
        """Standard error of `mean`."""
        return math.sqrt(max(self.variance, LEAST_SPREAD**2) / max(self.rounds, 1.0))

    @property
    def change(self) -> str:
        """What one error is more than the other, for operators."""
        return f"{by(self.mean)} ± {self.error:.0%}"


def with_round(so_far: Kind, found: float) -> Kind:
    """Return the rounds with one more.

    Args:
        so_far: the rounds before.
        found: logarithm of the ratio in the newest.
    """
    rounds = min(so_far.rounds + 1, MEMORY)
    off = found - so_far.mean
    return replace(
        so_far,
        rounds=rounds,
        mean=so_far.mean + off / rounds,
        variance=(1 - 1 / rounds) * (so_far.variance + off**2 / rounds),
    )


def place_of(slot: int, interval_s: float) -> tuple[int, int, float]:
    """Return the round of a slot, the stretch in it, and the seconds since that began."""
    stretch, into_s = divmod(slot * interval_s, STRETCH_S)
    return int(stretch) // STRETCHES, int(stretch) % STRETCHES, into_s


def by(logarithm: float) -> str:
    """Return the logarithm of a ratio as people read it."""
    return f"{math.expm1(logarithm):+.0%}"
