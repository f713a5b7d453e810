"""The planner of rests: chooses every few slots which cameras sleep, and for how long."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from e3pose.base.arrays import Flags, Integers
from e3pose.energy.rest_costs import RestCosts
from e3pose.model.camera import Rig
from e3pose.model.look_request import NO_REQUEST, LookRequest
from e3pose.select.expected_information import Foresight
from e3pose.select.policies.base import Selection, Situation
from e3pose.select.requested import asked_for
from e3pose.select.rest_needs import needs_of
from e3pose.select.rest_plan import CREDIT_S, RestGoal, RestMemory, planned, rested

# tuned: s | first guess, a tenth of the shortest rest | not measured
PLAN_S = 0.4
# tuned: s | simulated, `two-rooms`, seed 11: with none, somebody who walks through the door is lost
#   for 2 s | not measured
LATER_S = (1.5, 3.0)
# tuned: s | first guess: who stays awake so long after a rest was needed | not measured
KEPT_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class RestPlanner:
    """The part of a pipeline that orders sleep.

    Attributes:
        rig: the cameras.
        costs: what they draw.
        goal: what to keep.
    """

    rig: Rig
    costs: RestCosts
    goal: RestGoal

    def with_count(self, num_selected: float) -> RestPlanner:
        """Return the planner for another number of cameras per slot; watts choose their own."""
        return replace(self, goal=replace(self.goal, num_selected=num_selected))

    def planned(
        self,
        memory: RestMemory,
        situation: Situation,
        asleep_until: Integers,
        later: Callable[[float], Foresight],
        request: LookRequest = NO_REQUEST,
    ) -> tuple[RestMemory, Integers]:
        """Return the memory and `asleep_until` by the plan for a slot.

        A plan is made every `PLAN_S`, and when a camera is awake again.

        Args:
            memory: of the slot before.
            situation: of the slot that is decided.
            asleep_until: `(num_cameras,)` slot from which each is awake.
            later: what cameras would add if people were where they are expected so many seconds
                after the slot.
            request: looks that somebody asks for.
        """
        slot, interval_s = situation.slot, situation.interval_s
        if slot < memory.next_slot and not (asleep_until == slot).any():
            return memory, asleep_until
        usable = situation.online & (asleep_until <= slot)
        ahead = [asked_for(later(seconds), request) for seconds in LATER_S]
        needs = needs_of(self.rig, situation, ahead, asleep_until > slot)
        plan = planned(self.costs, self.goal, memory, needs, usable, interval_s, request)
        most_s = memory.check.left_s(slot, interval_s) if self.checks(needs.people) else np.inf
        # Who woke looks before it rests again: somebody may be where the others are blind.
        looked = situation.unseen_slots < np.maximum(slot - asleep_until, 1)
        leave = usable & looked & ~plan.awake
        leave, rest_s = rested(self.costs, memory, leave, needs.people, most_s)
        slots = np.maximum(np.round(rest_s / interval_s).astype(np.int64), 1)
        needed = usable & plan.awake & ((slot - asleep_until) * interval_s >= KEPT_S)
        memory = replace(
            memory,
            rest_s=np.where(leave, rest_s, np.where(needed, 0.0, memory.rest_s)),
            next_slot=slot + max(round(PLAN_S / interval_s), 1),
            num_selected=plan.num_selected,
        )
        return memory, np.where(leave, slot + slots, asleep_until)

    def checks(self, people: int) -> bool:
        """Return whether rests are compared with none: no watts or target say otherwise."""
        return people > 0 and self.goal.watts is None and self.goal.target_m is None

    def checked(
        self, memory: RestMemory, slot: int, interval_s: float, asleep: Flags, error_m: float
    ) -> RestMemory:
        """Return the memory after the views of a slot.

        Args:
            memory: before them.
            slot: of the views.
            interval_s: seconds per slot.
            asleep: `(num_cameras,)` who slept.
            error_m: the mean error stated; NaN where nobody is known.
        """
        memory = replace(memory, awake_s=0.0 if asleep.any() else memory.awake_s + interval_s)
        if not self.checks(1):
            return memory
        check = memory.check.after(slot, interval_s, bool(asleep.any()), error_m)
        return replace(memory, check=check)

    def charged(
        self, memory: RestMemory, selected: Selection, asleep: Flags, interval_s: float
    ) -> RestMemory:
        """Return the memory after a decision; power beyond the allowed watts is owed."""
        watts = self.goal.watts
        if watts is None:
            return memory
        awake_w = self.costs.idle_w + selected * self.costs.look_w
        # A rest is charged as a mean of all of it: falling asleep and waking draw more.
        drawn_w = np.where(asleep, self.costs.resting_w(memory.rest_s), awake_w)
        owed_j = memory.owed_j + float(drawn_w.sum() - watts) * interval_s
        most_j = watts * CREDIT_S
        return replace(memory, owed_j=min(max(owed_j, -most_j), most_j))
