"""Who foresees the people for the policy, and who steers the estimator."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from tests.five_cameras import (
    FORESIGHT,
    NUM_CAMERAS,
    RIG,
    SIMULATED,
    make,
    run,
    scene,
)

from e3pose.base.arrays import Floats
from e3pose.estimate.base import STEER_SLOTS
from e3pose.estimate.filter import Model
from e3pose.estimate.filter.estimator import Filtered
from e3pose.estimate.filter.step import StepKernel
from e3pose.model.skeleton import COCO17
from e3pose.pipeline import SlotRecord
from e3pose.predict import Prediction
from e3pose.select.policies import Selection, Situation


@dataclass
class Shifting:
    """Foresees everybody aside in two slots and where they are in one; selects the same cameras.

    Attributes:
        error_m: that it states.
        shift_m: how far aside.
        slots_asked: how far it was asked to look ahead.
        situations: in which it selected.
    """

    error_m: float
    shift_m: float
    slots_asked: list[int] = field(default_factory=list)
    situations: list[Situation] = field(default_factory=list)

    def select(self, situation: Situation) -> Selection:
        self.situations.append(situation)
        return np.arange(NUM_CAMERAS) < 2

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        self.slots_asked.append(lead_slots)
        joints = np.repeat(history_m[-1:], lead_slots, axis=0)
        joints[1:] += [self.shift_m, 0.0, 0.0]
        return Prediction(joints, np.full(joints.shape[:-1], self.error_m))


def run_shifting(
    error_m: float, lead_slots: int, shift_m: float = 0.2, steers: bool = True
) -> tuple[Shifting, list[SlotRecord]]:
    both = Shifting(error_m, shift_m)
    pipeline = make(
        policy=both,
        predictor=both,
        needs=FORESIGHT,
        steering=both if steers else None,
        lead_slots=lead_slots,
        estimator=Filtered(Model(RIG, COCO17, SIMULATED), StepKernel(), 5),
    )
    return both, run(pipeline, [scene(slot) for slot in range(12)])


def test_a_predictor_of_the_policy_alone_does_not_steer() -> None:
    (_, unsteered), (_, plain) = (
        run_shifting(0.05, 3, steers=False),
        run_shifting(np.nan, 3),
    )
    for one, other in zip(unsteered, plain, strict=True):
        np.testing.assert_array_equal(one.people.joints_m, other.people.joints_m)


def test_a_predictor_that_states_its_error_steers_the_estimator_and_feeds_the_choice() -> None:
    (stating, steered), (silent, plain) = (run_shifting(e, 3) for e in (0.05, np.nan))
    assert [len(record.people) for record in steered] == [len(record.people) for record in plain]
    aside = steered[-1].people.joints_m[:, :, 0] - plain[-1].people.joints_m[:, :, 0]
    assert (aside > 0).mean() > 0.95  # towards what was foreseen, as far as views allow
    published, untold = (each.situations[-1].foresight for each in (stating, silent))
    assert published is not None and untold is not None
    assert not np.allclose(published.views, untold.views, rtol=1e-3)


def test_policies_see_the_slot_decided_although_the_estimator_needs_two_ahead() -> None:
    (one, _), (two, _) = (run_shifting(np.nan, lead, shift_m=1000.0) for lead in (1, 2))
    assert set(one.slots_asked) == set(two.slots_asked) == {STEER_SLOTS}
    assert (one.situations[-1].visibility > 0.5).all()
    assert (two.situations[-1].visibility == 0).all()
