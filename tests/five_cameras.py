"""Two people among five cameras in a ring, and a loop for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from tests.estimate.filter.room import BODY
from tests.rigs import around

from e3pose.energy.queues import Queue
from e3pose.estimate.per_slot.estimator import PerSlot
from e3pose.estimate.per_slot.fuse import Fuser
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.pipeline import Pipeline, SlotRecord, initial_state, step
from e3pose.predict import make_predictor
from e3pose.select.policies import POLICIES, Need, PolicySettings, Selection, Situation

SIMULATED = load_noise("simulated")
NUM_CAMERAS, NUM_JOINTS = 5, 17
FORESIGHT = frozenset({Need.FORESIGHT})
BUDGET = np.full(NUM_CAMERAS, 0.6)
ONLINE = np.ones(NUM_CAMERAS, dtype=bool)


RIG = around(np.linspace(0, 2 * np.pi, NUM_CAMERAS, endpoint=False), 4.0, 2.0, "cam")


def scene(slot: int) -> dict[int, Poses2D]:
    """Two people, one of them walking, seen exactly by all cameras."""
    people = np.stack([BODY, BODY + [0.8, 0.02 * slot, 0]])
    return {
        index: Poses2D(camera.project(people), np.ones((2, NUM_JOINTS)))
        for index, camera in enumerate(RIG.cameras)
    }


def make(name: str = "e3pose", **changes: object) -> Pipeline:
    pipeline = Pipeline(
        rig=RIG,
        num_joints=NUM_JOINTS,
        interval_s=0.04,
        estimator=PerSlot(Fuser(RIG, NUM_JOINTS), NUM_JOINTS, 0.04, SIMULATED, 4),
        predictor=make_predictor("constant-velocity"),
        policy=POLICIES[name].make(PolicySettings(num_selected=2)),
        queue=Queue(BUDGET),
        clock=lambda: 0.0,
        lead_slots=2,
        warmup_slots=4,
        needs=POLICIES[name].needs | {Need.OWN_BOXES},
    )
    return replace(pipeline, **changes)  # type: ignore[arg-type]


def run(
    pipeline: Pipeline, views: Sequence[Mapping[int, Poses2D]], online: Selection = ONLINE
) -> list[SlotRecord]:
    state, records = initial_state(pipeline), []
    for slot_views in views:
        state, record = step(pipeline, state, slot_views, online)
        records.append(record)
    return records


@dataclass
class Recorder:
    """A policy that keeps what it was shown."""

    seen: list[Situation]

    def select(self, situation: Situation) -> Selection:
        self.seen.append(situation)
        return np.arange(NUM_CAMERAS) < 2
