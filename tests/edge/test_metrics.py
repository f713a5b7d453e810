"""What an edge tells Prometheus is what it counted."""

from __future__ import annotations

import socket
import threading
import urllib.request
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from tests.edge.one_process import site_at_work
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.base.errors import InputError
from e3pose.base.listener import open_socket
from e3pose.edge.consumers import Consumers
from e3pose.edge.metrics import MetricsServer, _of_cameras, http_answer, serve_metrics
from e3pose.model.blind_slot import CAUSES
from e3pose.pipeline import SlotRecord
from e3pose.store import Event, WriterStatus
from e3pose.wire.messages import Heartbeat
from e3pose.wire.site_messages import CameraStatus

pytest.importorskip("prometheus_client")

OF_CAMERAS = (
    "asleep_seconds battery clock_drift_ppm cpu_saved cpu_seconds deficit delivered dropped "
    "duty late_orders late_views lost_views noise_factor online order_margin_seconds "
    "ordered_views orders source_fps turned_degrees unchanged wake_seconds watts"
)


class Kept:
    """A store with troubles."""

    def append(self, record: SlotRecord, **_: Any) -> bool:
        return True

    def event(self, event: Event) -> bool:
        return True

    def status(self) -> WriterStatus:
        return WriterStatus(7, 0, spooled=4, shed=5, problem="disk full", corrupt=2)


def scraped(port: int) -> dict[str, float]:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=5) as answer:
        lines = answer.read().decode().splitlines()
    return {
        name: float(value)
        for name, value in (line.rsplit(" ", 1) for line in lines if not line.startswith("#"))
    }


def test_metrics_are_what_was_counted(tmp_path: Path) -> None:
    with site_at_work(tmp_path) as site:
        edge, port = site.edge, free_port()
        liar = site.hub.join()
        for _ in range(3):
            liar.publish("e3pose/lab/camera/cam1/view", b"garbage")
            liar.publish("e3pose/lab/camera/nobody/view", b"garbage")
        edge.consumers = Consumers(sink=Kept())
        server = serve_metrics(edge, port)
        try:
            with pytest.raises(InputError, match=f"metrics_port: {port}: .*expected a free port"):
                serve_metrics(edge, port)
            assert eventually(lambda: edge.inbox.cameras[0].beat is not None)
            before, found, after = edge.counts.slots, scraped(port), edge.counts.slots
        finally:
            server.close()
        assert before <= found["e3pose_slots_total"] <= after
        assert found["e3pose_wrong_messages_total"] == 3
        assert found["e3pose_unknown_messages_total"] == 3
        assert found["e3pose_unread_messages_total"] == 0
        assert found["e3pose_lead_slots"] >= 1
        assert found["e3pose_store_corrupt_total"] == 2
        assert found["e3pose_store_shed_total"] == 5
        assert found["e3pose_store_spooled_rows"] == 4
        assert found["e3pose_store_trouble"] == 1
        for cause in CAUSES:
            blind = found[f'e3pose_slots_blind_total{{cause="{cause}"}}']
            assert 0 <= blind <= edge.counts.blind.get(cause, 0)
        assert found["e3pose_overloaded"] in (0, 1) and 0 <= found["e3pose_blind_share"] <= 1
        for camera in site.nodes:
            of = {
                name.split("{")[0].removeprefix("e3pose_camera_"): value
                for name, value in found.items()
                if f'"{camera}"' in name
            }
            assert of["online"] == 1 and 0 < of["duty"] <= 1
            assert 0 < of["ordered_views"] <= after
            assert 0 <= of["lost_views"] <= of["ordered_views"]
            assert 0 <= of["late_orders"] < of["orders"]
            assert "battery" not in of  # on mains


def test_metrics_of_cameras_keep_their_names_and_units() -> None:
    status = CameraStatus("cam1", True, power_w=4.25)
    beat = Heartbeat("cam1", 7, 99, "active", order_margin_ns=123_456_789)
    families = [*_of_cameras(CameraStatus, [status], [status])]
    families += _of_cameras(Heartbeat, [status], [beat])
    found = {family.name.removeprefix("e3pose_camera_"): family for family in families}
    assert " ".join(sorted(found)) == OF_CAMERAS
    values = {name: sample.value for name, one in found.items() for sample in one.samples}
    assert (values["watts"], values["order_margin_seconds"]) == (4.25, 0.123456789)
    assert values["turned_degrees"] == 0 and "battery" not in values
    assert (
        found["battery"].documentation == "remaining charge, 0 to 1; absent on mains or if unknown"
    )


REQUESTS = [
    ("GET /metrics HTTP/1.1", "localhost:9", "200"),
    ("GET / HTTP/1.0", "127.0.0.1", "200"),
    ("GET /metrics?name[]=x HTTP/1.1", "[::1]:9", "200"),
    ("GET /metrics HTTP/1.1", "evil.example", "421"),  # a page pointed its name here
    ("POST /metrics HTTP/1.1", "localhost", "404"),
    ("GET /etc/passwd HTTP/1.1", "localhost", "404"),
    ("GET /" + "x" * 9000, "localhost", "431"),
    ("\x16\x03\x01", "localhost", "404"),
]


def test_only_scrapes_are_answered_and_a_crowd_makes_no_threads_and_keeps_none_out() -> None:
    listening = open_socket("127.0.0.1", 0)
    server = MetricsServer(listening, lambda headers: http_answer("200 OK", body=b"x 1\n"))
    threads = threading.active_count()
    with ExitStack() as stack:
        stack.callback(server.close)
        for crowd in (0, 200):
            for _ in range(crowd):
                one = stack.enter_context(connect(listening))
                one.sendall(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\nX: ")
            for request_line, host, status in REQUESTS:
                with connect(listening) as one:
                    one.sendall(f"{request_line}\r\nHost: {host}\r\n\r\n".encode("latin-1"))
                    assert one.recv(1000).split(b" ")[1] == status.encode(), request_line
        assert threading.active_count() <= threads


def connect(listening: socket.socket) -> socket.socket:
    return socket.create_connection(listening.getsockname(), timeout=20)
