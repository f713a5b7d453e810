"""Prometheus metrics of an edge, on loopback."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from e3pose.edge.server import EdgeServer
from e3pose.errors import InputError


class EdgeCollector:
    """Read an edge's status at every scrape; nothing is counted twice."""

    def __init__(self, edge: EdgeServer) -> None:
        self._edge = edge

    def collect(self) -> Iterator[Any]:
        """Yield the metrics, as prometheus_client asks."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        status, counts, inbox = self._edge.status(), self._edge.counts, self._edge.inbox
        beats = [life.beat for life in inbox.roster.lives]
        for name, text, value in (
            ("slots", "slots computed", counts.slots),
            ("slots_lost", "slots given up", counts.lost),
            ("views", "views that came in time", counts.views),
            ("wrong_messages", "messages that made no sense", inbox.wrong),
            ("unread_messages", "messages of a flood that were not read", inbox.flooded),
            ("unknown_messages", "messages of cameras that the rig lacks", inbox.strangers),
        ):
            yield CounterMetricFamily(f"e3pose_{name}", text, value=value)
        for name, text, level in (
            ("people", "people in the newest slot", status.people),
            ("lead_slots", "slots between an order and its slot", status.lead),
            ("step_seconds_p50", "median computing time of a slot", status.step_ms[0] / 1e3),
            ("step_seconds_p99", "99th percentile of it", status.step_ms[1] / 1e3),
            ("latency_seconds_p50", "median from last view to poses", status.latency_ms[0] / 1e3),
            ("latency_seconds_p99", "99th percentile of it", status.latency_ms[1] / 1e3),
        ):
            yield GaugeMetricFamily(f"e3pose_{name}", text, value=level)
        yield from _store(self._edge)
        for name, text, values in (
            ("camera_online", "whether a camera can be chosen", [c.online for c in status.cameras]),
            ("camera_duty", "share of slots in which it looked", [c.duty for c in status.cameras]),
            ("camera_deficit", "its energy deficit queue", [c.deficit for c in status.cameras]),
            ("camera_late_views", "views too late", [c.late for c in status.cameras]),
            ("camera_lost_views", "views never come", [c.lost for c in status.cameras]),
            (
                "camera_noise_factor",
                "sigma of its keypoints over what the noise file states",
                [c.noise_factor for c in status.cameras],
            ),
            (
                "camera_shift_pixels",
                "how far all of its keypoints are off the same way, which is taken off",
                [c.shift_px for c in status.cameras],
            ),
            (
                "camera_turned_degrees",
                "by how much, at least, it was turned since it was calibrated",
                [c.turned_deg or 0.0 for c in status.cameras],
            ),
            ("camera_watts", "what it draws", [c.power_w for c in status.cameras]),
            ("camera_battery", "share of its charge left", [c.battery for c in status.cameras]),
            ("camera_ordered_views", "views asked for in time", counts.ordered.tolist()),
            ("camera_orders", "orders that came", [b and b.orders for b in beats]),
            ("camera_late_orders", "orders too late", [b and b.late_orders for b in beats]),
            (
                "camera_order_margin_seconds",
                "how long before its slot the tightest order of the last half second came",
                [b and b.order_margin_ns / 1e9 for b in beats],
            ),
            ("camera_dropped", "frames and views given up", [b and b.dropped for b in beats]),
            (
                "camera_clock_drift_ppm",
                "how fast its clock leaves the edge's",
                [b and b.clock_drift_ppm for b in beats],
            ),
        ):
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
        ("store_trouble", "whether the store takes nothing", kept.trouble is not None),
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
