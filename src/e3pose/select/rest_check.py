"""Do rests cost more error than they may? Compared with everybody awake, again and again.

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
from e3pose.select.rounds import (
    BACK,
    LEAST_ROUNDS,
    SETTLE_S,
    STRETCH_S,
    STRETCHES,
    Rounds,
    place_of,
    with_round,
)

MOST_RISE = 1.1  # definition: rests cost at most a tenth of the error
LEAST_S = 2.0  # numerics: of each of the two stretches, or the round says nothing
RESTING, AWAKE = 0, 1  # layout: of the pairs in `RestCheck`


@dataclass(frozen=True, slots=True, eq=False)
class RestCheck(Rounds):
    """What rests cost: the rounds are of the error with rests over that with everybody awake.

    Attributes:
        round: which one it is.
        seconds: `(2,)` compared in this round, resting and awake.
        stated: `(2,)` sum of the error stated in them, metres times seconds.
        idle: whether everybody stays awake, as rests cost too much.
    """

    round: int = 0
    seconds: Floats = field(default_factory=lambda: np.zeros(2))
    stated: Floats = field(default_factory=lambda: np.zeros(2))
    idle: bool = False

    def wakes(self, slot: int, interval_s: float) -> bool:
        """Return whether everybody is to be awake in a slot."""
        _, stretch, _ = place_of(slot, interval_s)
        return (stretch == STRETCHES - 1) != self.idle

    def left_s(self, slot: int, interval_s: float) -> float:
        """Return the seconds until everybody is to be awake; 0 where it is so now."""
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
        check = with_round(begun, math.log(mean_m[RESTING] / mean_m[AWAKE]))
        if check.rounds < LEAST_ROUNDS:
            return check
        above = check.mean - math.log(MOST_RISE)
        sure = BACK * check.error
        return replace(check, idle=above > -sure if check.idle else above > sure)

    def words(self) -> str:
        """Return what was found, for operators; empty before enough rounds."""
        if self.rounds < LEAST_ROUNDS:
            return ""
        found = f"stated error with rests against everybody awake: {self.change}"
        if not self.idle:
            return found
        return f"nobody rests, tried again every {STRETCH_S * STRETCHES:.0f} s; {found}"
