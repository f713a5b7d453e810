"""Who is expected travels with orders to cameras, which look there, and there alone."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case
from tests.edge.one_process import Site, site_at_work
from tests.waiting import eventually

from e3pose.base.clock import SlotTimes
from e3pose.base.errors import InputError
from e3pose.camera.schedule import Schedule, take_order
from e3pose.model.expected import ExpectedView
from e3pose.wire.arrays import pack, unpack
from e3pose.wire.codec import decode, encode
from e3pose.wire.expected import expected_view, packed_expected
from e3pose.wire.messages import Order
from e3pose.wire.validation import MAX_EXPECTED, MAX_PIXEL

ORIGIN, INTERVAL = 1_000_000_000_000, 40_000_000
TIMES = SlotTimes(ORIGIN, INTERVAL)


def view(people: int = 2) -> ExpectedView:
    keypoints_px = np.random.default_rng(0).uniform(0, 1000, (people, 17, 2))
    keypoints_px[:, 3] = np.nan
    return ExpectedView(keypoints_px, np.linspace(5, 20, people))


def order(slot: int = 5, expected_people: ExpectedView | None = None, **changes: Any) -> Order:
    expected_px, reach_px = packed_expected(expected_people)
    fields = {
        "camera_id": "cam1", "slot": slot, "active": True, "idle_mode": "power-saving",
        "origin_edge_ns": ORIGIN, "interval_ns": INTERVAL, "sent_edge_ns": 0, "session": 1,
        "expected_px": expected_px, "reach_px": reach_px, **changes,
    }  # fmt: skip
    return Order(**fields)


def test_expected_people_come_back_from_the_bytes() -> None:
    back = expected_view(decode(encode(order(expected_people=view())), Order, "edge"))
    assert back is not None
    np.testing.assert_allclose(back.keypoints_px, view().keypoints_px, rtol=1e-6)
    np.testing.assert_allclose(back.reach_px, view().reach_px)
    wild = ExpectedView(np.full((1, 2, 2), [[2 * MAX_PIXEL, 0], [3, 4]]), np.array([1e12]))
    back = expected_view(decode(encode(order(expected_people=wild)), Order, "edge"))
    assert back is not None and back.reach_px[0] == MAX_PIXEL  # beyond every image is missing
    assert np.isnan(back.keypoints_px[0, 0]).all() and back.keypoints_px[0, 1].tolist() == [3, 4]


def test_order_of_four_people_is_small_and_a_crowd_is_left_out() -> None:
    assert len(encode(order(expected_people=view(4)))) < 800
    assert len(encode(order())) < 100
    for people in (0, MAX_EXPECTED + 1):
        assert packed_expected(view(people)) == (None, None)
    assert packed_expected(view(MAX_EXPECTED))[0] is not None


@each_case(
    "changes",
    [
        {"reach_px": pack(np.array([-1, 1], np.float32))},
        {"reach_px": pack(np.array([np.nan, 1], np.float32))},
        {"reach_px": pack(np.zeros(3, np.float32))},
        {"expected_px": pack(np.full((2, 17, 2), np.inf, np.float32))},
        {"expected_px": pack(np.zeros((2, 17, 3), np.float32))},
        {"expected_px": pack(np.zeros((2, 17, 2)))},
    ],
)
def test_order_with_what_nobody_can_expect_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="order"):
        decode(encode(order(expected_people=view(), **changes)), Order, "edge")


def test_old_program_reads_the_order_and_an_old_order_is_read() -> None:
    assert expected_view(order(reach_px=None)) is None
    assert expected_view(decode(encode(order()), Order, "edge")) is None


def test_feedback_holds_for_its_slot_alone() -> None:
    schedule = take_order(Schedule(), order(5, view()), TIMES.middle_ns(3))
    assert list(schedule.expected) == [5]
    newer = take_order(schedule, order(5), TIMES.middle_ns(3))
    assert not newer.expected  # the newest order holds
    assert not take_order(schedule, order(6, session=2), TIMES.middle_ns(3)).expected


def test_stale_feedback_is_ignored() -> None:
    late = take_order(Schedule(), order(5, view()), TIMES.begin_ns(5) + 1)
    assert late.late == 1 and not late.expected
    schedule = take_order(Schedule(), order(5, view()), TIMES.middle_ns(3))
    for slot in range(6, 40):
        schedule = take_order(schedule, order(slot), TIMES.middle_ns(slot - 2))
    assert not schedule.expected


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    folder = tmp_path_factory.mktemp("site")
    with site_at_work(folder, feedback=True, smooth_delay_s=0.1) as made:
        yield made


@pytest.mark.slow
def test_cameras_of_a_site_are_reported_in_some_slots_and_not_in_others(site: Site) -> None:
    assert eventually(lambda: all(node.counts.focused > 10 for node in site.nodes.values()))
    assert all(node.counts.focused < node.counts.detected for node in site.nodes.values())
    assert eventually(lambda: all(site.camera(name).focused > 0 for name in site.nodes))


@pytest.mark.slow
def test_camera_whose_detector_ignores_feedback_says_so_once(site: Site) -> None:
    assert eventually(lambda: all(node.counts.focused > 10 for node in site.nodes.values()))
    ignored = [line for line in site.words if "feedback ignored" in line]
    assert sorted(ignored) == [
        f"{name}: feedback ignored: the detector detects in whole images only"
        for name in sorted(site.nodes)
    ]


@pytest.mark.slow
def test_an_edge_with_a_delay_tells_the_same_people_again(site: Site) -> None:
    assert eventually(lambda: len(site.delayed) > 10)
    at_once = {message.slot: message for message in site.poses}
    for late in site.delayed[:10]:
        first = at_once[late.slot]
        assert late.time_edge_ns == first.time_edge_ns
        assert late.published_edge_ns > first.published_edge_ns
        assert late.delay_ms == pytest.approx(100.0) and first.delay_ms == 0.0
        assert unpack(late.track_ids).tolist() == unpack(first.track_ids).tolist()
    assert site.edge.threads.failure is None
