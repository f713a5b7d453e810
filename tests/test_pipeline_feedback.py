"""The loop tells cameras whom to expect."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.five_cameras import (
    NUM_CAMERAS,
    NUM_JOINTS,
    make,
    run,
    scene,
)

from e3pose.base.arrays import Floats
from e3pose.model.pose import Poses2D
from e3pose.predict import Prediction
from e3pose.select.feedback import Feedback, expected_people


def test_nobody_is_reported_anybody_without_feedback() -> None:
    records = run(make("all"), [scene(slot) for slot in range(20)])
    assert all(record.expected is None for record in records)


def test_cameras_are_reported_whom_to_expect_but_for_one_look_in_so_many() -> None:
    records = run(make("all", feedback=Feedback(5)), [scene(slot) for slot in range(40)])
    published = [record.expected is not None for record in records]
    assert not any(published[:2])  # the warm-up, two slots ahead
    first = published.index(True)
    assert published[first:] == ([True] * 4 + [False]) * 7 + [True] * (len(published) - first - 35)


def test_people_are_expected_where_they_are_in_the_slot_of_the_order() -> None:
    records = run(make("all", feedback=Feedback(1000)), [scene(slot) for slot in range(30)])
    for record in records[-10:]:
        assert record.expected is not None
        for camera, view in enumerate(record.expected):
            truth = scene(record.slot + 2)[camera].keypoints_px
            assert len(view) == len(truth) == 2
            off = np.linalg.norm(view.keypoints_px[:, None] - truth[None], axis=-1).mean(axis=-1)
            assert off.min(axis=1).max() < 5.0 and set(off.argmin(axis=1)) == {0, 1}


class Doubting:
    """Foresees nobody to move, and doubts a slot ahead by as many metres as it is ahead."""

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        joints_m = np.repeat(history_m[-1:], lead_slots, axis=0)
        ahead = np.arange(1.0, lead_slots + 1)[:, None, None]
        return Prediction(joints_m, np.broadcast_to(ahead, joints_m.shape[:-1]))


def test_people_are_expected_with_the_error_of_the_slot_of_the_order(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told = list[Floats]()

    def expected(rig: Any, joints_m: Floats, error_m: Floats, *more: Any) -> Any:
        told.append(error_m)
        return expected_people(rig, joints_m, error_m, *more)

    monkeypatch.setattr("e3pose.pipeline.expected_people", expected)
    loop = make("all", feedback=Feedback(1000), predictor=Doubting())
    run(loop, [scene(slot) for slot in range(12)])
    assert told and all((error_m == loop.lead_slots).all() for error_m in told)


def test_cameras_selected_together_look_at_all_of_their_image_together() -> None:
    records = run(make("round-robin", feedback=Feedback(4)), [scene(slot) for slot in range(80)])
    looks = np.zeros(NUM_CAMERAS, dtype=int)
    for record in records[4:]:
        chosen = record.next_selection
        looks = np.where(chosen, 0 if record.expected is None else looks + 1, looks)
        assert looks.max() < 4  # full-frame detection is never later
    shares = [record.expected is None for record in records[20:]]
    assert 1 / 4 <= np.mean(shares) <= 1 / 2


def test_nobody_expected_is_a_look_at_the_whole_image() -> None:
    nobody = {index: Poses2D.empty(NUM_JOINTS) for index in range(NUM_CAMERAS)}
    records = run(make("all", feedback=Feedback(5)), [nobody] * 20)
    assert all(record.expected is None for record in records)
