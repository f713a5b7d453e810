"""Policies that ignore the scene: all, random, round-robin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.select.policies.base import Selection, Situation, count_at, count_before


@dataclass(frozen=True, slots=True)
class All:
    """Wake every camera in every slot: the paper's Select-All (SA)."""

    def select(self, situation: Situation) -> Selection:
        """See `Policy.select`."""
        return np.array(situation.online)


@dataclass(frozen=True, slots=True)
class Random:
    """Wake `num_selected` random cameras per slot: the paper's Random Selection (RS).

    The draw depends on the seed and the slot alone, so that a restart repeats it.
    """

    num_selected: float
    seed: int = 0

    def select(self, situation: Situation) -> Selection:
        """See `Policy.select`."""
        rng = np.random.default_rng([self.seed, situation.slot])
        candidates = np.flatnonzero(situation.online)
        selection = np.zeros(len(situation.online), dtype=bool)
        count = min(count_at(situation.slot, self.num_selected), len(candidates))
        selection[rng.choice(candidates, count, replace=False)] = True
        return selection


@dataclass(frozen=True, slots=True)
class RoundRobin:
    """Wake `num_selected` online cameras in turn.

    Attributes:
        num_selected: cameras per slot; a mean if it is no whole number.
        phase: who is first.
        order: of the turns, such as `turns.spread_order` finds; rig order if empty.
    """

    num_selected: float
    phase: int = 0
    order: tuple[int, ...] = ()

    def select(self, situation: Situation) -> Selection:
        """See `Policy.select`."""
        online = situation.online
        order = np.array(self.order or range(len(online)), dtype=np.int64)
        candidates = order[online[order]]  # those that are gone lose their turns to the others
        selection = np.zeros(len(online), dtype=bool)
        if len(candidates):
            count = min(count_at(situation.slot, self.num_selected), len(candidates))
            start = count_before(situation.slot, self.num_selected) + self.phase
            selection[candidates[(start + np.arange(count)) % len(candidates)]] = True
        return selection
