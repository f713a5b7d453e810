"""Sites of real processes: their memory, their slots through a slow link, and why one fails."""

from __future__ import annotations

import socket
import threading
import time
from pathlib import Path

import pytest
from tests.rigs import looking

from e3pose.errors import InputError
from e3pose.reproduce.relay import relay
from e3pose.reproduce.site_memory import MemoryAsked, site_memory
from e3pose.reproduce.site_run import running_site
from e3pose.reproduce.sources import Sources
from e3pose.reproduce.timeline import RatesAsked, rates
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
def test_orders_ahead_of_time_hide_a_slow_link() -> None:
    found = rates(Sources(), RatesAsked(400.0, True, 2.0))
    assert found.lead > 400 / 40  # slots, for orders to be there in time
    assert found.central < 1 / 0.452  # a round trip, a server, a look: no machine is faster
    assert 0 < found.ours <= 30


@pytest.mark.live
@pytest.mark.slow
def test_a_site_that_does_not_run_says_why(tmp_path: Path) -> None:
    rig = looking((3.0, 0.0), (0.0, 3.0))
    nothing = Example("broken", dict.fromkeys(rig.camera_ids, "none.mp4"), 10.0, "coco17")
    with pytest.raises(InputError, match=r"ended.*none\.mp4"), running_site(tmp_path, rig, nothing):
        pass
