"""The filtering estimator as a part of the loop: one causal filter per person.

A predictor corrects velocities, and lowers the process noise: this says what the filter's own
motion, a velocity that fades, leaves open. A predictor that knows how people move foresees a part
of that, and says which by the errors that it expects.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from math import inf

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.base.records import changed
from e3pose.estimate.base import STEER_SLOTS, Estimate, History, Outlook
from e3pose.estimate.filter import learned_noise, outlook
from e3pose.estimate.filter.allocation import held_constants
from e3pose.estimate.filter.lasting import AT_ONCE, Lasting
from e3pose.estimate.filter.motion import fading, foresee_joints, steer_all
from e3pose.estimate.filter.outlook import stated_factor
from e3pose.estimate.filter.posterior import Grades, posterior_of
from e3pose.estimate.filter.reidentification import Identities, identify
from e3pose.estimate.filter.shown import grade, grow
from e3pose.estimate.filter.state import Belief, Model, known_of
from e3pose.estimate.filter.tree import Tree
from e3pose.model.people import People
from e3pose.model.pose import Poses2D
from e3pose.predict.base import Prediction, Predictor

FilterStep = Callable[[Model, Belief, Mapping[int, Poses2D], float], tuple[Belief, People]]


# Of the way from the filter's own prediction to the other one. The errors of the two hang together,
# and far from what was learned the filter's is the safer one; 0.5 to 0.7 are alike
# (`lab/experiments/2026-11-22-steering-by-default.md`, which has the shares too).
# tuned: share | simulated, seeds 701 and 702, CMU and Panoptic motion: 0.5 to 0.7 are alike,
#   lab/experiments/2026-11-22-steering-by-default.md | steering
GAIN = 0.5
GAPS = 5  # numerics: between looks, whose median is their pace
SAME_S = 1e-6  # numerics


@dataclass(frozen=True, slots=True, eq=False)
class Looks:
    """Where people were in the last slots in which a camera looked.

    Where few slots have a look, most poses of a history are what the filter expects. A predictor
    would take that for the motion of people, and the filter would believe it: it would hear itself.

    Attributes:
        history: of the belief's tracks that the newest look showed.
        times_s: `(num_looks,)` of the looks; -inf before the first.
    """

    history: History
    times_s: Floats

    def pace(self, interval_s: float) -> int:
        """Return the slots from one look to the next, at least 1."""
        last = pairwise(self.times_s[-GAPS - 1 :].tolist())
        known_s = sorted(later - before for before, later in last if 0 < later - before < inf)
        usual_s = known_s[len(known_s) // 2] if known_s else interval_s
        return max(round(usual_s / interval_s), 1)

    def evenly_m(self, step_s: float) -> Floats:
        """Return poses at equal steps up to the newest look, between two looks on a line.

        Returns:
            `(num_looks, num_tracks, num_joints, 3)` metres, NaN before the first look.
        """
        times_s, joints_m = self.times_s, self.history.joints_m
        at_s = times_s[-1] - step_s * np.arange(len(times_s))[::-1]
        later = times_s.searchsorted(at_s - SAME_S)
        before = np.maximum(later - 1, 0)
        met = times_s[later] - at_s < SAME_S
        with np.errstate(divide="ignore", invalid="ignore"):  # before the first look
            share = (at_s - times_s[before]) / (times_s[later] - times_s[before])
            way_m = share[:, None, None, None] * (joints_m[later] - joints_m[before])
        found_m = np.where(met[:, None, None, None], joints_m[later], joints_m[before] + way_m)
        return np.asarray(found_m)


@dataclass(frozen=True, slots=True, eq=False)
class FilterMemory:
    """State of `Filtered` between slots.

    Attributes:
        belief: about everybody.
        identities: which of the belief's tracks are whom, and who left.
        history: of the belief's tracks that the newest slot showed.
        looks: of cameras.
        factor: that makes the belief's standard deviations those that were reported, on average.
        lasting: how long errors last, by the biases learned.
    """

    belief: Belief
    identities: Identities
    history: History
    looks: Looks
    factor: float = 1.0
    lasting: Lasting = field(default_factory=Lasting)


@dataclass(frozen=True, slots=True, eq=False)
class Filtered:
    """Estimate with a memory.

    Attributes:
        model: the rig, the skeleton, the noise of the detector.
        step: advances the belief (`StepKernel`).
        history_slots: the length of the history, at least 2.
    """

    model: Model
    step: FilterStep
    history_slots: int = 10

    def begin(self) -> FilterMemory:
        """See `Estimator.begin`."""
        history = History.empty(self.history_slots, len(self.model.skeleton))
        looks = Looks(history, np.full(len(history.joints_m), -inf))
        return FilterMemory(Belief.empty(self.model), Identities.none(self.model), history, looks)

    def estimate(
        self,
        memory: FilterMemory,
        views: Mapping[int, Poses2D],
        time_s: float,
        clock: Callable[[], float],
    ) -> tuple[FilterMemory, Estimate]:
        """See `Estimator.estimate`."""
        start = clock()
        belief, shown = self.step(self.model, memory.belief, views, time_s)
        if (next_id := _next_id(memory.belief, belief)) != belief.next_id:
            belief = changed(belief, next_id=next_id)
        identities = identify(memory.identities, memory.belief, belief, shown.track_ids, self.model)
        everybody = identities.of(belief.track_ids)
        rows = belief.track_ids.searchsorted(shown.track_ids)
        grades = Grades.empty(*shown.measured.shape)
        grade(held_constants(self.model), rows, known_of(belief), shown.covariance_m2, grades)
        passed_s = belief.time_s - memory.belief.time_s
        lasting = memory.lasting.after(grades.share_of_biases(), passed_s)
        sigma_m = np.empty(shown.measured.shape)
        factor = grow(AT_ONCE * lasting.excess, shown.covariance_m2, grades, sigma_m)
        newest = shown.track_ids, shown.joints_m
        history, looks = memory.history.after(*newest), memory.looks
        if any(view.unchanged_s <= 0 for view in views.values()):
            same = looks.history is memory.history  # while every slot has a look
            looks = Looks(
                history if same else looks.history.after(*newest),
                np.append(looks.times_s[1:], belief.time_s),
            )
        people = People.unchecked(
            shown.joints_m,
            shown.scores,
            track_ids=everybody[rows],
            measured=shown.measured,
            sigma_m=sigma_m,
            full_covariance_m2=grades.stated_m2,
            dynamics=shown.dynamics,
        )
        estimate = Estimate(
            people,
            History(people.track_ids, history.joints_m),
            {"estimate": clock() - start},
            learned_noise.found(belief.noise, self.model.noise.weight),
            posterior_of(memory.belief, belief, rows, grades, lasting.excess),
        )
        factor = factor or stated_factor(belief)
        return FilterMemory(belief, identities, history, looks, factor, lasting), estimate

    def steer(self, memory: FilterMemory, predictor: Predictor, interval_s: float) -> FilterMemory:
        """See `Estimator.steer`; of a predictor that states its errors, which is a learned one."""
        belief, looks, history = memory.belief, memory.looks, memory.history
        pace = looks.pace(interval_s)
        if pace > 1 and looks.times_s[-1] != belief.time_s:
            return memory  # until the next look
        pace_s = pace * interval_s
        history_m = history.joints_m if pace == 1 else looks.evenly_m(pace_s)
        prediction = predictor.predict(history_m, pace_s, STEER_SLOTS)
        joints_m, shares = foreseen(self.model, history_m, prediction, pace_s)
        rows, ahead_s = belief.track_ids.searchsorted(history.track_ids), STEER_SLOTS * pace_s
        gain = 1 - (1 - GAIN) ** pace  # as far as in so many slots
        belief = steer(self.model.tree, belief, rows, joints_m, ahead_s, shares, gain)
        return changed(memory, belief=belief)

    def leave_out_ids(self, memory: FilterMemory, count: int) -> FilterMemory:
        """See `Estimator.leave_out_ids`."""
        belief = replace(memory.belief, next_id=memory.belief.next_id + count)
        return replace(memory, belief=belief)

    def forget_people(self, memory: FilterMemory) -> FilterMemory:
        """See `Estimator.forget_people`."""
        belief = memory.belief.without_people()
        return replace(self.begin(), belief=belief, lasting=memory.lasting)

    def outlook(self, memory: FilterMemory, ahead_s: float) -> Outlook:
        """See `Estimator.outlook`."""
        belief = memory.belief
        track_ids = memory.identities.of(belief.track_ids)
        share = memory.lasting.share
        return outlook(self.model, belief, ahead_s, track_ids, memory.factor, share)


def _next_id(before: Belief, belief: Belief) -> int:
    """Return the number of the next newcomer: the last ones are free again if nobody had them.

    Of the tracks that ended in this slot, those never confirmed were never shown.
    """
    shown = {*belief.track_ids.tolist(), *before.track_ids[before.confirmed].tolist()}
    unseen = {*range(before.next_id, belief.next_id), *before.track_ids.tolist()} - shown
    number = belief.next_id
    while number - 1 in unseen:
        number -= 1
    return number


def steer(
    tree: Tree,
    belief: Belief,
    rows: Integers,
    joints_m: Floats,
    ahead_s: float,
    drift_share: Floats | float = 1.0,
    gain: float = GAIN,
) -> Belief:
    """Return the belief steered part of the way to a prediction, with less process noise.

    Positions and covariances stay: they come from views. The velocity carries the difference
    on into later slots, and views correct it as they correct any velocity.

    Args:
        tree: of the skeleton; joints move beside their parents.
        belief: of now.
        rows: `(num_steered,)` of its tracks.
        joints_m: `(num_steered, num_joints, 3)` where else they are expected; NaN leaves a joint.
        ahead_s: in how many seconds.
        drift_share: `(num_steered, num_joints)` of the process noise that is left until the next
            call (`foreseen`), apart from their agility; all of it for joints that are left.
        gain: the part of the way.
    """
    shares = np.ones_like(belief.drift_share)
    if ahead_s <= 0:
        return replace(belief, drift_share=shares)
    state = belief.state.copy()
    left = np.empty(joints_m.shape[:2])
    left[:] = drift_share
    steer_all(
        float(ahead_s),
        gain,
        tree.order,
        tree.parents,
        tree.lasts_s,
        rows,
        np.ascontiguousarray(joints_m),
        left,
        belief.agility,
        state,
        shares,
    )
    return changed(belief, state=state, drift_share=shares)


def foreseen(
    model: Model, history_m: Floats, prediction: Prediction, interval_s: float
) -> tuple[Floats, Floats]:
    """Return the predicted positions and remaining variances that `steer` needs.

    A predictor that says how fast its error grows says what it does not foresee: its share of what
    the filter's own motion leaves open between the first slot to come and the second.

    Args:
        model: of the filter.
        history_m: `(num_slots, num_steered, num_joints, 3)` metres, NaN where unknown.
        prediction: from that, two slots or more.
        interval_s: seconds per slot.

    Returns:
        `(num_steered, num_joints, 3)` metres after `STEER_SLOTS`, NaN where no error is stated and
        of people with a short history; `(num_steered, num_joints)` the share of the process noise
        that is left, in `[LEAST_SHARE, MOST_SHARE]` of `filter.motion`.
    """
    shape = prediction.joints_m.shape[1:]
    joints_m, shares = np.empty(shape), np.empty(shape[:2])
    foresee_joints(
        history_m,
        prediction.joints_m[STEER_SLOTS - 1],
        prediction.error_m,
        _left_open(model, interval_s),
        joints_m,
        shares,
    )
    return joints_m, shares


@lru_cache(maxsize=64)
def _left_open(model: Model, interval_s: float) -> Floats:
    """Return `(num_joints,)` m2 along an axis that the motion leaves open in the second slot."""
    drift, lasts_s = model.alone
    first, second = (fading(drift, lasts_s, slots * interval_s)[1][..., 0, 0] for slots in (1, 2))
    return np.asarray(second - first)
