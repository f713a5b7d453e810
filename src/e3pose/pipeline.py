"""One slot, left to right: the only loop body, live and in replay.

    views -> estimate -> predict -> occlusion -> select -> the cameras of a slot to come

The state is a value: `step` takes one and returns the next, so that it can be kept, restored and
replayed. Only the estimator and the deficit queues remember.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.camera import Rig
from e3pose.energy import advance_deficit
from e3pose.estimators.base import Estimator, People
from e3pose.occlusion import expected_views
from e3pose.policies.base import Policy, Selection, Situation
from e3pose.pose import Poses2D, Poses3D
from e3pose.predictors.base import Predictor
from e3pose.sight import Sight, look, own_occlusion

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Pipeline:
    """The parts of a running system, which do not change from slot to slot.

    Attributes:
        rig: the cameras.
        num_joints: joints of the detectors' skeleton.
        interval_s: seconds a slot.
        estimator: says who is where, with or without a memory.
        predictor: looks `lead_slots` ahead.
        policy: selects.
        budget: `(num_cameras,)` the paper's E_n.
        lead_slots: the paper's tau, at least 1.
        warmup_slots: the paper's M, the slots at the start in which every camera detects.
        holds: show the poses of the slot before in slots for which no camera was selected.
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
    lead_slots: int = 1
    warmup_slots: int = 10
    holds: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class SlotState:
    """Everything that one slot hands to the next.

    Attributes:
        slot: the slot to come.
        selections: `(lead_slots, num_cameras)` decided for `slot` and the slots after it.
        deficit: `(num_cameras,)` the virtual queues before the next decision.
        memory: what the estimator remembers.
        sights: what every camera remembers of its own views.
        shown: the people of the slot before; None before the first.
    """

    slot: int
    selections: NDArray[np.bool_]
    deficit: Floats
    memory: Any
    sights: tuple[Sight, ...]
    shown: People | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SlotRecord:
    """What one slot left behind.

    Attributes:
        slot: index of the slot.
        time_s: its time since the start.
        selected: `(num_cameras,)` cameras that were ordered to detect in this slot and were online.
        arrived: `(num_cameras,)` selected cameras whose view came.
        poses: the people estimated, world metres.
        track_ids: `(num_persons,)` their identities.
        occlusion: `(num_cameras,)` paper eq. (4) predicted for slot + lead.
        deficit: `(num_cameras,)` queues after the decision for slot + lead.
        next_selection: `(num_cameras,)` the decision for slot + lead.
        covariance_m2: `(num_persons, num_joints, 3, 3)` of the joints of `poses`; NaN if unknown.
        measured: `(num_persons, num_joints)` whether a view of this slot measured the joint.
        stage_s: seconds spent in the estimator's stages, predict, occlusion, select.
    """

    slot: int
    time_s: float
    selected: Selection
    arrived: Selection
    poses: Poses3D
    track_ids: NDArray[np.int64]
    occlusion: Floats
    deficit: Floats
    next_selection: Selection
    covariance_m2: Floats = field(default_factory=lambda: np.zeros((0, 0, 3, 3)))
    measured: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))
    stage_s: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shape = self.poses.scores.shape
        if self.measured.shape != shape:  # whoever made the record does not know
            object.__setattr__(self, "covariance_m2", np.full((*shape, 3, 3), np.nan))
            object.__setattr__(self, "measured", self.poses.scores > 0)


def initial_state(pipeline: Pipeline) -> SlotState:
    """Return the state before slot 0: no tracks, empty queues, all cameras ordered."""
    num_cameras = len(pipeline.rig)
    return SlotState(
        slot=0,
        selections=np.ones((pipeline.lead_slots, num_cameras), dtype=bool),
        deficit=np.zeros(num_cameras),
        memory=pipeline.estimator.begin(),
        sights=(Sight.none(),) * num_cameras,
    )


def step(
    pipeline: Pipeline, state: SlotState, views: Mapping[int, Poses2D], online: Selection
) -> tuple[SlotState, SlotRecord]:
    """Advance one slot (paper Algorithm 1).

    Args:
        pipeline: the parts.
        state: what the slot before handed over.
        views: camera index to what it saw in `state.slot`; views that were not ordered are ignored.
        online: `(num_cameras,)` cameras that can be reached.

    Returns:
        The next state and the record of this slot, with the selection for `slot + lead_slots`.
    """
    slot, clock = state.slot, pipeline.clock
    selected = state.selections[0] & online
    views = {camera: view for camera, view in views.items() if selected[camera]}
    memory, people = pipeline.estimator.estimate(
        state.memory, views, slot * pipeline.interval_s, clock
    )
    shown = people
    if pipeline.holds and not selected.any() and state.shown is not None:
        shown = replace(state.shown, measured=np.zeros_like(state.shown.measured))
    times = [clock()]

    prediction = pipeline.predictor.predict(
        people.history_m, pipeline.interval_s, pipeline.lead_slots
    )
    times.append(clock())

    sights = _look(pipeline.rig, state.sights, views, slot)
    situation = _situation(pipeline, state, prediction.joints_m[-1], sights, online)
    times.append(clock())

    if situation.slot < pipeline.warmup_slots:
        decision, deficit = np.array(online), state.deficit
    else:
        decision = pipeline.policy.select(situation)
        deficit = advance_deficit(state.deficit, pipeline.budget, decision)
    times.append(clock())

    arrived = np.zeros(len(online), dtype=bool)
    arrived[list(views)] = True
    stages = ("predict", "occlusion", "select")
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
        stage_s={**people.stage_s, **dict(zip(stages, np.diff(times).tolist(), strict=True))},
    )
    selections = np.concatenate([state.selections[1:], decision[None]])
    return SlotState(slot + 1, selections, deficit, memory, sights, shown), record


def _situation(
    pipeline: Pipeline,
    state: SlotState,
    predicted_m: Floats,
    sights: tuple[Sight, ...],
    online: Selection,
) -> Situation:
    """Gather what a policy may know about the slot that is decided now."""
    target = state.slot + pipeline.lead_slots
    occlusion, visibility = expected_views(pipeline.rig, predicted_m)
    return Situation(
        slot=target,
        interval_s=pipeline.interval_s,
        online=online,
        occlusion=occlusion,
        own_occlusion=np.array(
            [
                own_occlusion(sight, target, camera.image_size)
                for sight, camera in zip(sights, pipeline.rig.cameras, strict=True)
            ]
        ),
        unseen_slots=np.array([target - sight.slot for sight in sights], dtype=np.int64),
        visibility=visibility,
        deficit=state.deficit,
        budget=pipeline.budget,
    )


def _look(
    rig: Rig, sights: tuple[Sight, ...], views: Mapping[int, Poses2D], slot: int
) -> tuple[Sight, ...]:
    return tuple(
        look(sight, views[index], slot, camera.image_size) if index in views else sight
        for index, (sight, camera) in enumerate(zip(sights, rig.cameras, strict=True))
    )
