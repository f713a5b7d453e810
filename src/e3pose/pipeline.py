"""One slot, left to right: the only loop body, live and in replay.

    views -> estimate -> predict -> occlusion -> select -> the cameras of a slot to come

The state is a value: `step` takes one and returns the next, so that it can be kept, restored and
replayed. Only the estimator and the deficit queues remember.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.energy.queues import advance_deficit, price
from e3pose.estimate.base import STEER_SLOTS, Estimator, People
from e3pose.model.camera import Rig
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.slot_record import Reasons as Reasons
from e3pose.model.slot_record import SlotRecord as SlotRecord
from e3pose.predict.base import Prediction, Predictor
from e3pose.select.expected_information import Foresight, foresee
from e3pose.select.failure_detector import Silence, listen
from e3pose.select.feedback import expected_in_views, reach_m
from e3pose.select.motion_2d import LastView, own_occlusion, with_view
from e3pose.select.occlusion import Spread, expected_views
from e3pose.select.own_check import TURNS, OwnCheck, distance_m
from e3pose.select.policies.base import Policy, Selection, Situation, selected_by, turns_of
from e3pose.select.stated_error import StatedError


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
        budget: `(num_cameras,)` the paper's E_n.
        cost_j: `(num_cameras,)` energy of an active slot beyond that of an idle one; only its
            proportions matter here, and the paper has it 1 for all.
        lead_slots: the paper's tau, at least 1.
        warmup_slots: the paper's M, the slots at the start in which every camera detects.
        holds: show the poses of the slot before in slots for which no camera was selected.
        foresees: compute the information expected of each camera.
        steering: the predictor that steers the estimator, as far as it states its errors; None
            leaves the estimator alone.
        own_boxes: whether the policy uses the cameras' own 2D predictions.
        as_published: charge the queue alone, eq. (9), whatever cameras cost, and decide first in
            slot M, for slot M + tau, as Algorithm 1 does.
        waking: makes the policy for another number of cameras per slot; None where it has none.
        whole_every: cameras get expected views, except that one of so many detections uses the
            full frame; 0 sends none.
        clock: seconds, for stage times only.
    """

    rig: Rig
    num_joints: int
    interval_s: float
    estimator: Estimator[Any]
    predictor: Predictor
    policy: Policy
    budget: Floats
    clock: Callable[[], float]
    cost_j: Floats | None = None
    lead_slots: int = 1
    warmup_slots: int = 10
    holds: bool = False
    foresees: bool = False
    steering: Predictor | None = None
    own_boxes: bool = True
    as_published: bool = False
    waking: Callable[[float], Policy] | None = None
    whole_every: int = 0

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
        shown: the people of the slot before; None before the first.
        stated: how large errors the estimator stated in the last seconds, after the warm-up.
        focused: `(num_cameras,)` looks since each camera looked at all of its image.
        check: what the policy's check on itself has found.
    """

    slot: int
    selections: NDArray[np.bool_]
    deficit: Floats
    silence: Silence
    memory: Any
    last_views: tuple[LastView, ...]
    spread: Spread = field(default_factory=Spread)
    shown: People | None = None
    stated: StatedError = field(default_factory=StatedError)
    focused: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    check: OwnCheck = field(default_factory=OwnCheck)


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
    )


def step(
    pipeline: Pipeline,
    state: SlotState,
    views: Mapping[int, Poses2D],
    online: Selection,
    publish: Callable[[People], None] = lambda people: None,
) -> tuple[SlotState, SlotRecord]:
    """Advance one slot (paper Algorithm 1).

    Args:
        pipeline: the parts.
        state: what the slot before handed over.
        views: camera index to its view in `state.slot`; views without an order are ignored.
        online: `(num_cameras,)` cameras that can be reached.
        publish: called with the people of this slot as soon as they are estimated, before cameras
            are selected for a later one.

    Returns:
        The next state and the record of this slot, with the selection for `slot + lead_slots`.
    """
    slot, clock = state.slot, pipeline.clock
    selected = state.selections[0] & online
    views = {camera: view for camera, view in views.items() if selected[camera]}
    memory, people = pipeline.estimator.estimate(
        state.memory, views, slot * pipeline.interval_s, clock
    )
    shown = _shown(pipeline, state, people, selected)
    publish(shown)
    times = [clock()]

    memory, predicted_m, best = _predict(pipeline, memory, people.history_m)
    times.append(clock())

    arrived = np.array([camera in views for camera in range(len(online))])
    silence = listen(state.silence, slot, selected, arrived, pipeline.interval_s)
    occlusion, visibility = expected_views(pipeline.rig, predicted_m)
    spread = state.spread.after(occlusion, pipeline.interval_s)
    state = _judged(pipeline, state, views, people)
    state = replace(state, memory=memory, silence=silence, spread=spread)
    last_views = _with_views(pipeline, state.last_views, views, slot)
    ordered = _in_flight(pipeline, state, online)
    times.append(clock())

    foresight = _foresight(pipeline, state, ordered)
    situation = _situation(
        pipeline, state, (occlusion, visibility), last_views, online, ordered, foresight
    )
    warming_up = (slot if pipeline.as_published else situation.slot) < pipeline.warmup_slots
    decision, deficit = _decide(pipeline, state.check, situation, online, warming_up)
    focused, expected = _feedback(pipeline, state, warming_up, decision, best, people.history_ids)
    times.append(clock())
    record = SlotRecord(
        slot=slot,
        time_s=slot * pipeline.interval_s,
        selected=selected,
        arrived=arrived,
        poses=shown.poses,
        track_ids=shown.track_ids,
        occlusion=situation.occlusion,
        deficit=deficit,
        next_selection=decision,
        covariance_m2=shown.covariance_m2,
        measured=shown.measured,
        reasons=_reasons(situation, decision, state.check),
        stage_s={**people.stage_s, **_spent_s(times)},
        noise_factors=people.noise_factors,
        shifts_px=people.shifts_px,
        expected=expected,
        dynamics=shown.dynamics,
    )
    after = replace(
        state,
        slot=slot + 1,
        selections=np.concatenate([state.selections[1:], decision[None]]),
        deficit=deficit,
        last_views=last_views,
        shown=shown,
        focused=focused,
    )
    return after, record


def _shown(pipeline: Pipeline, state: SlotState, people: People, selected: Selection) -> People:
    """Return the people to publish: those of the slot before where no camera was selected."""
    if pipeline.holds and not selected.any() and state.shown is not None:
        return replace(state.shown, measured=np.zeros_like(state.shown.measured))
    return people


def _decide(
    pipeline: Pipeline, check: OwnCheck, situation: Situation, online: Selection, warming_up: bool
) -> tuple[Selection, Floats]:
    """Return the cameras of the slot that is decided now, and the virtual queues after it."""
    if warming_up:
        return np.array(online), situation.deficit  # Algorithm 1: not charged
    turns = turns_of(pipeline.policy)
    plan = check.plan(situation.slot, pipeline.interval_s, len(online))
    by_turns = turns is not None and (plan.common or plan.way == TURNS)
    decision = selected_by(turns if turns and by_turns else pipeline.policy, situation)
    return decision, advance_deficit(situation.deficit, pipeline.budget, decision)


def _spent_s(times: Sequence[float]) -> dict[str, float]:
    """Return the seconds of each stage by the times at which the first began and each ended."""
    ends = zip(("predict", "occlusion", "select"), pairwise(times), strict=True)
    return {stage: end - begin for stage, (begin, end) in ends}


def _predict(pipeline: Pipeline, memory: Any, history_m: Floats) -> tuple[Any, Floats, Prediction]:
    """Steer the estimator.

    Returns:
        What it remembers, where the policy's predictor has people in the slot decided, and the
        prediction of the better predictor, which steers where one does.
    """
    predictor, steering = pipeline.predictor, pipeline.steering
    both = steering is predictor
    ahead = max(pipeline.lead_slots, STEER_SLOTS * both)
    prediction = best = predictor.predict(history_m, pipeline.interval_s, ahead)
    if steering is not None:
        if not both:
            soon = max(STEER_SLOTS, pipeline.lead_slots * (pipeline.whole_every > 0))
            best = steering.predict(history_m, pipeline.interval_s, soon)
        memory = pipeline.estimator.steer(memory, best, pipeline.interval_s)
    return memory, prediction.joints_m[pipeline.lead_slots - 1], best


def _feedback(
    pipeline: Pipeline,
    state: SlotState,
    warming_up: bool,
    decision: Selection,
    best: Prediction,
    predicted_ids: NDArray[np.int64],
) -> tuple[NDArray[np.int64], tuple[ExpectedView, ...] | None]:
    """Return slots since each camera's last full-frame detection, and the expected views.

    Once one selected camera is due for full-frame detection, all of them are: two must see a
    newcomer at about the same time. Tracks that are not published yet, as too few cameras have seen
    them, are expected as well; otherwise only full-frame detection would find them.
    """
    if not pipeline.whole_every:
        return state.focused, None
    due = decision & (state.focused >= pipeline.whole_every - 1)
    if due.any() or warming_up:
        return np.where(decision, 0, state.focused), None
    ahead_s = pipeline.lead_slots * pipeline.interval_s
    outlook = pipeline.estimator.outlook(state.memory, ahead_s)
    hidden_m = outlook.joints_m[~np.isin(outlook.track_ids, predicted_ids)]
    joints_m = np.concatenate([best.joints_m[pipeline.lead_slots - 1], hidden_m])
    if not len(joints_m):
        return np.where(decision, 0, state.focused), None
    unknown_m = np.full(hidden_m.shape[:2], np.nan)
    error_m = np.concatenate([best.error_m[pipeline.lead_slots - 1], unknown_m])
    expected = expected_in_views(pipeline.rig, joints_m, reach_m(error_m, ahead_s))
    return state.focused + decision, expected


def _stated(pipeline: Pipeline, state: SlotState, people: People) -> StatedError:
    """Return `SlotState.stated` after this slot, where the policy asks for it."""
    if not pipeline.foresees or state.slot < pipeline.warmup_slots:
        return state.stated
    return state.stated.after(people.covariance_m2, pipeline.interval_s)


def _judged(
    pipeline: Pipeline, state: SlotState, views: Mapping[int, Poses2D], people: People
) -> SlotState:
    """Return the state with `stated`, and with `check` where the policy has turns, of this slot."""
    check, interval_s = state.check, pipeline.interval_s
    plan = check.plan(state.slot, interval_s, len(pipeline.rig))
    seen_m = error_m = np.nan
    if plan.counts and turns_of(pipeline.policy) is not None:
        outlook = pipeline.estimator.outlook(state.memory, interval_s)
        seen_m = distance_m(pipeline.rig, outlook, views, state.selections[0])
        error_m = StatedError().after(people.covariance_m2, interval_s).mean_m or np.nan
    check = check.after(state.slot, interval_s, plan.way, seen_m, error_m)
    return replace(state, stated=_stated(pipeline, state, people), check=check)


def _situation(
    pipeline: Pipeline,
    state: SlotState,
    views: tuple[Floats, Floats],
    last_views: tuple[LastView, ...],
    online: Selection,
    ordered: NDArray[np.bool_],
    foresight: Foresight | None,
) -> Situation:
    """Collect the input of the policy for the slot that is decided now."""
    target = state.slot + pipeline.lead_slots
    occlusion, visibility = views
    cost_j = None if pipeline.as_published else pipeline.cost_j
    return Situation(
        slot=target,
        interval_s=pipeline.interval_s,
        online=online & state.silence.answering(target),
        occlusion=occlusion,
        spread=state.spread.mean,
        own_occlusion=own_occlusion(last_views, target, pipeline.rig)
        if pipeline.own_boxes
        else np.full(len(online), np.nan),
        unseen_slots=target - _last_view_slots(last_views, ordered, state.slot + 1),
        visibility=visibility,
        deficit=state.deficit,
        budget=pipeline.budget,
        price=state.deficit if cost_j is None else price(state.deficit, cost_j),
        foresight=foresight,
        stated=state.stated,
    )


def _in_flight(pipeline: Pipeline, state: SlotState, online: Selection) -> NDArray[np.bool_]:
    """Return `(lead_slots - 1, num_cameras)`: views expected in the next slots.

    Cameras that were ordered and have since been given up will not look.
    """
    ordered = state.selections[1:]
    slots = np.arange(state.slot + 1, state.slot + 1 + len(ordered))
    return np.asarray(ordered & online & state.silence.answering(slots[:, None]))


def _last_view_slots(
    last_views: tuple[LastView, ...], ordered: NDArray[np.bool_], next_slot: int
) -> NDArray[np.int64]:
    """Return `(num_cameras,)`: the slot of each camera's last detection, ordered ones included."""
    newest = [last.slot for last in last_views]
    for slot, cameras in enumerate(ordered.tolist(), start=next_slot):
        newest = [slot if active else last for active, last in zip(cameras, newest, strict=True)]
    return np.array(newest, dtype=np.int64)


def _foresight(
    pipeline: Pipeline, state: SlotState, ordered: NDArray[np.bool_]
) -> Foresight | None:
    """Compute the information of each camera in the slot that is decided now, if it is used."""
    if not pipeline.foresees:
        return None
    ahead_s = pipeline.lead_slots * pipeline.interval_s
    outlook = pipeline.estimator.outlook(state.memory, ahead_s)
    return foresee(pipeline.rig, outlook, pipeline.interval_s, ordered)


def _reasons(situation: Situation, decision: Selection, check: OwnCheck) -> Reasons | None:
    foresight = situation.foresight
    if foresight is None:
        return None
    gains_nats = foresight.gains_nats(decision)
    error_m = float(foresight.expected_error_m(decision[None])[0])
    return Reasons(situation.slot, gains_nats, situation.price, error_m, check.words())


def _with_views(
    pipeline: Pipeline, last_views: tuple[LastView, ...], views: Mapping[int, Poses2D], slot: int
) -> tuple[LastView, ...]:
    if not pipeline.own_boxes:
        return tuple(s.at(slot) if index in views else s for index, s in enumerate(last_views))
    return tuple(
        with_view(last, views[index], slot, camera.image_size) if index in views else last
        for index, (last, camera) in enumerate(zip(last_views, pipeline.rig.cameras, strict=True))
    )
