"""The plan of rests: the slow part of camera selection, on a time scale of seconds.

A camera that rests draws far less than one that waits for an order, but it cannot be reached: it
comes back by itself, and takes time to wake. So a plan says of every camera that is awake whether
it stays so, and of one that may rest for how long. Of all sets A of cameras that stay awake, and
mean numbers c of cameras that look in a slot, a plan has the largest

    information(A) + LOOK_NATS log c + starts(A) + FLOOR_NATS watched(A)
        - price * watts(A, c)

`information(A)` is that of all of A together: cameras that repeat each other are worth less.
`watts` has what they draw awake, looking, resting, and the wakes. With a limit of watts the best
plan that keeps it is taken, whatever the price; with a target error the cheapest one that meets it.
Sets are made by leaving out, one after the other, the camera that is missed least, so that what
takes two cameras is kept. Wanted are the looks that somebody asks for, and while nobody is there
those that find people in time: who is awake and never looks finds nobody. A rest that ends with
nothing to do is followed by the longest one.
Method: `docs/explanation/camera-selection.md`.

What rests cost in error is measured: in the last stretch of a round everybody is awake, and the
error that the estimator states is compared with that of the stretch before. Where rests raise it by
more than a tenth, nobody rests, but in that last stretch, until they do not. What the estimator
does not know it cannot state: a plan of rests counts what views repeat by itself (`risen`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.energy.rest_costs import RestCosts
from e3pose.model.look_request import NO_REQUEST, LookRequest
from e3pose.select.policies.information import NO_BETTER

# What it costs and how soon it says something; no site has run long enough to try other values. The
# judge of each are drawn errors of known rise (0, 5, 15 and 30 %), 8 h: points of the time in which
# it is wrong, of 0, 4.9, 1.8 and 1.8 %.
# tuned: s | by reasoning, tried on no recording | half: 0.9 to 4.9 points less; twice: 4.9
#   less at 5, 8 and 1.8 more at 15 and 30 %
STRETCH_S = 8.0
# tuned: stretches | by reasoning, tried on no recording | half: 0.8 to 4.5 points less; twice: 4.9
#   less at 5, 2 more at 15 and 30 %
STRETCHES = 16  # in a round: a sixteenth of the time everybody is awake
# tuned: s | by reasoning, tried on no recording | half: the same; twice: 0.6 points more at 5 %
SETTLE_S = 2.0  # of a stretch, in which its people are still those of the one before
# tuned: rounds | by reasoning, tried on no recording: about an hour | half: the same; twice: 0.4
#   points more at 5 %
MEMORY = 32.0
# tuned: rounds | by reasoning, tried on no recording | half: 1 point more at 5, 0.9 less at 15 and
#   30 %; twice: 4.9 less at 5, 1.8 more at 15 and 30 %
LEAST_ROUNDS = 4  # of which a spread is taken
# tuned: of a logarithm | by reasoning, tried on no recording | half: 3.9 points less at 5 %; twice:
#   0.4 more
LEAST_SPREAD = 0.05  # of one round, in logarithms of an error
# tuned: standard errors | by reasoning, tried on no recording | half and twice: 3.4 and 4.9 points
#   less at 5 %
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


Worth = Callable[[Flags], Floats]  # (num_sets, num_cameras) -> (num_sets,)

# tuned: nats a watt | simulated, six scenes, seed 702, and the first half of pizza | 0.3 changes
#   `ring` alone, as `MOST_RISE` decides elsewhere
PRICE = 0.15
# Of a joint, 3/4 of the logarithm of the looks, of each of three deviations, halved.
LOOK_NATS = 1.1  # definition: nats of e times as many looks
# tuned: s | first guess: twice what falling asleep and waking take; with nobody there a simulated
#   day of `one-sided`, lab/experiments/2026-11-26-what-rests-cost.md | by the truth of `two-rooms`
#   and of a day in it the first halved, or the second doubled: 7 to 8 % more power, 1 to 6 % less
#   error; the second halved: 10 to 14 % less power, 1.3 points more missed on the day; the third
#   halved: 4 % less power, 0.3 points more missed on the day; doubled: the same
FIRST_REST_S, LONGEST_REST_S, EMPTY_REST_S = 4.0, 8.0, 16.0
# Who goes where two of those awake do not show the person is lost until another camera wakes.
# tuned: 1/s | simulated, `two-rooms`, seeds 702, 704, 719, 720, 722 | 0.03: those who walk through
#   the door are lost, 11 % more error; 0.06 draws 2 % more
STRAY_HZ = 0.05  # of the error, if nothing around people is seen
# tuned: share | simulated days of `two-rooms`, `ring` and `one-sided`, seeds 711 to 714,
#   lab/experiments/2026-11-26-what-rests-cost.md | 3/4 loses up to 3.9 points of recall
MOST_LATE = 0.5  # of `find_within_s`, that rests may find a newcomer later, on average
TOLD_S = 60.0  # layout: of rests that save nothing, until operators are told
FEWEST_AWAKE = 2  # definition: cameras that a person takes
# Without a limit of watts: somebody walks out of the view of one.
# tuned: cameras | simulated, `two-rooms`, seed 702 | 2: a quarter of the people are lost
FEWEST_WITH_PEOPLE = 3
LEAST_LOOKS = 0.1  # numerics: per slot
# tuned: s | first guess: of the watts allowed, that may be owed or saved up, and over which they
#   are paid back | by the truth of three scenes the first half and twice: the same; the second
#   half: 3 % fewer cameras, 1 point more missed; twice: 9 % more, 0.5 fewer
CREDIT_S, REPAY_S = 10.0, 5.0
# Of the watts allowed, what is lent for looks that are asked for, until paying back takes REPAY_S.
# tuned: share | `home-fall`, seeds 0 to 5, at 26 and 28 W | 25 and 28 of 29 falls found; 0.4: 22
#   and 26; without requests 22 at 26 W
LENT = 0.2
# tuned: nats | `home-fall`, seeds 0 to 5, 26 W | 2 and 4: 26 of 29 falls found, with other
#   requests; none: 16 of 24 of seeds 0 to 4
MISSING_NATS = 4.0  # of e times fewer looks than are wanted


@dataclass(frozen=True, slots=True)
class RestGoal:
    """Limits that the plan must keep.

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
    """Memory of the rest planner.

    Attributes:
        rest_s: `(num_cameras,)` seconds of each camera's last rest; 0 after it was needed.
        next_slot: of the next plan.
        owed_j: drawn beyond the watts allowed; negative where less was.
        num_selected: cameras per slot, by the last plan.
        check: what rests were found to cost.
        awake_s: seconds since somebody slept, or since the first slot.
    """

    rest_s: Floats
    next_slot: int = 0
    owed_j: float = 0.0
    num_selected: float = 0.0
    check: RestCheck = field(default_factory=RestCheck)
    awake_s: float = 0.0

    def operator_note(self) -> str:
        """Return a note for operators; empty without one."""
        found = self.check.operator_note()
        if self.awake_s < TOLD_S or self.check.idle:
            return found
        why = "no camera rests: each is needed to follow or find people"
        return f"{why}; {found}" if found else why

    @classmethod
    def none(cls, num_cameras: int) -> RestMemory:
        """Return the memory before the first plan: all cameras are awake."""
        return cls(np.zeros(num_cameras))


@dataclass(frozen=True, slots=True, eq=False)
class Needs:
    """Goals of a plan, expected in the decided slot.

    Attributes:
        people: number of tracks.
        worth: nats of sets of cameras, without those of looks.
        error_m: expected error of sets of cameras that all look; NaN where nobody is known.
        rise: error of sets that stay awake for seconds over that of all cameras; NaN likewise.
        strays: share of the floor around people that sets cannot follow them to, and all can.
        misses: share of all of the floor on which sets do not find a newcomer, and all do.
        newcomers: whether somebody is seen who is not tracked yet.
    """

    people: int
    worth: Worth
    error_m: Worth
    rise: Worth
    strays: Worth
    misses: Worth
    newcomers: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Cameras that stay awake, and how many of them are active per slot."""

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
    request: LookRequest = NO_REQUEST,
) -> Plan:
    """Return the best plan for cameras that are awake.

    Args:
        costs: of all cameras.
        goal: what to keep.
        memory: of the plans before.
        needs: what the plan is to be good for.
        usable: `(num_cameras,)` awake and online.
        interval_s: seconds per slot.
        request: looks that somebody asks for.
    """
    free = usable & costs.rests
    fewest = FEWEST_WITH_PEOPLE if needs.people and goal.watts is None else FEWEST_AWAKE
    sets, worth = shrinking(free, usable & ~free, needs.worth, fewest)
    left_w = np.where(usable, costs.resting_w(next_rest_s(memory, needs.people)), costs.rest_w)
    base_w = np.where(sets, costs.idle_w, left_w).sum(axis=1)
    size = sets.sum(axis=1)
    look_w = (sets @ costs.look_w) / np.maximum(size, 1)
    most = np.maximum(size.astype(np.float64), 1e-9)
    wanted = np.full(len(sets), request.cameras)
    counts = np.minimum(max(goal.num_selected, request.cameras), most)
    allowed_w = np.inf
    if goal.watts is not None:
        allowed_w = goal.watts - memory.owed_j / REPAY_S
        if request.cameras and memory.owed_j < goal.watts * REPAY_S:
            allowed_w = max(allowed_w, goal.watts) + goal.watts * LENT
        counts = np.clip((allowed_w - base_w) / np.maximum(look_w, 1e-9), LEAST_LOOKS, most)
        if request.cameras:
            counts = np.minimum(counts, request.cameras)
    if not needs.people and not needs.newcomers and not request.cameras:
        wanted = size * 2 * interval_s / goal.find_within_s
        counts = np.minimum(counts, np.maximum(wanted, LEAST_LOOKS))
    counts = np.minimum(counts, max(request.enough_per_s * interval_s, LEAST_LOOKS))
    watts = base_w + counts * look_w
    looks = LOOK_NATS * np.log(counts) if needs.people else 0.0
    missing = MISSING_NATS * np.log(np.minimum(counts / np.maximum(wanted, 1e-9), 1.0))
    value = worth + looks + missing - goal.price * watts
    if goal.target_m is not None and needs.people:
        error_m = needs.error_m(sets)
        enough_m = np.maximum(goal.target_m, error_m[0] * (1 + NO_BETTER))
        reach = np.isnan(error_m) | (error_m <= enough_m)
        value = np.where(reach, value, -np.inf)
    elif goal.watts is None:
        value = np.where(_costs_too_much(goal, needs, sets), -np.inf, value)
    keeps = watts <= allowed_w + 1e-9
    best = int(np.argmax(np.where(keeps, value, -np.inf)) if keeps.any() else np.argmin(watts))
    return Plan(sets[best], float(counts[best]), float(watts[best]))


def _costs_too_much(goal: RestGoal, needs: Needs, sets: Flags) -> Flags:
    """Return `(num_sets,)` whether people err too much, or are lost or found late too often."""
    rest_s = LONGEST_REST_S if needs.people else EMPTY_REST_S
    late_s = needs.misses(sets) * max(rest_s - goal.find_within_s, 0.0) / 2
    too_late = np.asarray(late_s > MOST_LATE * goal.find_within_s)
    if not needs.people:
        return too_late
    rise = needs.rise(sets) + STRAY_HZ * rest_s * needs.strays(sets)
    return np.asarray((rise > MOST_RISE) | too_late)


def next_rest_s(memory: RestMemory, people: int) -> Floats:
    """Return `(num_cameras,)` seconds of each camera's next rest."""
    longest_s = LONGEST_REST_S if people else EMPTY_REST_S
    return np.where(memory.rest_s > 0, longest_s, FIRST_REST_S)


def rested(
    costs: RestCosts, memory: RestMemory, leave: Flags, people: int, most_s: float = np.inf
) -> tuple[Flags, Floats]:
    """Return which cameras of `leave` rest, and `(num_cameras,)` for how many seconds.

    Who would wake before it has slept stays awake. No rest is longer than `most_s`.
    """
    rest_s = np.minimum(next_rest_s(memory, people), most_s)
    return np.asarray(leave & (rest_s > costs.lost_s)), rest_s


def risen(repeated_m: Floats, everybody_m: Floats, stated_m: float) -> Floats:
    """Return the error of sets of cameras relative to all cameras.

    Over seconds, what cameras repeat adds to the rest of the error as variances do.

    Args:
        repeated_m: `(*batch)` errors that sets leave of what their cameras repeat.
        everybody_m: `(*batch)` the same of all cameras.
        stated_m: error stated in the last seconds.
    """
    all_m2 = np.maximum(stated_m**2, everybody_m**2)
    return np.asarray(np.sqrt(1 + (repeated_m**2 - everybody_m**2) / all_m2))
