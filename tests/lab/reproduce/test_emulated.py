"""What stands in for a slow link and a slow server in runs of sites."""

from __future__ import annotations

import socket
import threading
import time

import numpy as np

from e3pose.model.skeleton import COCO17
from e3pose.predict import make_predictor
from e3pose_lab.reproduce.emulated import SERVER_S, slow_published
from e3pose_lab.reproduce.relay import relay
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
