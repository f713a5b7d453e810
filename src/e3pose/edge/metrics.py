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
from e3pose.wire.messages import Heartbeat, fields
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
        yield from _of_cameras(CameraStatus, status.cameras, status.cameras)
        beats = [camera.beat for camera in inbox.cameras]
        yield from _of_cameras(Heartbeat, status.cameras, beats)


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


def _of_cameras(
    kind: type[CameraStatus | Heartbeat],
    cameras: Sequence[CameraStatus],
    told: Sequence[CameraStatus | Heartbeat | None],
) -> Iterator[Any]:
    """Yield the metrics that a message of each camera has."""
    from prometheus_client.core import GaugeMetricFamily

    for name, text, uses in fields(kind):
        if not uses.metric:
            continue
        text = text.replace("None", "absent" if uses.unknown is None else f"{uses.unknown:g}")
        family = GaugeMetricFamily(f"e3pose_camera_{uses.metric}", text, labels=["camera"])
        for camera, message in zip(cameras, told, strict=True):
            value = None if message is None else getattr(message, name)
            value = uses.unknown if value is None else value
            if value is not None:
                family.add_metric([camera.camera_id], value / uses.per)
        yield family


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
