"""Policy: the cameras with the most expected information, under energy budgets.

    maximise  V * (information(S) + entrants(S) + sum_{c in S} watch_c) - sum_{c in S} price_c

`information` grows with diminishing returns, prices and watches add up: where nobody comes in, a
greedy choice of a given number of cameras, whose objective is shifted to be zero for no camera and
to grow with every one, reaches 1 - 1/e of the best (Nemhauser, Wolsey and Fisher, 1978). Where
there are few subsets all are tried. A set is preferred to the one whose turn it is only where it is
better by more than a margin. Method: `docs/explanation/camera-selection.md`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from math import comb

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.select.expected_information import Foresight
from e3pose.select.policies.base import Selection, Situation, count_at
from e3pose.select.policies.fixed import RoundRobin

MOST_SUBSETS = 60  # capacity: that are all tried: any count of up to seven cameras, and 2 of 11
# tuned: nats/s | simulated, five scenes, seeds 101 and 102 | 0.1 finds people late, 1 costs 5 % of
#   error
WATCH_NATS_PER_S = 0.5  # what a camera that has not looked for a second may show that is new
# tuned: s | not recorded | not measured
WATCH_LIMIT_S = 5.0
# tuned: nats | simulated, five scenes, seeds 701 to 708, lead 4, one camera | recall gains 1.5,
#   2.1, 2.0 points at 0.5, 1, 2
ENTRANT_NATS = 1.0  # of a person started
# tuned: people | lab/experiments/2026-11-23-detections-that-never-become-a-person.md | by the
#   truth twice as many are missed in `two-rooms` without it
UNMET_PEOPLE = 0.5  # with a target, two cameras look while so many wait to be started
MAX_PAUSE_S = 0.2  # timeout: with a target, some camera looks at least this often, whoever is known
# tuned: s | not recorded | not measured
BURST_S = 2.0  # with a target or by turns, how far ahead of its budget a camera may run
# tuned: nats s | pizza and eight scenes, seeds 701 to 704, docs/research/camera-selection.md | 0:
#   pizza at 12.5 per second +0.4 +- 0.2 %, held out, `round-table` +0.9 +- 0.4
LEAST_NATS_S = 0.008  # more than the cameras whose turn it is, as long as a slot lasts
# tuned: nats | not recorded | not measured
NEAR_NATS = 0.02  # sets of cameras that differ by less are equally good, and take turns
# tuned: share | not recorded | not measured
NO_BETTER = 0.05  # a target that all cameras miss: go on while they lower the error by this share


@dataclass(frozen=True, slots=True)
class Information:
    """Select the cameras with most expected information: a fixed number, or as few as suffice.

    Attributes:
        num_selected: cameras per slot; a mean if it is no whole number.
        quality_weight: the paper's V; larger prefers information to even batteries.
        target_error_m: wake the fewest cameras whose expected error, corrected by what was stated
            lately, meets this as a mean over the slots, in place of `num_selected`.
        phase: which camera wins a tie, and is first in turn.
        order: of the turns; rig order if empty.
    """

    num_selected: float
    quality_weight: float = 1.0
    target_error_m: float | None = None
    phase: int = 0
    order: tuple[int, ...] = ()

    def select(self, situation: Situation) -> Selection:
        """See `Policy.select`."""
        foresight = situation.foresight
        if foresight is None:
            raise ValueError("the policy needs a foresight")
        if self.target_error_m is not None:
            aim = situation.stated.aim_m(self.target_error_m)
            return self._fewest(situation, foresight, aim)
        count = count_at(situation.slot, self.num_selected)
        best = self._best(situation, foresight, situation.online, count)
        turn = self._turn(situation)
        worth = self.quality_weight * watch_nats(situation) - situation.price
        both = np.stack([best, turn])
        value = self.quality_weight * worth_nats(foresight, both) + both @ worth
        least = self.quality_weight * LEAST_NATS_S / situation.interval_s
        better = value[0] - value[1] > least
        return best if better else turn

    def _turn(self, situation: Situation) -> Selection:
        """Return the cameras of this turn; cameras far ahead of their budgets come last."""
        allowed = situation.online & affordable(situation)
        if allowed.sum() < min(self.num_selected, situation.online.sum()):
            allowed = situation.online
        turns = RoundRobin(self.num_selected, self.phase, self.order)
        return turns.select(replace(situation, online=allowed))

    def _best(
        self, situation: Situation, foresight: Foresight, allowed: Flags, count: int
    ) -> Selection:
        """Return the best `count` of the cameras `allowed`, or all if they are fewer."""
        candidates = _in_turn(tuple(allowed.tolist()), self.phase % len(allowed))
        count = min(count, len(candidates))
        worth = self.quality_weight * watch_nats(situation) - situation.price
        if comb(len(candidates), count) <= MOST_SUBSETS:
            selections = _selections(len(allowed), candidates, count)
            value = self.quality_weight * worth_nats(foresight, selections) + selections @ worth
            return np.array(selections[int(np.argmax(self._rounded(value)))])
        selection = np.zeros(len(allowed), dtype=bool)
        for _ in range(count):
            free = np.array([camera for camera in candidates if not selection[camera]])
            tried = np.repeat(selection[None], len(free), axis=0)
            tried[np.arange(len(free)), free] = True
            value = self.quality_weight * worth_nats(foresight, tried) + worth[free]
            selection[free[int(np.argmax(self._rounded(value)))]] = True
        return selection

    def _rounded(self, value: Floats) -> Floats:
        """Return rounded values, so that the phase decides between nearly equal ones."""
        step = max(NEAR_NATS * self.quality_weight, 1e-9)
        return np.asarray(np.round(value / step))

    def _fewest(self, situation: Situation, foresight: Foresight, target_m: float) -> Selection:
        """Return the fewest cameras that are expected to meet the target, or that still help.

        Errors with whole numbers of cameras lie on both sides of the target; slots take turns
        between the two numbers, so that the mean over the slots meets it.
        """
        allowed = situation.online & affordable(situation)
        everyone = self._best(situation, foresight, allowed, int(allowed.sum()))
        all_error_m = foresight.expected_error_m(everyone[None])[0]
        enough_m = max(target_m, all_error_m * (1 + NO_BETTER))
        stale = situation.unseen_slots[allowed].min(initial=10**9) * situation.interval_s
        least = 1 if stale >= MAX_PAUSE_S or not foresight.people.confirmed.all() else 0
        least = max(least, 2 if foresight.entrants.weights.sum() > UNMET_PEOPLE else 0)
        fewer, error_of_fewer_m = everyone, np.nan
        for count in range(least, int(allowed.sum())):
            selection = self._best(situation, foresight, allowed, count)
            error_m = foresight.expected_error_m(selection[None])[0]
            if np.isnan(error_m) or error_m <= enough_m:
                share = (error_of_fewer_m - enough_m) / (error_of_fewer_m - error_m)
                if count > least and count_at(situation.slot, count - 1 + share) < count:
                    return fewer
                return selection
            fewer, error_of_fewer_m = selection, error_m
        return everyone


def affordable(situation: Situation) -> Flags:
    """Return `(num_cameras,)` who is not far ahead of its budget."""
    return np.asarray(situation.deficit <= max(1.0, BURST_S / situation.interval_s))


def worth_nats(foresight: Foresight, subsets: Flags) -> Floats:
    """Return `(num_subsets,)` value of sets: information, and tracks started."""
    starts = ENTRANT_NATS * foresight.entrants.starts(subsets)
    return np.asarray(foresight.information(subsets) + starts)


def watch_nats(situation: Situation) -> Floats:
    """Return `(num_cameras,)` value of each camera for people not seen yet."""
    unseen_s = np.minimum(situation.unseen_slots * situation.interval_s, WATCH_LIMIT_S)
    return np.asarray(WATCH_NATS_PER_S * unseen_s)


@lru_cache(maxsize=256)
def _in_turn(allowed: tuple[bool, ...], first: int) -> tuple[int, ...]:
    """Return the cameras allowed in the order in which they win ties, from the `first` on."""
    cameras = [camera for camera, free in enumerate(allowed) if free]
    return (*(c for c in cameras if c >= first), *(c for c in cameras if c < first))


@lru_cache(maxsize=256)
def _selections(num_cameras: int, candidates: tuple[int, ...], count: int) -> Flags:
    """Return all sets of `count` of the candidates, `(num_sets, num_cameras)`."""
    chosen = list(combinations(candidates, count))
    selections = np.zeros((len(chosen), num_cameras), dtype=bool)
    for row, each in enumerate(chosen):
        selections[row, list(each)] = True
    return selections
