"""Check a camera's machine: source, network, certificate, clock, route to the edge."""

from __future__ import annotations

import datetime
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from e3pose.base.clock import WallClock
from e3pose.base.errors import InputError
from e3pose.base.quantities import three_digits
from e3pose.camera.orientation import Orientation
from e3pose.camera.probe import probe
from e3pose.camera.sleep import SUSPEND, open_suspend
from e3pose.detectors.timing import DEFAULT_SIZE, Workload, time_detections
from e3pose.settings.camera_file import NodeTable
from e3pose.settings.sources import is_recorded, shown_source
from e3pose.site.camera_program import camera_link
from e3pose.site.check import CLOCK_MS, Finding, Level, check_clock
from e3pose.wire import topics
from e3pose.wire.access import Certificates, Link
from e3pose.wire.codec import decode, encode
from e3pose.wire.keys.renewal import SOON_DAYS
from e3pose.wire.messages import ClockAnswer, ClockQuestion
from e3pose.wire.network import open_network
from e3pose.wire.offset import Exchange

CONNECT_S = 3.0
SLOW_TRIP_MS = 100.0
STATES = Path("/sys/power/state")


def check_camera(node: NodeTable, timeout_s: float) -> Iterator[Finding]:
    """Check the requirements of a camera on its own machine.

    Args:
        node: its file.
        timeout_s: how long to wait for the edge.
    """
    size = None
    for finding, found_size in _source(node):
        yield finding
        size = found_size or size
    yield from _network(node, size)
    if node.sleep == "suspend":
        yield check_suspend(node, STATES)
    yield check_clock(node.endpoint)
    try:
        link = camera_link(node)
    except InputError as error:
        advice = f"e3pose keys add {node.camera} on the edge, then copy its folder here"
        yield Finding("problem", "certificate", str(error), advice)
        return
    if link.certificates is not None:
        yield _certificate(node, link.certificates)
    yield from _route(node, link, timeout_s)


def check_suspend(node: NodeTable, states: Path) -> Finding:
    """Check whether a machine that may be suspended can be.

    Args:
        node: its file.
        states: where the kernel lists the states that it knows.
    """
    what, advice = "sleep", "sleep = 'process' where the machine cannot be suspended"
    try:
        suspend = open_suspend(node.sleep, node.suspend_command)
    except InputError as error:
        return Finding("problem", what, str(error), advice)
    words = " ".join(SUSPEND if suspend is None else suspend.command)
    if node.suspend_command:
        return Finding("ok", what, f"suspended by {words}")
    try:
        known = states.read_text(encoding="utf-8").split()
    except OSError:
        known = []
    if "mem" not in known:
        listed = ", ".join(known) or "none"
        found = f"the kernel has no suspend to RAM (states: {listed})"
        return Finding("problem", what, found, advice)
    return Finding("ok", what, f"suspended by {words}", "try it once: it needs root")


def _source(node: NodeTable) -> Iterator[tuple[Finding, tuple[int, int] | None]]:
    what = "source"
    try:
        seen = probe(node.source, node.camera, node.fps)
    except InputError as error:
        advice = "connect the camera" if node.source.startswith("usb:") else ""
        yield Finding("problem", what, str(error), advice), None
        return
    width, height = seen.image_size
    named = shown_source(node.source, Path() if node.path is None else node.path.parent)
    shown = f"{named}: {width} x {height} at {seen.rate_words()}"
    yield Finding("ok", what, shown), seen.image_size
    if seen.dark:
        yield Finding("warning", what, "its picture is dark", "is the lens covered?"), None
    if node.fps is not None and seen.fps < 0.9 * node.fps:
        asked = f"gives {seen.fps:.3g} frames per second, fps asks for {node.fps:g}"
        yield Finding("warning", what, asked, f"fps = {seen.fps:.3g}"), None


def _network(node: NodeTable, size: tuple[int, int] | None) -> Iterator[Finding]:
    if is_recorded(node.source):
        return
    seen_size = Orientation.from_degrees(node.rotation).size(*(size or DEFAULT_SIZE))
    workload = Workload(node.detector, node.model, node.provider, node.threads, seen_size)
    try:
        detect_s = float(time_detections([workload]).alone_s[0])
    except InputError as error:
        yield Finding("problem", "network", str(error))
        return
    rate = three_digits(1 / detect_s)
    found = f"{node.detector}: {1000 * detect_s:.0f} ms per detection, {rate} per second"
    yield Finding("ok", "network", f"{found}; the site's fps and deadline_ms must allow for it")


def _certificate(node: NodeTable, files: Certificates) -> Finding:
    from e3pose.wire.keys.authority import expires

    until = expires(files.certificate.read_bytes())
    soon = until - datetime.datetime.now(datetime.timezone.utc) < datetime.timedelta(days=SOON_DAYS)
    again = f"e3pose keys add {node.camera} --again on the edge, then copy its folder here"
    if soon:
        return Finding("warning", "certificate", f"expires on {until:%Y-%m-%d}", again)
    return Finding("ok", "certificate", f"valid until {until:%Y-%m-%d}")


def _route(node: NodeTable, link: Link, timeout_s: float) -> Iterator[Finding]:
    """Look for the edge: its name, its port, whether it lets the camera in, and its clock."""
    host, place = node.endpoint.host, node.endpoint.place
    try:
        socket.create_connection(node.endpoint.address, CONNECT_S).close()
    except socket.gaierror:
        advice = "its name or address in endpoint, and DNS or /etc/hosts of this machine"
        yield Finding("problem", "edge", f"no address is known for {host}", advice)
        return
    except ConnectionRefusedError:
        yield Finding("problem", "edge", f"nothing listens at {place}", "start e3pose edge there")
        return
    except OSError as error:
        advice = "the network, and whether a firewall lets the port through"
        yield Finding("problem", "edge", f"no route to {place} ({error.strerror or error})", advice)
        return
    exchange = _ask_time(node, link, timeout_s)
    if exchange is None:
        found = f"{place} listens, but the edge of site {node.site} does not answer this camera"
        advice = f"is {node.camera} in its calibration, is the site's name {node.site}, and are "
        yield Finding("problem", "edge", found, advice + "the certificates of one authority?")
        return
    trip_ms, offset_ms = exchange.delay_ns / 1e6, exchange.offset_ns / 1e6
    level: Level = "warning" if trip_ms > SLOW_TRIP_MS else "ok"
    yield Finding(level, "edge", f"answers at {place}, {trip_ms:.1f} ms there and back")
    if abs(offset_ms) > CLOCK_MS:
        found = f"{offset_ms:+.1f} ms from the edge's"
        yield Finding("warning", "clock", found, "corrected; for fast motion use chrony or PTP")


def _ask_time(node: NodeTable, link: Link, timeout_s: float) -> Exchange | None:
    """Exchange times with the edge, as a camera does; None if it does not answer."""
    transport, clock = open_network(link), WallClock()
    topic = topics.of_camera(node.site, node.camera, "clock")
    end_s, pause = time.monotonic() + timeout_s, threading.Event()
    try:
        while True:
            asked_ns = clock.now_ns()
            payload = transport.ask(topic, encode(ClockQuestion(node.camera, asked_ns)), 0.5)
            answered_ns = clock.now_ns()
            if payload is not None:
                answer = decode(payload, ClockAnswer, "edge")
                return Exchange.of_stamps(
                    asked_ns, answer.received_edge_ns, answer.sent_edge_ns, answered_ns
                )
            if time.monotonic() >= end_s:
                return None
            pause.wait(0.1)
    except InputError:
        return None
    finally:
        transport.close()
