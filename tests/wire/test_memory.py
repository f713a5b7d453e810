"""The transport of one process behaves as Transport says."""

from __future__ import annotations

import time

from tests.memory_transport import Hub


def test_subscribers_of_a_pattern_receive() -> None:
    hub = Hub()
    edge, camera, other = hub.join(), hub.join(), hub.join()
    got: list[tuple[str, bytes]] = []
    edge.subscribe("e3pose/lab/camera/*/view", lambda topic, payload: got.append((topic, payload)))
    other.subscribe("e3pose/hall/camera/*/view", lambda topic, payload: got.append((topic, b"!")))
    camera.publish("e3pose/lab/camera/cam1/view", b"1")
    camera.publish("e3pose/lab/camera/cam1/heartbeat", b"2")
    assert got == [("e3pose/lab/camera/cam1/view", b"1")]


def test_faults_lose_and_change() -> None:
    hub = Hub()
    edge, camera = hub.join(), hub.join()
    got: list[bytes] = []
    edge.subscribe("a/b", lambda _, payload: got.append(payload))
    hub.fault = lambda topic, payload: None if payload == b"lost" else payload[::-1]
    camera.publish("a/b", b"lost")
    camera.publish("a/b", b"xyz")
    assert got == [b"zyx"]


def test_questions_are_answered_or_not() -> None:
    hub = Hub()
    edge, camera = hub.join(), hub.join()
    assert camera.ask("a/b/clock", b"?", 0.1) is None
    edge.answer("a/*/clock", lambda topic, payload: payload + topic.encode())
    assert camera.ask("a/b/clock", b"?", 0.1) == b"?a/b/clock"


def test_presence_begins_and_ends() -> None:
    hub = Hub()
    early, edge = hub.join(), hub.join()
    early.be_present("a/early/alive")
    seen: list[tuple[str, bool]] = []
    edge.watch("a/*/alive", lambda topic, there: seen.append((topic, there)))
    late = hub.join()
    late.be_present("a/late/alive")
    late.close()
    late.close()
    late.publish("a/x", b"from the grave")
    expected = [("a/early/alive", True), ("a/late/alive", True), ("a/late/alive", False)]
    assert seen == expected


def test_what_is_under_way_arrives_after_its_delay() -> None:
    hub = Hub(delay_s=lambda topic: 0.6 if topic == "slow" else 0.05)
    near, far = hub.join(), hub.join()
    got: list[tuple[str, float]] = []
    for topic in ("slow", "quick"):
        near.subscribe(topic, lambda topic, payload: got.append((topic, time.monotonic())))
    begun_s = time.monotonic()
    far.publish("slow", b"1")
    far.publish("quick", b"2")
    while len(got) < 2 and time.monotonic() - begun_s < 20:
        time.sleep(0.01)
    assert [topic for topic, _ in got] == ["quick", "slow"]
    assert got[0][1] - begun_s >= 0.05 and got[1][1] - begun_s >= 0.6
    near.answer("slow", lambda topic, payload: payload)
    assert far.ask("slow", b"?", 10.0) == b"?"
    assert far.ask("slow", b"?", 0.3) is None  # there and back takes longer
