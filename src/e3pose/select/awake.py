"""The planner of rests: chooses every few slots which cameras sleep, and for how long.

A plan is to keep known people and to find newcomers, at the permitted cost of rests. Newcomers are
looked for on the visible floor: where people can be, and which cameras would show them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.energy.rest_costs import RestCosts
from e3pose.estimate.filter import blindness
from e3pose.model.camera import Rig
from e3pose.model.look_request import NO_REQUEST, LookRequest
from e3pose.select import rest_plan
from e3pose.select.expected_information import Foresight
from e3pose.select.policies.base import Selection, Situation
from e3pose.select.requested import asked_for
from e3pose.select.rest_plan import CREDIT_S, Needs, RestGoal, RestMemory, planned, rested, risen

PLAN_S = rest_plan.FIRST_REST_S / 10  # definition: between two plans, a tenth of the shortest rest
# tuned: s | simulated, `two-rooms`, seed 11 | with none, somebody who walks through the door is
#   lost for 2 s
LATER_S = (1.5, 3.0)
# tuned: s | first guess: who stays awake so long after a rest was needed | by the truth half: 2 %
#   more power in one of five simulated cases; twice: the same in all
KEPT_S = 1.0
# tuned: m | first guess: how far cameras show people | by the truth of simulated days half: 5 %
#   less power, 0.8 points more missed; twice: the same
FAR_M = 12.0
MOST_CELLS = 4000  # capacity: of a site; a larger one has larger cells
HEIGHTS_M = (0.1, 0.5, 0.9, 1.3, 1.7)  # definition: of somebody who stands in a cell
MOST_OF = 0.5  # definition: of these heights, for a camera that sees the person
MOST_SURE = 0.999  # numerics


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


@lru_cache(maxsize=64)
def seen_floor(rig: Rig) -> tuple[Floats, Floats]:
    """Return the floor cells in which two cameras would see a standing person.

    Nobody is estimated in others.

    Returns:
        `(num_cells, 2)` metres, their middles, and `(num_cameras, num_cells)` 1 where a camera
        sees somebody who stands in a cell, else 0. Walls are not known.
    """
    places_m = rig.centers_m[:, :2]
    low, high = places_m.min(axis=0) - REACH_M, places_m.max(axis=0) + REACH_M
    cell_m = max(blindness.CELL_M, float(np.sqrt(np.prod(high - low) / MOST_CELLS)))
    x, y = np.meshgrid(*(np.arange(a, b, cell_m) for a, b in zip(low, high, strict=True)))
    cells_m = np.stack([x.ravel(), y.ravel()], axis=-1)
    heights_m = np.tile(HEIGHTS_M, len(cells_m))[:, None]
    points_m = np.concatenate([np.repeat(cells_m, len(HEIGHTS_M), axis=0), heights_m], axis=1)
    shape = (len(cells_m), len(HEIGHTS_M))
    inside = np.stack([c.sees(points_m).reshape(shape).mean(axis=1) for c in rig.cameras])
    near = np.linalg.norm(cells_m - places_m[:, None], axis=-1) < FAR_M
    seen = ((inside > MOST_OF) & near).astype(np.float64)
    two = seen.sum(axis=0) >= 2
    return cells_m[two], np.asarray(seen[:, two])


class _Corners(NamedTuple):
    """The cells of a detection map around each floor cell, with their detection rates."""

    columns: NDArray[np.int64]  # (4, num_cells)
    rows: NDArray[np.int64]  # (4, num_cells)
    weights: Floats  # (4, num_cells)
    free: Floats  # (num_cameras, num_cells) that nothing stands in the way


@lru_cache(maxsize=8)
def _corners(rig: Rig) -> _Corners:
    cells_m, _ = seen_floor(rig)
    at = (cells_m - blindness.corner_m(rig)) / blindness.CELL_M - 0.5
    at = np.clip(at, 0.0, blindness.LAST)
    low = np.floor(at).astype(np.int64)
    right, up = (at - low).T
    far_m = np.linalg.norm(cells_m - rig.centers_m[:, None, :2], axis=-1)
    return _Corners(
        columns=low[:, 0] + np.array([[0], [0], [1], [1]]),
        rows=low[:, 1] + np.array([[0], [1], [0], [1]]),
        weights=np.stack([(1 - right) * (1 - up), (1 - right) * up, right * (1 - up), right * up]),
        free=np.exp(-far_m / FAR_M),  # a wall is likelier on a longer way
    )


def sights(rig: Rig, detection_map: Floats | None) -> Floats:
    """Return `(num_cameras, num_cells)` how likely each camera shows who is in a cell of the floor.

    Where people were, looks tell. Elsewhere the farther a cell the likelier something hides it.

    Args:
        rig: the cameras.
        detection_map: as in `Outlook`; None where nothing is known.
    """
    _, seen = seen_floor(rig)
    corners = _corners(rig)
    if detection_map is None:
        return np.asarray(seen * corners.free * MOST_SURE)
    there = detection_map[:, corners.columns, corners.rows]
    looks, shown = np.einsum("kn,cknv->vcn", corners.weights, there)
    known = blindness.PRIOR_VIEWS * blindness.PLAIN * corners.free + shown
    rate = known / (looks + blindness.PRIOR_VIEWS) / blindness.PLAIN
    return np.asarray(seen * np.clip(rate, 0.0, 1.0) * MOST_SURE)


def showing(sight: Floats, sets: Flags) -> tuple[Floats, Floats]:
    """Return how likely at least one, and at least two, of sets of cameras show who is in a cell.

    Args:
        sight: `(num_cameras, num_cells)` of `sights`.
        sets: `(num_sets, num_cameras)`.

    Returns:
        Twice `(num_sets, num_cells)`.
    """
    none = np.exp(sets @ np.log1p(-sight))
    return np.asarray(1 - none), np.asarray(1 - none * (1 + sets @ (sight / (1 - sight))))


# Until how long errors last is learned, nobody rests while people are there.
# tuned: share | simulated and the first half of pizza | 0.03: 7 % more error on pizza
LEAST_FILLED = 0.3  # of the memory of the stated error: 3 s
# tuned: nats | simulated `ring`, seeds 702 and 703 | 1: newcomers so late that recall is 3 points
#   less; 3 loses none
FLOOR_NATS = 3.0  # of all of the floor watched by two cameras
# tuned: people | first guess: not started yet, cameras look as if somebody were there | by the
#   truth of a day of `two-rooms` half and twice: 0.3 points more and 0.2 fewer missed
NEWCOMERS = 0.3
# tuned: m | simulated, `two-rooms` and `one-sided`, seeds 702, 704, 719, 720, 722 | 2 m and less:
#   those who walk through a door are lost; 4 m draws 2 % more
REACH_M = 3.0  # who is here may be so far away before a camera wakes


def needs_of(rig: Rig, situation: Situation, later: Sequence[Foresight], asleep: Flags) -> Needs:
    """Return the goals of a plan, now and `later`.

    Args:
        rig: the cameras.
        situation: of the slot that is decided.
        later: what cameras would add in some seconds.
        asleep: `(num_cameras,)` who is, and could be awake.

    Raises:
        ValueError: of a situation without a foresight.
    """
    foresight = situation.foresight
    if foresight is None:
        raise ValueError("a plan of rests needs a foresight")
    everybody = situation.online | asleep
    settled = [each.over_seconds() for each in (foresight, *later)]
    sight, near = sights(rig, foresight.outlook.detection_map), _around(rig, foresight)
    likely = np.full(sight.shape[1], 1 / max(sight.shape[1], 1))

    def worth(sets: Flags) -> Floats:
        nats = np.mean([each.information(sets) for each in settled], axis=0)
        nats += foresight.entrants.starts(sets)
        one, two = showing(sight, sets)
        return np.asarray(nats + FLOOR_NATS * 0.5 * (one + two) @ likely)

    def rise(sets: Flags) -> Floats:
        if situation.stated.filled < LEAST_FILLED and foresight.people.confirmed.any():
            return np.full(len(sets), np.inf)
        pairs = np.concatenate([everybody[None], sets])
        errors_m = np.stack([each.expected_error_m(pairs) for each in settled])
        stated_m = situation.stated.mean_m
        return np.asarray(risen(errors_m[:, 1:], errors_m[:, :1], stated_m).max(axis=0))

    def blind(sets: Flags, weights: Floats) -> Floats:
        """Return `(num_sets,)` weighted share of places that all cameras see and these do not."""
        _, two = showing(sight, np.concatenate([everybody[None], sets]))
        found = two @ weights
        return np.asarray(1 - found[1:] / max(float(found[0]), 1e-9))

    return Needs(
        people=len(foresight.people.track_ids),
        worth=worth,
        error_m=foresight.expected_error_m,
        rise=rise,
        strays=lambda sets: blind(sets, near),
        misses=lambda sets: blind(sets, likely),
        newcomers=bool(foresight.entrants.weights.sum() > NEWCOMERS),
    )


def _around(rig: Rig, foresight: Foresight) -> Floats:
    """Return `(num_cells,)` how likely people go to a cell of the floor, up to a factor."""
    cells_m, _ = seen_floor(rig)
    away_m = np.linalg.norm(
        cells_m - foresight.people.joints_m[..., :2].mean(axis=1)[:, None], axis=-1
    )
    return np.asarray(np.exp(-away_m / REACH_M).sum(axis=0))
