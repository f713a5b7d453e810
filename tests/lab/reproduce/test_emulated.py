"""What stands in for slow links, servers and detectors in reproductions."""

from __future__ import annotations

import socket
import threading
import time

import numpy as np
import pytest

from e3pose.model.rigs import ring_rig
from e3pose.model.skeleton import COCO17, PANOPTIC19
from e3pose.predict import make_predictor
from e3pose.recording import Recording, Truth, ViewSeries
from e3pose_lab.reproduce.emulated import SERVER_S, slow_published
from e3pose_lab.reproduce.relay import relay
from e3pose_lab.reproduce.simulated import APART_SLOTS, completed, gathered, with_detections
from e3pose_lab.reproduce.timeline import FPS, RatesAsked, central_2d, distributed


def test_a_relay_passes_everything_on_late() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def echo() -> None:
            connection, _ = server.accept()
            with connection:
                while piece := connection.recv(1000):
                    connection.sendall(piece)

        thread = threading.Thread(target=echo)
        thread.start()
        with relay(server.getsockname()[1], 0.2) as port:
            with socket.create_connection(("127.0.0.1", port), timeout=30.0) as client:
                begun_s = time.monotonic()
                client.sendall(b"there and back")
                heard = b""
                while len(heard) < len(b"there and back"):
                    heard += client.recv(1000)
                assert time.monotonic() - begun_s >= 0.19
                assert heard == b"there and back"
            thread.join(30.0)
            assert not thread.is_alive()


def test_emulated_designs_wait_as_they_must() -> None:
    asked = RatesAsked(400.0, True, 1.0)
    assert central_2d(asked) < 1 / 0.452  # a round trip, a server, a look: no machine is faster
    assert distributed(1.0) <= FPS * 1.1


def test_a_slow_server_says_what_the_published_network_says() -> None:
    history_m = np.random.default_rng(0).normal(scale=0.3, size=(10, 2, 17, 3))
    published = make_predictor("attention-lstm-paper").predict(history_m, 0.04, 3)
    begun_s = time.monotonic()
    slow = slow_published(COCO17).predict(history_m, 0.04, 3)
    assert time.monotonic() - begun_s >= SERVER_S
    np.testing.assert_array_equal(slow.joints_m, published.joints_m)


NAN = np.nan


def walker(num_slots: int) -> Recording:
    """One person of Panoptic-19 who stands and shifts a little, before a ring of cameras."""
    rng = np.random.default_rng(0)
    rig = ring_rig(3, 4.0, 2.0, (1032, 776), rng)
    body = rng.normal(0, 0.2, (19, 3)) + [0, 0, 1.0]
    joints = body + np.linspace(0, 0.3, num_slots)[:, None, None]
    joints[:, 8] = NAN  # the left ankle is never known
    empty = ViewSeries.from_views([], [], [], 19)
    truth = Truth(PANOPTIC19, ("person1",), joints[:, None])
    return Recording("walk", rig, 25.0, num_slots, PANOPTIC19, (empty,) * 3, truth)


def test_gaps_are_filled_from_the_nearest_slot_or_the_other_side() -> None:
    joints = np.random.default_rng(1).normal(size=(4, 1, 17, 3))
    whole = joints.copy()
    joints[1, 0, 9] = NAN
    joints[:, 0, 15] = NAN
    filled = completed(joints)
    hips = whole[:, :, [11, 12]].mean(axis=2)
    assert np.isfinite(filled).all()
    assert filled[1, 0, 9] - hips[1, 0] == pytest.approx(whole[0, 0, 9] - hips[0, 0])
    assert filled[:, 0, 15] == pytest.approx(whole[:, 0, 16])
    known = np.isfinite(joints)
    assert filled[known] == pytest.approx(whole[known])


def test_people_with_an_unknown_ankle_are_detected() -> None:
    recording = with_detections(walker(10), 3)
    assert all(len(series.scores) >= 8 for series in recording.views)
    again = with_detections(walker(10), 3)
    assert np.array_equal(recording.views[0].scores, again.views[0].scores)
    assert "simulated" in recording.name and recording.detector == "simulated"


def test_people_stand_apart() -> None:
    many = gathered(walker(APART_SLOTS + 30), 0, 20, people=2)
    assert many.truth is not None and many.num_slots == 20
    middles = np.nanmean(many.truth.joints_m, axis=(0, 2))
    assert np.linalg.norm(middles[0, :2] - middles[1, :2]) > 1.0
