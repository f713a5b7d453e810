"""Prometheus metrics of an edge, on loopback."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from e3pose.edge.server import EdgeServer
from e3pose.errors import InputError
from e3pose.wire.site_messages import CameraStatus


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
        for name, text, level in (
            ("people", "people tracked in the newest slot", status.people),
            ("lead_slots", "slots between an order and its slot", status.lead),
            ("step_seconds_p50", "median computing time of a slot", status.step_ms[0] / 1e3),
            ("step_seconds_p99", "99th percentile", status.step_ms[1] / 1e3),
            ("latency_seconds_p50", "median from last view to poses", status.latency_ms[0] / 1e3),
            ("latency_seconds_p99", "99th percentile", status.latency_ms[1] / 1e3),
        ):
            yield GaugeMetricFamily(f"e3pose_{name}", text, value=level)
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


def serve_metrics(edge: EdgeServer, port: int) -> Any:
    """Serve the metrics on `http://127.0.0.1:PORT/metrics`; return the server, to be shut down.

    Raises:
        InputError: when the port is taken.
    """
    from prometheus_client import CollectorRegistry, start_http_server

    registry = CollectorRegistry()
    registry.register(EdgeCollector(edge))
    try:
        server, _thread = start_http_server(port, addr="127.0.0.1", registry=registry)
    except OSError as error:
        raise InputError(f"metrics_port: {port}: {error.strerror}, expected a free port") from None
    return server


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
            "camera_shift_pixels",
            "learned constant shift of its keypoints, which is subtracted",
            [c.shift_px for c in cameras],
        ),
        (
            "camera_turned_degrees",
            "least rotation since calibration",
            [c.turned_deg or 0.0 for c in cameras],
        ),
        ("camera_watts", "power draw", [c.power_w for c in cameras]),
        ("camera_battery", "remaining share of the battery", [c.battery for c in cameras]),
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
