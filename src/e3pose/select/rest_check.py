"""Measure the cost of rests in error, against repeated periods with all cameras awake.

In the last stretch of a round everybody is awake, and the error that the estimator states is
compared with that of the stretch before. Where rests raise it by more than a tenth, nobody rests,
but in that last stretch, until they do not. What the estimator does not know it cannot state: a
plan of rests counts what views repeat by itself (`rest_plan.risen`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from e3pose.base.arrays import Floats

# What it costs and how soon it says something; no site has run long enough to try other values.
# tuned: s | by reasoning, tried on no recording | not measured
STRETCH_S = 8.0
# tuned: stretches | by reasoning, tried on no recording | not measured
STRETCHES = 16  # in a round: a sixteenth of the time everybody is awake
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
MOST_RISE = 1.1  # definition: rests cost at most a tenth of the error
LEAST_S = 2.0  # numerics: of each of the two stretches, or the round says nothing
RESTING, AWAKE = 0, 1  # layout: of the pairs in `RestCheck`


@dataclass(frozen=True, slots=True, eq=False)
class RestCheck:
    """Measured cost of rests: the stated error with rests over that with all cameras awake.

    Attributes:
        rounds: that were compared, forgotten in time.
        mean: logarithm of the ratio, mean of the rounds.
        variance: of one round.
        round: which one it is.
        seconds: `(2,)` compared in this round, resting and awake.
        stated: `(2,)` sum of the error stated in them, metres times seconds.
        idle: whether everybody stays awake, as rests cost too much.
    """

    rounds: float = 0.0
    mean: float = 0.0
    variance: float = 0.0
    round: int = 0
    seconds: Floats = field(default_factory=lambda: np.zeros(2))
    stated: Floats = field(default_factory=lambda: np.zeros(2))
    idle: bool = False

    @property
    def error(self) -> float:
        """Standard error of `mean`."""
        return math.sqrt(max(self.variance, LEAST_SPREAD**2) / max(self.rounds, 1.0))

    def wakes(self, slot: int, interval_s: float) -> bool:
        """Return whether all cameras must be awake in a slot."""
        _, stretch, _ = place_of(slot, interval_s)
        return (stretch == STRETCHES - 1) != self.idle

    def left_s(self, slot: int, interval_s: float) -> float:
        """Return the seconds until all cameras must be awake; 0 if they must be now."""
        _, stretch, into_s = place_of(slot, interval_s)
        if self.wakes(slot, interval_s):
            return 0.0
        stretches = 1 if self.idle else STRETCHES - 1 - stretch
        return stretches * STRETCH_S - into_s

    def after(self, slot: int, interval_s: float, asleep: bool, error_m: float) -> RestCheck:
        """Return the check after a slot.

        Args:
            slot: which one.
            interval_s: seconds per slot.
            asleep: whether somebody slept in it.
            error_m: the mean error stated after it; NaN where nobody is known.
        """
        now, stretch, into_s = place_of(slot, interval_s)
        check = self if now == self.round else replace(self._judged(), round=now)
        is_awake = check.wakes(slot, interval_s)
        compared = stretch >= STRETCHES - 2 and into_s >= SETTLE_S and asleep != is_awake
        if not compared or math.isnan(error_m):
            return check
        passed_s = interval_s * np.eye(2)[AWAKE if is_awake else RESTING]
        return replace(
            check, seconds=check.seconds + passed_s, stated=check.stated + passed_s * error_m
        )

    def _judged(self) -> RestCheck:
        """Return the check at the end of a round, with nothing in the next one."""
        begun = replace(self, seconds=np.zeros(2), stated=np.zeros(2))
        if self.seconds.min() < LEAST_S or self.stated.min() <= 0:
            return begun
        mean_m = self.stated / self.seconds
        off = math.log(mean_m[RESTING] / mean_m[AWAKE]) - self.mean
        rounds = min(self.rounds + 1, MEMORY)
        check = replace(
            begun,
            rounds=rounds,
            mean=self.mean + off / rounds,
            variance=(1 - 1 / rounds) * (self.variance + off**2 / rounds),
        )
        if check.rounds < LEAST_ROUNDS:
            return check
        above = check.mean - math.log(MOST_RISE)
        sure = BACK * check.error
        return replace(check, idle=above > -sure if check.idle else above > sure)

    def operator_note(self) -> str:
        """Return the measured cost for operators; empty before enough rounds."""
        if self.rounds < LEAST_ROUNDS:
            return ""
        change = f"{math.expm1(self.mean):+.0%} ± {self.error:.0%}"
        found = f"stated error with rests against everybody awake: {change}"
        if not self.idle:
            return found
        return f"no camera rests, tried again every {STRETCH_S * STRETCHES:.0f} s; {found}"


def place_of(slot: int, interval_s: float) -> tuple[int, int, float]:
    """Return the round of a slot, the stretch in it, and the seconds since that began."""
    stretch, into_s = divmod(slot * interval_s, STRETCH_S)
    return int(stretch) // STRETCHES, int(stretch) % STRETCHES, into_s
