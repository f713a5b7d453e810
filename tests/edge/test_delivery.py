"""A camera that brings too few of the views ordered of it is named, with figures, and once."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.edge.delivery import MEMORY_ORDERS, MIN_ORDERS, SETTLED_S, Delivery, after_slot
from e3pose.edge.delivery import shortages as told
from e3pose.edge.health import Health
from e3pose.edge.overload import HIGH
from e3pose.edge.roster import CameraState, with_heartbeat, with_hello
from e3pose.model.pose import Poses3D
from e3pose.model.slot_record import SlotRecord
from e3pose.wire.messages import Heartbeat, Hello

INTERVAL_S = 0.04
NOBODY, EVERYBODY = np.zeros(2, dtype=bool), np.ones(2, dtype=bool)


def deliver(share: float, slots: int, before: Delivery | None = None) -> list[Delivery]:
    """What is known after each slot: all views of a camera come, and a share of another's."""
    rng, found = np.random.default_rng(1), [before or Delivery.none(2)]
    for _ in range(slots):
        arrived = np.array([True, rng.random() < share])
        found.append(after_slot(found[-1], EVERYBODY, arrived, NOBODY, NOBODY, INTERVAL_S))
    return found


def test_camera_of_half_the_frames_is_named_within_seconds() -> None:
    found = deliver(0.5, 1000)
    first = next(n for n, each in enumerate(found) if each.short.any())
    assert first * INTERVAL_S <= 3 and found[-1].short.tolist() == [False, True]
    assert found[-1].share(1) == pytest.approx(0.5, abs=0.1) and found[-1].share(0) == 1
    assert found[MIN_ORDERS - 1].share(1) is None


def test_warning_ends_when_views_come_again() -> None:
    short = deliver(0.5, 1000)[-1]
    assert not deliver(1.0, 4 * MEMORY_ORDERS, short)[-1].short.any()


@each_case("share", [0.86, 0.9, 0.925, 0.95])
def test_share_about_the_limit_does_not_flap(share: float) -> None:
    found = deliver(share, round(3600 / INTERVAL_S))  # an hour
    changed_s = [
        n * INTERVAL_S for n, (a, b) in enumerate(pairwise(found)) if (a.short != b.short).any()
    ]
    assert len(changed_s) <= 20
    assert all(b - a >= SETTLED_S - INTERVAL_S for a, b in pairwise(changed_s[::2]))


def test_camera_that_was_given_up_is_counted_anew() -> None:
    gone = deliver(0.1, 1000)[-1]
    assert gone.short[1]
    up = after_slot(gone, EVERYBODY, EVERYBODY, NOBODY, np.array([False, True]), INTERVAL_S)
    assert up.short[1] and up.share(1) is None
    assert told(up, [camera(25.0)] * 2, 25.0, 1.0)[1].endswith("its views are counted anew")
    assert not deliver(1.0, MIN_ORDERS, up)[-1].short[1]
    assert deliver(1.0, MIN_ORDERS, gone)[-1].short[1] and deliver(0.5, 500, up)[-1].short[1]


def test_cameras_without_orders_are_not_counted() -> None:
    delivery = Delivery.none(2)
    for _ in range(500):
        delivery = after_slot(delivery, NOBODY, NOBODY, NOBODY, NOBODY, INTERVAL_S)
    assert not delivery.orders.any() and not delivery.short.any()


def camera(frames_hz: float, dropped_hz: float = 0.0, seconds: int = 9) -> CameraState:
    """A camera that has sent heartbeats for some seconds."""
    state = with_hello(CameraState("cam1"), Hello("cam1", 1, ("nose",), (640, 480), 25.0), 0)
    for half in range(2 * seconds):
        beat = Heartbeat(
            "cam1", 1, 0, "active",
            captured=round(frames_hz * half / 2), dropped=round(dropped_hz * half / 2),
        )  # fmt: skip
        state = with_heartbeat(state, beat, half * 500_000_000)
    return state


def test_message_names_both_figures_and_what_to_do() -> None:
    short, fine = deliver(0.5, 200)[-1], camera(25.0)
    assert told(short, [fine, camera(12.5, seconds=2)], 25.0, 1.0) == ["", ""]  # not known yet
    first, second = told(short, [fine, camera(12.5)], 25.0, 1.0)
    assert first == ""
    assert second.startswith("its source brings 12.5 frames per second, the site has 25 slots: ")
    assert "set fps = 12.5 in the site file, or raise the camera's frame rate" in second
    assert "lower pace" in told(short, [fine, camera(12.5)], 25.0, 0.5)[1]
    assert "its detector is too slow" in told(short, [fine, camera(25.0, 12.0)], 25.0, 1.0)[1]
    assert "check its network connection" in told(short, [fine, fine], 25.0, 1.0)[1]
    late = Delivery(short.orders, short.arrived, 1 - short.arrived, short.short, short.since_s)
    assert "raise deadline_ms" in told(late, [fine, fine], 25.0, 1.0)[1]


def test_rate_of_frames_is_measured_from_heartbeats() -> None:
    assert camera(12.5).frames_hz == pytest.approx(12.5, abs=0.2)
    assert camera(12.5, seconds=3).frames_hz is None
    state = camera(12.5)
    again = with_hello(state, Hello("cam1", 2, ("nose",), (640, 480), 25.0), 13 * 10**9)
    assert again.frames_hz is None and again.counted is None
    asleep = with_heartbeat(state, Heartbeat("cam1", 1, 0, "aggressive-power-saving"), 13 * 10**9)
    assert asleep.counted is None and asleep.frames_hz == state.frames_hz


def test_no_camera_is_short_because_the_edge_is_slow() -> None:
    health, nothing = Health(2, INTERVAL_S, 1.0), np.zeros(2)
    poses, ids = Poses3D(np.zeros((0, 17, 3)), np.zeros((0, 17))), np.zeros(0, dtype=np.int64)
    for slot in range(500):
        record = SlotRecord(slot, 0.0, EVERYBODY, NOBODY, poses, ids, nothing, nothing, EVERYBODY)
        health.after_slot(record, EVERYBODY, NOBODY, NOBODY, NOBODY, 1.2 * HIGH * INTERVAL_S, 0.0)
    assert health.load.overloaded() and not health.delivery.short.any()


def test_cameras_of_the_warm_up_are_no_measure_of_what_a_policy_selects() -> None:
    """An overloaded edge takes turns with so many: all of them would be more load, not less."""
    health, nothing = Health(2, INTERVAL_S, 1.0, warmup_slots=20), np.zeros(2)
    poses, ids = Poses3D(np.zeros((0, 17, 3)), np.zeros((0, 17))), np.zeros(0, dtype=np.int64)
    one = np.array([True, False])
    awake: list[float] = []
    for slot in range(40):
        who = EVERYBODY if slot < 20 else one
        record = SlotRecord(slot, 0.0, who, NOBODY, poses, ids, nothing, nothing, who)
        health.after_slot(record, who, NOBODY, NOBODY, NOBODY, 0.0, 0.0)
        awake.append(health.load.awake)
    assert max(awake) == 1.0
