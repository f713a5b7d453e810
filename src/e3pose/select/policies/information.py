"""Policy: the cameras with the most expected information, under energy budgets.

    maximise  V * (information(S) + entrants(S) + sum_{c in S} watch_c) - sum_{c in S} price_c

`information` grows with diminishing returns, prices and watches add up: where nobody comes in, a
greedy choice of a given number of cameras, whose objective is shifted to be zero for no camera and
to grow with every one, reaches 1 - 1/e of the best (Nemhauser, Wolsey and Fisher, 1978). Where
there are few subsets all are tried. A set is preferred to the one whose turn it is only where it is
better by more than a margin. Method: `docs/explanation/camera-selection.md`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from math import comb

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.base.kernel import kernel
from e3pose.base.records import changed
from e3pose.select.expected_information import Entrants, Foresight, started
from e3pose.select.kernels.foresight import information
from e3pose.select.policies.base import Selection, Situation, count_at
from e3pose.select.policies.fixed import RoundRobin

MOST_SUBSETS = 60  # capacity: that are all tried: any count of up to seven cameras, and 2 of 11
# tuned: nats/s | simulated, five scenes, seeds 101 and 102 | 0.1 finds people late, 1 costs 5 % of
#   error
WATCH_NATS_PER_S = 0.5  # what a camera that has not looked for a second may show that is new
# tuned: s | not recorded | by the truth half: 1 to 4 % less error in two scenes with walls; twice,
#   and on pizza, motion and with targets: the same
WATCH_LIMIT_S = 5.0
# tuned: nats | simulated, five scenes, seeds 701 to 708, lead 4, one camera | recall gains 1.5,
#   2.1, 2.0 points at 0.5, 1, 2
ENTRANT_NATS = 1.0  # of a person started
# tuned: people | lab/experiments/2026-11-23-detections-that-never-become-a-person.md | by the
#   truth twice as many are missed in `two-rooms` without it
UNMET_PEOPLE = 0.5  # with a target, two cameras look while so many wait to be started
MAX_PAUSE_S = 0.2  # timeout: with a target, some camera looks at least this often, whoever is known
# tuned: s | not recorded | by the truth of three scenes, 30 mm on budgets of 0.1 and 0.2, half: as
#   much as 50 % more error with a fifth fewer cameras; twice: as much as 47 % less with 39 % more
BURST_S = 2.0  # with a target or by turns, how far ahead of its budget a camera may run
# tuned: nats s | pizza and eight scenes, seeds 701 to 704, docs/research/camera-selection.md | 0:
#   pizza at 12.5 per second +0.4 +- 0.2 %, held out, `round-table` +0.9 +- 0.4
LEAST_NATS_S = 0.008  # more than the cameras whose turn it is, as long as a slot lasts
# tuned: nats | not recorded | by held-out cameras and the truth half, twice and next to none: 3 %
#   more to 5 % less error, as with other phases
NEAR_NATS = 0.02  # sets of cameras that differ by less are equally good, and take turns
# tuned: share | not recorded | by the truth half: 4 to 5 % more cameras, no nearer; twice: 5 to 9 %
#   fewer, as much as 4 % more error
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
        worth = self.quality_weight * watch_nats(situation) - situation.price
        best = self._best(foresight, situation.online, count, worth)
        turn = self._turn(situation)
        both = np.array([best, turn])
        nats = foresight.information(both) + ENTRANT_NATS * foresight.entrants.starts(both)
        value = self.quality_weight * nats + both @ worth
        least = self.quality_weight * LEAST_NATS_S / situation.interval_s
        better = value[0] - value[1] > least
        return best if better else turn

    def _turn(self, situation: Situation) -> Selection:
        """Return the cameras of this turn; cameras far ahead of their budgets come last."""
        allowed = situation.online & affordable(situation)
        enough = min(self.num_selected, int(np.count_nonzero(situation.online)))
        if np.count_nonzero(allowed) < enough:
            allowed = situation.online
        turns = RoundRobin(self.num_selected, self.phase, self.order)
        return turns.select(changed(situation, online=allowed))

    def _best(self, foresight: Foresight, allowed: Flags, count: int, worth: Floats) -> Selection:
        """Return the best `count` of the cameras `allowed`, or all if they are fewer.

        `worth` is what each camera is worth besides its information.
        """
        candidates = _in_turn(tuple(allowed.tolist()), self.phase % len(allowed))
        count = min(count, len(candidates))
        few = comb(len(candidates), count) <= MOST_SUBSETS
        chosen = np.zeros(len(allowed), dtype=bool)
        choose(
            foresight.prior,
            foresight.views,
            foresight.new,
            foresight.weights,
            foresight.entrants,
            worth,
            float(self.quality_weight),
            _selections(len(allowed), candidates, count if few else 1),
            1 if few else count,
            chosen,
        )
        return chosen

    def _fewest(self, situation: Situation, foresight: Foresight, target_m: float) -> Selection:
        """Return the fewest cameras that are expected to meet the target, or that still help.

        Errors with whole numbers of cameras lie on both sides of the target; slots take turns
        between the two numbers, so that the mean over the slots meets it.
        """
        allowed = situation.online & affordable(situation)
        worth = self.quality_weight * watch_nats(situation) - situation.price
        everyone = self._best(foresight, allowed, int(allowed.sum()), worth)
        all_error_m = foresight.expected_error_m(everyone[None])[0]
        enough_m = max(target_m, all_error_m * (1 + NO_BETTER))
        stale = situation.unseen_slots[allowed].min(initial=10**9) * situation.interval_s
        least = 1 if stale >= MAX_PAUSE_S or not foresight.people.confirmed.all() else 0
        least = max(least, 2 if foresight.entrants.weights.sum() > UNMET_PEOPLE else 0)
        fewer, error_of_fewer_m = everyone, np.nan
        for count in range(least, int(allowed.sum())):
            selection = self._best(foresight, allowed, count, worth)
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


@kernel
def choose(
    prior: Floats,
    views: Floats,
    new: Floats,
    weights: Floats,
    entrants: Entrants,
    worth: Floats,
    quality_weight: float,
    subsets: Flags,
    rounds: int,
    chosen: Flags,
) -> None:
    """Add the best of some sets to `chosen`, in each round one.

    Values are rounded, so that the first of nearly equal sets is taken.

    Args:
        prior: of `Foresight`, like all up to `entrants`.
        views: see `prior`.
        new: see `prior`.
        weights: see `prior`.
        entrants: see `prior`.
        worth: `(num_cameras,)` of each camera besides its information.
        quality_weight: of `Information`.
        subsets: `(num_subsets, num_cameras)`.
        rounds: how many are added.
        chosen: `(num_cameras,)` filled, none before.
    """
    tried = np.empty(subsets.shape, np.bool_)
    nats, people = np.empty(len(tried)), np.empty(len(tried))
    for _ in range(rounds):
        for row in range(len(subsets)):
            for camera in range(len(chosen)):
                tried[row, camera] = chosen[camera] or subsets[row, camera]
        information(prior, views, new, weights, tried, nats)
        started(entrants, tried, people)
        best, most = 0, -np.inf
        for row in range(len(subsets)):
            value, adds = quality_weight * (nats[row] + ENTRANT_NATS * people[row]), False
            for camera in range(len(chosen)):
                if subsets[row, camera]:
                    value += worth[camera]
                    adds = adds or not chosen[camera]
            value = np.rint(value / max(NEAR_NATS * quality_weight, 1e-9))
            if adds and value > most:
                best, most = row, value
        for camera in range(len(chosen)):
            chosen[camera] = tried[best, camera]


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
