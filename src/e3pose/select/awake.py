"""Who stays awake: the slow part of the choice of cameras, on a time scale of seconds.

A camera that rests draws far less than one that waits for an order, but it cannot be reached: it
comes back by itself, and takes time to wake. So a plan says of every camera that is awake whether
it stays so, and of one that may rest for how long. Of all sets A of cameras that stay awake, and
mean numbers c of cameras that look in a slot, a plan has the largest

    information(A) + LOOK_NATS log c + starts(A) + shows(A) + FLOOR_NATS watched(A)
        - price * watts(A, c)

`information(A)` is that of all of A together: cameras that repeat each other are worth less.
`watts` has what they draw awake, looking, resting, and the wakes. With a limit of watts the best
plan that keeps it is taken, whatever the price; with a target error the cheapest one that meets it.
Sets are made by leaving out, one after the other, the camera that is missed least, so that what
takes two cameras is kept. A rest that ends with nothing to do is followed by a longer one.
Method: `docs/explanation/camera-selection.md`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.energy.rest_costs import RestCosts
from e3pose.model.camera import Rig
from e3pose.select.expected_information import Foresight
from e3pose.select.floor import seen_floor, watches
from e3pose.select.policies.base import Selection, Situation
from e3pose.select.rest_check import MOST_RISE, RestCheck

Worth = Callable[[Flags], Floats]  # (num_sets, num_cameras) -> (num_sets,)

# tuned: nats a watt | simulated, six scenes, seed 702, and the first half of pizza: 0.3
#   changes `ring` alone, as `MOST_RISE` decides elsewhere | not measured
PRICE = 0.15
# tuned: s | first guess, a tenth of the shortest rest | not measured
PLAN_S = 0.4
# Until how long errors last is learned, nobody rests while people are there.
# tuned: share | simulated and the first half of pizza: a first rest after a third of a second costs
#   7 % on pizza | not measured
LEAST_FILLED = 0.3  # of the memory of the stated error: 3 s
# Of a joint, 3/4 of the logarithm of the looks, of each of three deviations, halved.
LOOK_NATS = 1.1  # definition: nats of e times as many looks
# tuned: s | simulated, `two-rooms`, seed 11: with none, somebody who walks through the door is lost
#   for 2 s | not measured
LATER_S = (1.5, 3.0)
# tuned: s | first guess: twice what falling asleep and waking take; with nobody there a simulated
#   day of `one-sided`, docs/experiments/2026-11-26-what-rests-cost.md | not measured
FIRST_REST_S, LONGEST_REST_S, EMPTY_REST_S = 4.0, 8.0, 16.0
# tuned: times | first guess: a rest that ends with nothing to do is followed by a longer one | not
#   measured
LONGER = 2.0
FEWEST_AWAKE = 2  # definition: cameras that a person takes
# Without a limit of watts: somebody walks out of the view of one.
# tuned: cameras | simulated, `two-rooms`, seed 702: with two, a quarter of the people are lost |
#   not measured
FEWEST_WITH_PEOPLE = 3
# tuned: nats | simulated `ring`, seeds 702 and 703: 1 finds newcomers so late that recall is 3
#   points less, 3 loses none | not measured
FLOOR_NATS = 3.0  # of all of the floor watched by two cameras
# tuned: people | first guess: not started yet, cameras look as if somebody were there | not
#   measured
NEWCOMERS = 0.3
LEAST_LOOKS = 0.1  # numerics: per slot
# tuned: times | first guess: a target that all cameras miss; sets that raise the error by less may
#   do | not measured
NO_WORSE = 1.05
# tuned: share of a rest | first guess: cameras that leave together come back over it | not measured
STAGGER = 0.5
# tuned: s | first guess: who stays awake so long after a rest was needed | not measured
KEPT_S = 1.0
# tuned: s | first guess: of the watts allowed, that may be owed or saved up, and over which they
#   are paid back | not measured
CREDIT_S, REPAY_S = 10.0, 5.0


@dataclass(frozen=True, slots=True)
class RestGoal:
    """What the plan is to keep.

    Attributes:
        price: nats of one watt.
        watts: of the site; None without a limit.
        target_m: the expected error to keep; None without a target.
        find_within_s: how soon somebody new is to be found.
        num_selected: cameras per slot, where the plan does not choose them.
    """

    price: float = PRICE
    watts: float | None = None
    target_m: float | None = None
    find_within_s: float = 1.0
    num_selected: float = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class RestMemory:
    """What a plan remembers.

    Attributes:
        rest_s: `(num_cameras,)` seconds of each camera's last rest; 0 after it was needed.
        next_slot: of the next plan.
        owed_j: drawn beyond the watts allowed; negative where less was.
        num_selected: cameras per slot, by the last plan.
        check: what rests were found to cost.
    """

    rest_s: Floats
    next_slot: int = 0
    owed_j: float = 0.0
    num_selected: float = 0.0
    check: RestCheck = field(default_factory=RestCheck)

    @classmethod
    def none(cls, num_cameras: int) -> RestMemory:
        """Return the memory before the first plan: all cameras are awake."""
        return cls(np.zeros(num_cameras))


@dataclass(frozen=True, slots=True, eq=False)
class Needs:
    """What a plan is to be good for, expected in the slot that is decided.

    Attributes:
        people: number of tracks.
        worth: nats of sets of cameras, without those of looks.
        error_m: expected error of sets of cameras that all look; NaN where nobody is known.
        rise: error of sets that stay awake for seconds over that of all cameras; NaN likewise.
        newcomers: whether somebody is seen who is not tracked yet.
    """

    people: int
    worth: Worth
    error_m: Worth
    rise: Worth
    newcomers: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Who stays awake, and how many of them look in a slot."""

    awake: Flags
    num_selected: float
    watts: float


def shrinking(free: Flags, fixed: Flags, worth: Worth, fewest: int) -> tuple[Flags, Floats]:
    """Return sets of cameras, each without the one of the last that is missed least.

    Args:
        free: `(num_cameras,)` who may be left out.
        fixed: `(num_cameras,)` who may not.
        worth: of sets.
        fewest: cameras of the last set.

    Returns:
        `(num_sets, num_cameras)` from all on, and `(num_sets,)` their worth.
    """
    current = free | fixed
    sets, values = [current], [float(worth(current[None])[0])]
    while current.sum() > fewest and (current & free).any():
        candidates = np.flatnonzero(current & free)
        tried = np.repeat(current[None], len(candidates), axis=0)
        tried[np.arange(len(candidates)), candidates] = False
        found = worth(tried)
        best = int(np.argmax(found))
        current = tried[best]
        sets.append(current)
        values.append(float(found[best]))
    return np.stack(sets), np.array(values)


def planned(
    costs: RestCosts,
    goal: RestGoal,
    memory: RestMemory,
    needs: Needs,
    usable: Flags,
    interval_s: float,
) -> Plan:
    """Return the best plan for cameras that are awake.

    Args:
        costs: of all cameras.
        goal: what to keep.
        memory: of the plans before.
        needs: what the plan is to be good for.
        usable: `(num_cameras,)` awake and online.
        interval_s: seconds per slot.
    """
    free = usable & costs.rests
    fewest = FEWEST_WITH_PEOPLE if needs.people and goal.watts is None else FEWEST_AWAKE
    sets, worth = shrinking(free, usable & ~free, needs.worth, fewest)
    left_w = np.where(usable, costs.resting_w(next_rest_s(memory, needs.people)), costs.rest_w)
    base_w = np.where(sets, costs.idle_w, left_w).sum(axis=1)
    size = sets.sum(axis=1)
    look_w = (sets @ costs.look_w) / np.maximum(size, 1)
    most = np.maximum(size.astype(np.float64), 1e-9)
    counts = np.minimum(goal.num_selected, most)
    allowed_w = np.inf
    if goal.watts is not None:
        allowed_w = goal.watts - memory.owed_j / REPAY_S
        counts = np.clip((allowed_w - base_w) / np.maximum(look_w, 1e-9), LEAST_LOOKS, most)
    if not needs.people and not needs.newcomers:
        watching = size * 2 * interval_s / goal.find_within_s
        counts = np.minimum(counts, np.maximum(watching, LEAST_LOOKS))
    watts = base_w + counts * look_w
    looks = LOOK_NATS * np.log(counts) if needs.people else 0.0
    value = worth + looks - goal.price * watts
    if goal.target_m is not None and needs.people:
        error_m = needs.error_m(sets)
        reach = np.isnan(error_m) | (error_m <= np.maximum(goal.target_m, error_m[0] * NO_WORSE))
        value = np.where(reach, value, -np.inf)
    elif goal.watts is None:
        value = np.where(needs.rise(sets) > MOST_RISE, -np.inf, value)
    keeps = watts <= allowed_w + 1e-9
    best = int(np.argmax(np.where(keeps, value, -np.inf)) if keeps.any() else np.argmin(watts))
    return Plan(sets[best], float(counts[best]), float(watts[best]))


def next_rest_s(memory: RestMemory, people: int) -> Floats:
    """Return `(num_cameras,)` seconds of each camera's next rest."""
    longest_s = LONGEST_REST_S if people else EMPTY_REST_S
    return np.asarray(np.clip(LONGER * memory.rest_s, FIRST_REST_S, longest_s))


def rested(
    costs: RestCosts, memory: RestMemory, leave: Flags, people: int, most_s: float = np.inf
) -> tuple[Flags, Floats]:
    """Return who of those that `leave` takes a rest, and `(num_cameras,)` its seconds.

    They come back one after the other: somebody who came in meanwhile is then seen by more cameras
    sooner. Who would wake before it has slept stays awake. No rest is longer than `most_s`.
    """
    order = np.cumsum(leave) - 1
    rest_s = next_rest_s(memory, people) * (1 + STAGGER * order / max(int(leave.sum()), 1))
    rest_s = np.minimum(rest_s, most_s)
    return np.asarray(leave & (rest_s > costs.lost_s)), rest_s


def risen(repeated_m: Floats, everybody_m: Floats, stated_m: float) -> Floats:
    """Return the errors of sets of cameras over that of all of them.

    Over seconds, what cameras repeat adds to the rest of the error as variances do.

    Args:
        repeated_m: `(*batch)` errors that sets leave of what their cameras repeat.
        everybody_m: `(*batch)` the same of all cameras.
        stated_m: error stated in the last seconds.
    """
    all_m2 = np.maximum(stated_m**2, everybody_m**2)
    return np.asarray(np.sqrt(1 + (repeated_m**2 - everybody_m**2) / all_m2))


@dataclass(frozen=True, slots=True, eq=False)
class RestPlanner:
    """The part of a pipeline that says who sleeps.

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
    ) -> tuple[RestMemory, Integers]:
        """Return the memory and `asleep_until` by the plan for a slot.

        A plan is made every `PLAN_S`, and when a camera is awake again.

        Args:
            memory: of the slot before.
            situation: of the slot that is decided.
            asleep_until: `(num_cameras,)` slot from which each is awake.
            later: what cameras would add if people were where they are expected so many seconds
                after the slot.
        """
        slot, interval_s = situation.slot, situation.interval_s
        if slot < memory.next_slot and not (asleep_until == slot).any():
            return memory, asleep_until
        usable = situation.online & (asleep_until <= slot)
        ahead = [later(seconds) for seconds in LATER_S]
        needs = self.needs(situation, ahead, asleep_until > slot)
        plan = planned(self.costs, self.goal, memory, needs, usable, interval_s)
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
        if not self.checks(1):
            return memory
        check = memory.check.after(slot, interval_s, bool(asleep.any()), error_m)
        return replace(memory, check=check)

    def needs(self, situation: Situation, later: Sequence[Foresight], asleep: Flags) -> Needs:
        """Return what a plan is to be good for, now and `later`.

        Args:
            situation: of the slot that is decided.
            later: what cameras would add in some seconds.
            asleep: `(num_cameras,)` who is, and could be awake.

        Raises:
            ValueError: of a situation without a foresight.
        """
        foresight = situation.foresight
        if foresight is None:
            raise ValueError("a plan of rests needs a foresight")
        ahead = [foresight, *later]
        everybody = situation.online | asleep
        settled = [each.over_seconds() for each in ahead]
        people, (cells_m, _) = len(foresight.track_ids), seen_floor(self.rig)
        likely = np.full(len(cells_m), 1 / max(len(cells_m), 1))

        def worth(sets: Flags) -> Floats:
            nats = np.mean([each.information(sets) for each in settled], axis=0)
            nats += foresight.hidden.shows(sets)
            floor = FLOOR_NATS * watches(self.rig, sets, likely)
            return np.asarray(nats + foresight.entrants.starts(sets) + floor)

        def rise(sets: Flags) -> Floats:
            if situation.stated.filled < LEAST_FILLED and foresight.confirmed.any():
                return np.full(len(sets), np.inf)
            pairs = np.concatenate([everybody[None], sets])
            errors_m = np.stack([each.expected_error_m(pairs) for each in settled])
            stated_m = situation.stated.mean_m
            return np.asarray(risen(errors_m[:, 1:], errors_m[:, :1], stated_m).max(axis=0))

        newcomers = bool(foresight.entrants.weights.sum() > NEWCOMERS)
        return Needs(people, worth, foresight.expected_error_m, rise, newcomers)

    def charged(
        self, memory: RestMemory, selected: Selection, asleep: Flags, interval_s: float
    ) -> RestMemory:
        """Return the memory after a decision: what it draws beyond the watts allowed is owed."""
        watts = self.goal.watts
        if watts is None:
            return memory
        awake_w = self.costs.idle_w + selected * self.costs.look_w
        # A rest is charged as a mean of all of it: falling asleep and waking draw more.
        drawn_w = np.where(asleep, self.costs.resting_w(memory.rest_s), awake_w)
        owed_j = memory.owed_j + float(drawn_w.sum() - watts) * interval_s
        most_j = watts * CREDIT_S
        return replace(memory, owed_j=min(max(owed_j, -most_j), most_j))
