"""Zenoh on loopback: what is far too large does not arrive, what is said at once does."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
import time
from typing import Literal

import pytest
from tests.ports import free_port
from tests.waiting import eventually
from tests.wire.certified_site import Site

from e3pose.wire.access import VIEW_BYTES, Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.network import open_network

pytestmark = pytest.mark.slow

SILENCE_S = 0.4  # how long to wait for what must not come
LISTENER = """
import sys, time
from e3pose.wire.access import Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.network import open_network
camera = open_network(Link("camera", "lab", read_endpoint(sys.argv[1])))
camera.subscribe("e3pose/lab/order/cam1", lambda topic, payload: print(len(payload), flush=True))
sys.stdin.read()
"""


def test_what_is_far_too_large_does_not_even_arrive(site: Site) -> None:
    edge, camera = site.edge(), site.camera("cam1")
    got: list[tuple[str, int]] = []
    for what in ("view", "heartbeat"):
        edge.subscribe(
            f"e3pose/lab/camera/*/{what}", lambda t, p: got.append((t.rsplit("/", 1)[1], len(p)))
        )

    def arrived() -> bool:
        got.clear()
        camera.publish("e3pose/lab/camera/cam1/view", b"x" * VIEW_BYTES)
        camera.publish("e3pose/lab/camera/cam1/heartbeat", b"x" * 2**12)
        time.sleep(0.1)
        return {what for what, _ in got} == {"view", "heartbeat"}

    assert eventually(arrived)
    seen = {*got}
    for _ in range(3):
        camera.publish("e3pose/lab/camera/cam1/view", b"x" * 2**20)
        camera.publish("e3pose/lab/camera/cam1/heartbeat", b"x" * 2**18)
        time.sleep(SILENCE_S)
        seen |= {*got}
    assert eventually(arrived)  # the link is there still
    assert seen | {*got} == {("view", VIEW_BYTES), ("heartbeat", 2**12)}
    edge.close()


@pytest.mark.parametrize("role", ["edge", "router"])
def test_large_question_or_hello_does_not_even_arrive(
    role: Literal["edge", "router"],
) -> None:
    endpoint, hellos = f"tcp/127.0.0.1:{free_port()}", list[int]()
    with (
        contextlib.closing(open_network(Link(role, "lab", read_endpoint(endpoint)))) as edge,
        contextlib.closing(open_network(Link("camera", "lab", read_endpoint(endpoint)))) as camera,
    ):
        edge.answer("e3pose/lab/camera/*/clock", lambda topic, payload: b"time")
        edge.subscribe("e3pose/lab/camera/*/hello", lambda topic, p: hellos.append(len(p)))

        def arrived() -> bool:
            hellos.clear()
            camera.publish("e3pose/lab/camera/cam1/hello", b"x" * 2**14)
            time.sleep(0.05)
            return 2**14 in hellos

        def answer(size: int) -> bytes | None:
            return camera.ask("e3pose/lab/camera/cam1/clock", b"x" * size, SILENCE_S)

        assert eventually(arrived)
        assert eventually(lambda: answer(2**14) == b"time")
        assert [answer(2**16) for _ in range(3)] == [None] * 3
        for _ in range(3):
            camera.publish("e3pose/lab/camera/cam1/hello", b"x" * 2**16)
        time.sleep(SILENCE_S)
        assert set(hellos) == {2**14}
        assert eventually(arrived) and eventually(lambda: answer(2**14) == b"time")


def test_what_is_said_at_once_arrives() -> None:
    port, got = free_port(), 0
    edge = open_network(Link("edge", "lab", read_endpoint(f"tcp/127.0.0.1:{port}")))
    viewer = open_network(Link("viewer", "lab", read_endpoint(f"tcp/127.0.0.1:{port}")))

    def take(topic: str, payload: bytes) -> None:
        nonlocal got
        got += len(payload) > 1

    viewer.subscribe("e3pose/lab/poses", take)

    def arrived() -> bool:
        edge.publish("e3pose/lab/poses", b"xx")
        return got > 0

    assert eventually(arrived)
    time.sleep(SILENCE_S)
    got = 0
    for _ in range(100):
        for _ in range(6):  # a batch of Zenoh each: they wait for its sending thread
            edge.publish("e3pose/lab/poses", b"x" * 60_000)
        time.sleep(0.05)
    # A machine that stands still for long drops some; a link that stays full drops all that follow.
    assert eventually(lambda: got >= 570), got
    got = 0
    edge.publish("e3pose/lab/poses", b"x" * 60_000)
    assert eventually(lambda: got > 0)
    viewer.close()
    edge.close()


def test_camera_that_stood_still_hears_again_on_the_same_link() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    heard: list[int] = []
    with contextlib.closing(open_network(Link("edge", "lab", read_endpoint(endpoint)))) as edge:
        camera = subprocess.Popen(
            [sys.executable, "-c", LISTENER, endpoint],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert camera.stdin is not None and camera.stdout is not None
        lines = camera.stdout
        reader = threading.Thread(target=lambda: heard.extend(int(line) for line in lines))
        reader.start()

        def hears(size: int) -> bool:
            edge.publish("e3pose/lab/order/cam1", b"x" * size)
            time.sleep(0.05)
            return size in heard

        try:
            assert eventually(lambda: hears(1))
            camera.send_signal(signal.SIGSTOP)
            for _ in range(400):  # more than the kernel and Zenoh keep for it
                edge.publish("e3pose/lab/order/cam1", b"x" * 60_000)
            camera.send_signal(signal.SIGCONT)  # before the link is given up
            assert eventually(lambda: hears(2))
            assert heard.count(60_000) < 400  # some were dropped
        finally:
            camera.kill()
            reader.join()
            camera.stdin.close()
            lines.close()
            camera.wait()
