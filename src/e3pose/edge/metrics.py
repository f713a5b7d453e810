"""Prometheus metrics of an edge, on loopback."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from e3pose.base.errors import InputError, reason_of
from e3pose.base.listener import Bounds, Listener, is_own_host, open_socket
from e3pose.edge.reports import savings
from e3pose.edge.server import EdgeServer
from e3pose.model.blind_slot import CAUSES
from e3pose.wire.site_messages import CameraStatus

CONNECTIONS = 16
MAX_REQUEST_BYTES = 8192
END_S = 5.0


class EdgeCollector:
    """Read an edge's status at every scrape; nothing is counted twice."""

    def __init__(self, edge: EdgeServer) -> None:
        self._edge = edge

    def collect(self) -> Iterator[Any]:
        """Yield the metrics, as prometheus_client asks."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        status, counts, inbox = self._edge.status(), self._edge.counts, self._edge.inbox
        for name, text, value in (
            ("slots", "slots computed", counts.slots),
            ("slots_lost", "slots skipped", counts.lost),
            ("views", "views received in time", counts.views),
            ("wrong_messages", "invalid messages", inbox.wrong),
            ("unread_messages", "messages dropped by the rate limit", inbox.flooded),
            (
                "unknown_messages",
                "messages of cameras that are not in the rig",
                inbox.unknown_senders,
            ),
        ):
            yield CounterMetricFamily(f"e3pose_{name}", text, value=value)
        blind = CounterMetricFamily(
            "e3pose_slots_blind", "slots without a view although one was due", labels=["cause"]
        )
        for cause in CAUSES:
            blind.add_metric([cause], status.blind.get(cause, 0))
        yield blind
        for name, text, level in (
            ("blind_share", "share of blind slots, last minute", status.blind_share),
            ("overloaded", "whether the edge is too slow for its slots", bool(status.overload)),
            ("people", "people tracked in the newest slot", status.people),
            ("lead_slots", "slots between an order and its slot", status.lead),
            ("step_seconds_p50", "median computing time of a slot", status.step_ms[0] / 1e3),
            ("step_seconds_p99", "99th percentile", status.step_ms[1] / 1e3),
            ("latency_seconds_p50", "median from last view to poses", status.latency_ms[0] / 1e3),
            ("latency_seconds_p99", "99th percentile", status.latency_ms[1] / 1e3),
        ):
            yield GaugeMetricFamily(f"e3pose_{name}", text, value=level)
        saved = GaugeMetricFamily(
            "e3pose_saved",
            "share saved since the start, compared with all cameras active in every slot",
            labels=["saving", "basis"],
        )
        for name, one in savings(status).named():
            if one is not None:
                saved.add_metric([name, one.basis], one.percent / 100)
        yield saved
        yield from _store(self._edge)
        for name, text, values in _of_cameras(self._edge, status.cameras):
            family = GaugeMetricFamily(f"e3pose_{name}", text, labels=["camera"])
            for camera, found in zip(status.cameras, values, strict=True):
                if found is not None:
                    family.add_metric([camera.camera_id], float(found))
            yield family


def _store(edge: EdgeServer) -> Iterator[Any]:
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    if edge.consumers.sink is None:
        return
    kept = edge.consumers.sink.status()
    for name, text, count in (
        ("store_corrupt", "databases set aside because their content was wrong", kept.corrupt),
        ("store_shed", "records given up", kept.shed),
    ):
        yield CounterMetricFamily(f"e3pose_{name}", text, value=count)
    for name, text, level in (
        ("store_trouble", "whether the store takes nothing", kept.problem is not None),
        ("store_spooled_rows", "rows that wait for the store", kept.spooled),
    ):
        yield GaugeMetricFamily(f"e3pose_{name}", text, value=level)


class MetricsServer:
    """Answers scrapes on one thread, until `close`."""

    def __init__(self, listening: socket.socket, answer: Callable[[dict[str, str]], bytes]) -> None:
        """Start to answer.

        Args:
            listening: the socket, which is closed at the end.
            answer: returns an HTTP answer to a request for the metrics with these headers.
        """
        self._loop, self._listening = asyncio.new_event_loop(), listening
        bounds = Bounds(CONNECTIONS, CONNECTIONS)
        self._listener = Listener(listening, lambda: _Scrape(self._loop, answer), bounds)
        self._thread = threading.Thread(target=self._run, name="metrics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End."""
        self._loop.call_soon_threadsafe(lambda: self._accepting.cancel())
        self._thread.join(END_S)
        self._listening.close()

    def _run(self) -> None:
        self._accepting = self._loop.create_task(self._listener.run())
        with contextlib.suppress(asyncio.CancelledError), contextlib.closing(self._loop):
            self._loop.run_until_complete(self._accepting)


class _Scrape(asyncio.Protocol):
    """One request for the metrics, its answer, and the end."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, answer: Callable[[dict[str, str]], bytes]
    ) -> None:
        self.waiting_since_s: float = loop.time()
        self._answer, self._head = answer, b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        self._head += data
        if b"\r\n\r\n" not in self._head and len(self._head) <= MAX_REQUEST_BYTES:
            return
        self._transport.write(self._reply())
        self._transport.close()

    def _reply(self) -> bytes:
        head, ended, _ = self._head.partition(b"\r\n\r\n")
        if not ended or len(head) > MAX_REQUEST_BYTES:
            return http_answer("431 Request Header Fields Too Large")
        first, *lines = head.decode("latin-1").split("\r\n")
        headers = {
            name.strip().lower(): value.strip()
            for name, _, value in (line.partition(":") for line in lines)
        }
        method, _, target = first.partition(" ")
        if not is_own_host(headers.get("host", ""), {"localhost"}):
            return http_answer("421 Misdirected Request")
        if method != "GET" or target.split(" ")[0].split("?")[0] not in ("/", "/metrics"):
            return http_answer("404 Not Found")
        return self._answer(headers)


def http_answer(status: str, kind: str = "text/plain", body: bytes = b"") -> bytes:
    """Return an HTTP answer after which the connection ends."""
    head = (
        f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n"
        "X-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n"
    )
    return head.encode() + body


def serve_metrics(edge: EdgeServer, port: int) -> MetricsServer:
    """Serve the metrics on `http://127.0.0.1:PORT/metrics` until the server is closed.

    Raises:
        InputError: when the port is taken.
    """
    from prometheus_client import CollectorRegistry
    from prometheus_client.exposition import choose_encoder

    registry = CollectorRegistry()
    registry.register(EdgeCollector(edge))

    def answer(headers: dict[str, str]) -> bytes:
        encode, kind = choose_encoder(headers.get("accept", ""))
        return http_answer("200 OK", kind, encode(registry))

    try:
        listening = open_socket("127.0.0.1", port)
    except OSError as error:
        raise InputError(
            f"metrics_port: {port}: {reason_of(error)}, expected a free port"
        ) from None
    return MetricsServer(listening, answer)


def _of_cameras(
    edge: EdgeServer, cameras: Sequence[CameraStatus]
) -> tuple[tuple[str, str, Sequence[float | None]], ...]:
    """Return name, help text and value by camera of each metric; None where it is unknown."""
    counts, beats = edge.counts, [camera.beat for camera in edge.inbox.roster.cameras]
    return (
        ("camera_online", "whether the camera can be selected", [c.online for c in cameras]),
        ("camera_duty", "share of slots selected, last minute", [c.duty for c in cameras]),
        ("camera_deficit", "energy deficit queue", [c.deficit for c in cameras]),
        ("camera_late_views", "views that arrived too late", [c.late for c in cameras]),
        ("camera_lost_views", "views that never arrived", [c.lost for c in cameras]),
        (
            "camera_noise_factor",
            "learned keypoint sigma over that of the noise file",
            [c.noise_factor for c in cameras],
        ),
        (
            "camera_turned_degrees",
            "least rotation since calibration",
            [c.turned_deg or 0.0 for c in cameras],
        ),
        ("camera_watts", "power draw", [c.power_w for c in cameras]),
        ("camera_cpu_seconds", "processor time of its program", [c.cpu_s for c in cameras]),
        (
            "camera_cpu_saved",
            "processor time saved, as a share of what looking in every slot would take",
            [c.cpu_saved for c in cameras],
        ),
        (
            "camera_unchanged",
            "share of looks for which its image was unchanged",
            [c.unchanged for c in cameras],
        ),
        (
            "camera_asleep_seconds",
            "until it is expected back from an ordered sleep; negative while it oversleeps",
            [c.asleep_s for c in cameras],
        ),
        ("camera_wake_seconds", "mean time to wake, as learned", [c.wake_s for c in cameras]),
        ("camera_battery", "remaining share of the battery", [c.battery for c in cameras]),
        (
            "camera_delivered",
            "share of the newest ordered views that arrived in time",
            [c.delivered for c in cameras],
        ),
        ("camera_source_fps", "frames per second of its source", [c.source_fps for c in cameras]),
        ("camera_ordered_views", "views ordered in time", counts.ordered.tolist()),
        ("camera_orders", "orders received", [None if b is None else b.orders for b in beats]),
        (
            "camera_late_orders",
            "orders received too late",
            [None if b is None else b.late_orders for b in beats],
        ),
        (
            "camera_order_margin_seconds",
            "shortest time from an order to its slot, last half second",
            [None if b is None else b.order_margin_ns / 1e9 for b in beats],
        ),
        (
            "camera_dropped",
            "frames and views replaced by newer ones",
            [None if b is None else b.dropped for b in beats],
        ),
        (
            "camera_clock_drift_ppm",
            "clock drift against the edge",
            [None if b is None else b.clock_drift_ppm for b in beats],
        ),
    )
