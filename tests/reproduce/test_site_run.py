"""Sites of real processes: their memory, their slots through a slow link, and why one fails."""

from __future__ import annotations

import socket
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from tests.rigs import looking

from e3pose.errors import InputError
from e3pose.model.skeleton import COCO17
from e3pose.predict import make_predictor
from e3pose.recording import save_recording
from e3pose.reproduce.emulated import SERVER_S, slow_published
from e3pose.reproduce.relay import relay
from e3pose.reproduce.site_memory import MemoryAsked, site_memory
from e3pose.reproduce.site_run import running_site
from e3pose.reproduce.sources import Sources
from e3pose.reproduce.timeline import FPS, RatesAsked, central_2d, distributed
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.example import Example


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


@pytest.mark.live
@pytest.mark.slow
def test_memory_is_that_of_the_processes() -> None:
    found = site_memory(Sources(), MemoryAsked("e3pose", 2, cameras=2, selected=2, seconds=1.0))
    assert 20 < found.camera_pss <= found.camera_rss < 1000  # an interpreter with numpy
    assert 20 < found.edge_pss <= found.edge_rss < 4000
    assert 0 < found.people <= 4


@pytest.mark.live
@pytest.mark.slow
def test_orders_ahead_of_time_hide_a_slow_link(tmp_path: Path) -> None:
    recording = simulate(SceneSettings("ring", people=1, seconds=4.0, fps=10.0, cameras=2), 0)
    save_recording(recording, tmp_path / "recording")
    sources = dict.fromkeys(recording.rig.camera_ids, "recorded:recording")
    far = Example("far", sources, 10.0, "coco17", cameras=2, deadline_ms=1000.0)
    with running_site(tmp_path, recording.rig, far, 0.4) as run:

        def whole() -> bool:
            return any(arrived == 2 for _, _, arrived in list(run.slots.values()))

        run.wait(whole, 120.0, "a slot with both views")
        assert run.follower.status is not None
        assert run.follower.status.lead >= 4  # slots of 100 ms, for orders to be there in time


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


@pytest.mark.live
@pytest.mark.slow
def test_a_site_that_does_not_run_says_why(tmp_path: Path) -> None:
    rig = looking((3.0, 0.0), (0.0, 3.0))
    nothing = Example("broken", dict.fromkeys(rig.camera_ids, "none.mp4"), 10.0, "coco17")
    with pytest.raises(InputError, match=r"ended.*none\.mp4"), running_site(tmp_path, rig, nothing):
        pass
