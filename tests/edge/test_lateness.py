"""Late views and orders do not count as failures for good, and are reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from e3pose.edge.lateness import (
    REPORTED_FAILURES,
    REPORTED_LATE_FAILURES,
    impairments,
    without_late_failures,
)
from e3pose.edge.lead import Lead
from e3pose.edge.reports import changes
from e3pose.pipeline import SlotState, initial_state
from e3pose.select.failure_detector import Silence, listen
from e3pose.settings.loop import ReplaySettings
from e3pose.settings.parts import make_pipeline
from e3pose.simulate.settings import SceneSettings
from e3pose.simulate.simulation import simulate

INTERVAL_S = 0.05
ALL = np.ones(3, dtype=bool)
ONLY_FIRST = np.array([True, False, False])
UNKNOWN_S = np.full(3, np.nan)


@pytest.fixture
def state() -> SlotState:
    """Return the state of three cameras, of which the last two were just given up."""
    scene = simulate(SceneSettings("ring", people=1, seconds=0.5, cameras=3), seed=0)
    made = initial_state(make_pipeline(scene, ReplaySettings()))
    silence = made.silence
    for slot in range(5):
        silence = listen(silence, slot, ALL, ONLY_FIRST, INTERVAL_S)
    return replace(made, silence=silence)


def test_late_views_and_late_orders_forgive_their_camera_alone(state: SlotState) -> None:
    assert state.silence.answering(5).tolist() == [True, False, False]
    none, second, third = np.zeros(3, dtype=bool), np.eye(3)[1] > 0, np.eye(3)[2] > 0
    for views_late, orders_late, expected in (
        (none, none, [True, False, False]),
        (second, none, [True, True, False]),
        (none, third, [True, False, True]),
        (second, third, [True, True, True]),
    ):
        after = without_late_failures(state, views_late, orders_late, INTERVAL_S)
        assert after.silence.answering(5).tolist() == expected
        assert after.slot == state.slot and after.memory is state.memory


def test_camera_that_is_late_again_when_tried_again_is_reported_with_its_delay() -> None:
    silence, slot, late_by_s = Silence.none(3), 0, np.array([np.nan, 0.232, np.nan])
    failed_at: list[int] = []
    while len(failed_at) < REPORTED_LATE_FAILURES:
        assert impairments(silence, late_by_s, INTERVAL_S, Lead()) == [""] * 3
        slot = max(slot + 1, int(silence.retry_slot[1]))
        silence = listen(silence, slot, ALL, np.array([True, False, True]), INTERVAL_S)
        silence = replace(silence, missed=np.zeros(3, dtype=np.int64))  # it is alive
        failed_at += [slot] * (int(silence.failures[1]) - len(failed_at))
    assert failed_at[0] * INTERVAL_S > 1.4 and failed_at[-1] * INTERVAL_S < 3.0
    message = "views arrive too late, 232 ms after capture"
    assert impairments(silence, late_by_s, INTERVAL_S, Lead()) == ["", message, ""]
    silence = listen(silence, int(silence.retry_slot[1]), ALL, ALL, INTERVAL_S)
    assert impairments(silence, late_by_s, INTERVAL_S, Lead()) == [""] * 3


def test_camera_that_is_there_but_sends_nothing_is_reported() -> None:
    silence, slot, failures = Silence.none(3), 0, 0
    while failures < REPORTED_FAILURES:
        assert impairments(silence, UNKNOWN_S, INTERVAL_S, Lead()) == [""] * 3
        slot = max(slot + 1, int(silence.retry_slot[1]))
        silence = listen(silence, slot, ALL, np.array([True, False, True]), INTERVAL_S)
        failures = int(silence.failures[1])
    assert impairments(silence, UNKNOWN_S, INTERVAL_S, Lead()) == [
        "",
        "no views arrive in time",
        "",
    ]


def test_delays_that_most_cameras_have_are_blamed_on_none() -> None:
    def said(longest_s: tuple[float, ...], behind: tuple[int, ...]) -> list[str]:
        lead = Lead(longest_s=longest_s, left_behind=behind)
        return impairments(Silence.none(3), UNKNOWN_S, INTERVAL_S, lead)

    one = said((0.1, 0.1, 3.0), (2,))
    assert one[:2] == ["", ""] and one[2].endswith("far longer than for the others")
    every = said((2.5, 2.6, 3.0), (0, 1, 2))
    assert every[0] == "orders take 2.5 s to arrive, as for most cameras: check the network"
    assert not any("others" in why for why in every)


def test_changes_are_reported_once() -> None:
    ids, kinds = ("a", "b", "c"), ("lost", "back")
    assert changes(ids, ["", "x", "y"], ["gone", "", "z"], kinds) == [
        ("lost", "a: gone", "a"),
        ("back", "b connected", "b"),
    ]
