"""One slot, left to right: the only loop body, live and in replay.

    views -> estimate -> predict -> occlusion -> select -> the cameras of a slot to come

The state is a value: `step` takes one and returns the next, so that it can be kept, restored and
replayed. Only the estimator and the deficit queues remember.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.base.records import changed
from e3pose.energy.queues import Queue
from e3pose.estimate.base import Estimate, Estimator
from e3pose.model.camera import Rig
from e3pose.model.expected import ExpectedView
from e3pose.model.look_request import NO_REQUEST, LookRequest
from e3pose.model.people import People
from e3pose.model.pose import Poses2D
from e3pose.model.slot_record import Reasons as Reasons
from e3pose.model.slot_record import SlotRecord as SlotRecord
from e3pose.predict.base import Prediction, Predictor
from e3pose.select.awake import RestPlanner
from e3pose.select.expected_information import Foresight, foresee
from e3pose.select.failure_detector import Silence, listen
from e3pose.select.feedback import Feedback, expected_people, focused_after
from e3pose.select.motion_2d import LastView, last_slots, own_occlusion, with_views
from e3pose.select.occlusion import Spread, expected_views
from e3pose.select.policies.base import (
    Need,
    Policy,
    Selection,
    Situation,
    selected_by,
)
from e3pose.select.requested import with_requested
from e3pose.select.rest_plan import RestMemory
from e3pose.select.stated_error import StatedError, stated_error_m


@dataclass(frozen=True, slots=True, eq=False)
class Pipeline:
    """The parts of a running system, which do not change from slot to slot.

    Attributes:
        rig: the cameras.
        num_joints: joints of the detectors' skeleton.
        interval_s: seconds per slot.
        estimator: says who is where, with or without a memory.
        predictor: foresees the people for the policy.
        policy: selects.
        queue: what cameras may spend.
        clock: seconds, for stage times only.
        lead_slots: the paper's tau, at least 1.
        warmup_slots: the paper's M, the slots at the start in which every camera detects.
        needs: what the policy needs, and what else is to be computed for who looks on.
        steering: the predictor that steers the estimator, where it states its errors, or None.
        feedback: tells cameras whom to expect; None tells them nothing.
        waking: makes the policy for another number of cameras per slot; None where it has none.
        rests: says who sleeps; None keeps every camera awake.
        request: looks that consumers of records ask for.
    """

    rig: Rig
    num_joints: int
    interval_s: float
    estimator: Estimator[Any]
    predictor: Predictor
    policy: Policy
    queue: Queue
    clock: Callable[[], float]
    lead_slots: int = 1
    warmup_slots: int = 10
    needs: frozenset[Need] = frozenset()
    steering: Predictor | None = None
    feedback: Feedback | None = None
    waking: Callable[[float], Policy] | None = None
    rests: RestPlanner | None = None
    request: LookRequest = NO_REQUEST

    @property
    def ahead_s(self) -> float:
        """Seconds from the newest slot to the one that is decided."""
        return self.lead_slots * self.interval_s

    def with_predictor(self, predictor: Predictor) -> Pipeline:
        """Return the pipeline with another predictor, which steers where one did."""
        steering = None if self.steering is None else predictor
        return replace(self, predictor=predictor, steering=steering)


@dataclass(frozen=True, slots=True, eq=False)
class SlotState:
    """The state passed from slot to slot.

    Attributes:
        slot: the slot to come.
        selections: `(lead_slots, num_cameras)` decided for `slot` and the slots after it.
        deficit: `(num_cameras,)` the virtual queues before the next decision.
        silence: which cameras do not answer.
        memory: what the estimator remembers.
        last_views: what every camera remembers of its own views.
        spread: of the occlusion over cameras, as far as it was foreseen.
        shown: the estimate that was published in the slot before; None before the first.
        stated: how large errors the estimator stated in the last seconds, after the warm-up.
        focused: `(num_cameras,)` looks since each camera looked at all of its image.
        asleep_until: `(num_cameras,)` slot from which each camera is awake; over or 0: it is.
        rest: what the plan of rests remembers.
    """

    slot: int
    selections: NDArray[np.bool_]
    deficit: Floats
    silence: Silence
    memory: Any
    last_views: tuple[LastView, ...]
    spread: Spread = field(default_factory=Spread)
    shown: Estimate | None = None
    stated: StatedError = field(default_factory=StatedError)
    focused: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    asleep_until: Integers = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    rest: RestMemory = field(default_factory=lambda: RestMemory.none(0))


def initial_state(pipeline: Pipeline) -> SlotState:
    """Return the state before slot 0: no tracks, empty queues, all cameras ordered."""
    num_cameras = len(pipeline.rig)
    return SlotState(
        slot=0,
        selections=np.ones((pipeline.lead_slots, num_cameras), dtype=bool),
        deficit=np.zeros(num_cameras),
        silence=Silence.none(num_cameras),
        memory=pipeline.estimator.begin(),
        last_views=(LastView.none(),) * num_cameras,
        focused=np.zeros(num_cameras, dtype=np.int64),
        asleep_until=np.zeros(num_cameras, dtype=np.int64),
        rest=RestMemory.none(num_cameras),
    )


def step(
    pipeline: Pipeline,
    state: SlotState,
    views: Mapping[int, Poses2D],
    online: Selection,
    publish: Callable[[Estimate], None] = lambda estimate: None,
) -> tuple[SlotState, SlotRecord]:
    """Advance one slot (paper Algorithm 1).

    Args:
        pipeline: the parts.
        state: of the slot before.
        views: camera index to its view in `state.slot`; views without an order are ignored.
        online: `(num_cameras,)` cameras that can be reached.
        publish: called with the estimate of this slot before cameras are selected for a later one.

    Returns:
        The next state and the record of this slot, with the selection for `slot + lead_slots`.
    """
    slot, clock, time_s = state.slot, pipeline.clock, state.slot * pipeline.interval_s
    selected = state.selections[0] & online
    views = {camera: view for camera, view in views.items() if selected[camera]}
    memory, estimate = pipeline.estimator.estimate(state.memory, views, time_s, clock)
    shown = _shown(pipeline, state, estimate, selected)
    publish(shown)
    times = [clock()]

    memory, predicted_m, best = _predict(pipeline, memory, estimate.history.joints_m)
    times.append(clock())

    arrived = np.array([camera in views for camera in range(len(online))])
    occlusion, visibility = expected_views(pipeline.rig, predicted_m)
    with_boxes = pipeline.rig if Need.OWN_BOXES in pipeline.needs else None
    state = changed(
        state,
        memory=memory,
        silence=listen(state.silence, slot, selected, arrived, pipeline.interval_s),
        spread=state.spread.after(occlusion, pipeline.interval_s),
        stated=_stated(pipeline, state, estimate.people),
        last_views=with_views(state.last_views, views, slot, with_boxes),
    )
    times.append(clock())

    situation = _situation(pipeline, state, occlusion, visibility, online)
    warming_up = (slot if pipeline.queue.as_published else situation.slot) < pipeline.warmup_slots
    decision, spent = np.array(online), (state.deficit, state.asleep_until, state.rest)
    if not warming_up:  # Algorithm 1: not charged before
        decision, spent = _decide(pipeline, state, situation, estimate.people)
    deficit, asleep_until, rest = spent
    followed = estimate.history.track_ids
    focused, expected = _feedback(pipeline, state, warming_up, decision, best, followed)
    times.append(clock())
    record = SlotRecord(
        slot=slot,
        time_s=time_s,
        selected=selected,
        arrived=arrived,
        people=shown.people,
        occlusion=occlusion,
        deficit=deficit,
        next_selection=decision,
        reasons=_reasons(situation, decision, rest.operator_note()),
        stage_s={**estimate.stage_s, **_spent_s(times)},
        noise_factors=estimate.noise_factors,
        expected=expected,
        asleep_until=asleep_until,
    )
    after = changed(
        state,
        slot=slot + 1,
        selections=np.concatenate([state.selections[1:], decision[None]]),
        deficit=deficit,
        shown=shown,
        focused=focused,
        asleep_until=asleep_until,
        rest=rest,
    )
    return after, record


def _shown(
    pipeline: Pipeline, state: SlotState, estimate: Estimate, selected: Selection
) -> Estimate:
    """Return the people to publish: of the slot before where no camera was selected."""
    holds = Need.HELD_POSES in pipeline.needs
    if holds and not selected.any() and state.shown is not None:
        held = state.shown.people
        return replace(state.shown, people=replace(held, measured=np.zeros_like(held.measured)))
    return estimate


def _predict(pipeline: Pipeline, memory: Any, history_m: Floats) -> tuple[Any, Floats, Prediction]:
    """Steer the estimator.

    Returns:
        What it remembers, where the policy's predictor has people in the slot decided, and the
        prediction for feedback. The predictor that steers predicts once more, by other histories.
    """
    predictor, steering = pipeline.predictor, pipeline.steering
    ahead = history_m, pipeline.interval_s, pipeline.lead_slots
    prediction = best = predictor.predict(*ahead)
    if steering is not None:
        if pipeline.feedback is not None and steering is not predictor:
            best = steering.predict(*ahead)
        memory = pipeline.estimator.steer(memory, steering, pipeline.interval_s)
    return memory, prediction.joints_m[-1], best


def _stated(pipeline: Pipeline, state: SlotState, people: People) -> StatedError:
    """Return `SlotState.stated` after this slot, where the policy asks for it."""
    if Need.FORESIGHT not in pipeline.needs or state.slot < pipeline.warmup_slots:
        return state.stated
    return state.stated.after(stated_error_m(people.covariance_m2), pipeline.interval_s)


def _situation(
    pipeline: Pipeline,
    state: SlotState,
    occlusion: Floats,
    visibility: Floats,
    online: Selection,
) -> Situation:
    """Collect the input of the policy for the slot that is decided now."""
    target = state.slot + pipeline.lead_slots
    ordered = state.silence.in_flight(state.selections[1:] & online, state.slot + 1)
    own_boxes = Need.OWN_BOXES in pipeline.needs
    foresight = _foresight(pipeline, state, ordered)
    return Situation(
        slot=target,
        interval_s=pipeline.interval_s,
        online=online & state.silence.answering(target) & (state.asleep_until <= target),
        occlusion=occlusion,
        spread=state.spread.mean,
        own_occlusion=own_occlusion(state.last_views, target, pipeline.rig)
        if own_boxes
        else np.full(len(online), np.nan),
        unseen_slots=target - last_slots(state.last_views, ordered, state.slot + 1),
        visibility=visibility,
        deficit=state.deficit,
        budget=pipeline.queue.budget,
        price=pipeline.queue.price(state.deficit),
        foresight=foresight,
        stated=state.stated,
    )


def _foresight(pipeline: Pipeline, state: SlotState, ordered: Flags) -> Foresight | None:
    """Compute the information of each camera in the slot that is decided now, if it is needed."""
    if Need.FORESIGHT not in pipeline.needs:
        return None
    outlook = pipeline.estimator.outlook(state.memory, pipeline.ahead_s)
    return foresee(pipeline.rig, outlook, pipeline.interval_s, ordered)


def _later(pipeline: Pipeline, state: SlotState, seconds: float) -> Foresight:
    """Return the foresight of people as sure as now, where they are expected later."""
    outlook = pipeline.estimator.outlook(state.memory, pipeline.ahead_s + seconds)
    return foresee(pipeline.rig, outlook, pipeline.interval_s, state.selections[1:])


def _decide(
    pipeline: Pipeline, state: SlotState, situation: Situation, people: People
) -> tuple[Selection, tuple[Floats, Integers, RestMemory]]:
    """Return the cameras of the slot that is decided now.

    Also returns `deficit`, `asleep_until` and `rest` of the state after the decision.
    """
    policy, rests, until = pipeline.policy, pipeline.rests, state.asleep_until
    rest = state.rest
    if rests is not None:
        error_m, asleep = stated_error_m(people.covariance_m2), until > state.slot
        rest = rests.checked(rest, state.slot, situation.interval_s, asleep, error_m)
        later = partial(_later, pipeline, state)
        rest, until = rests.planned(rest, situation, until, later, pipeline.request)
        situation = replace(situation, online=situation.online & (until <= situation.slot))
        policy = pipeline.policy if pipeline.waking is None else pipeline.waking(rest.num_selected)
    decision = selected_by(policy, situation)
    if rests is None:
        decision = with_requested(decision, situation, pipeline.request)
    else:
        rest = rests.charged(rest, decision, until > situation.slot, situation.interval_s)
    return decision, (pipeline.queue.after(state.deficit, decision), until, rest)


def _feedback(
    pipeline: Pipeline,
    state: SlotState,
    warming_up: bool,
    decision: Selection,
    best: Prediction,
    predicted_ids: Integers,
) -> tuple[Integers, tuple[ExpectedView, ...] | None]:
    """Return slots since each camera's last full-frame detection, and the expected views."""
    feedback, lead = pipeline.feedback, pipeline.lead_slots
    if feedback is None:
        return state.focused, None
    expected = None
    if not (warming_up or feedback.is_due(state.focused, decision)):
        ahead_s = pipeline.ahead_s
        expected = expected_people(
            pipeline.rig,
            best.joints_m[lead - 1],
            best.error_m[lead - 1],
            pipeline.estimator.outlook(state.memory, ahead_s),
            predicted_ids,
            ahead_s,
        )
    return focused_after(state.focused, decision, expected), expected


def _reasons(situation: Situation, decision: Selection, words: str) -> Reasons | None:
    foresight = situation.foresight
    if foresight is None:
        return None
    gains_nats = foresight.gains_nats(decision)
    error_m = float(foresight.expected_error_m(decision[None])[0])
    return Reasons(situation.slot, gains_nats, situation.price, error_m, words)


def _spent_s(times: Sequence[float]) -> dict[str, float]:
    """Return the seconds of each stage by the times at which the first began and each ended."""
    ends = zip(("predict", "occlusion", "select"), pairwise(times), strict=True)
    return {stage: end - begin for stage, (begin, end) in ends}
