"""Check a camera's machine: source, network, sleep, clock, certificate, route to the edge."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.quantities import three_digits
from e3pose.camera.probe import RAM, Machine, examine
from e3pose.settings.camera_file import NodeTable
from e3pose.settings.sources import shown_source
from e3pose.site.check.finding import Finding, ok, problem, warning
from e3pose.site.check.link import CLOCK_MS, clock_problems
from e3pose.site.check.sources import password_problems
from e3pose.wire.keys.folder import link_of
from e3pose.wire.keys.renewal import SOON_DAYS
from e3pose.wire.reach import Reach, reach_edge

SLOW_TRIP_MS = 100.0
SOON = datetime.timedelta(days=SOON_DAYS)


def check_camera(node: NodeTable, timeout_s: float) -> list[Finding]:
    """Check the requirements of a camera on its own machine.

    Args:
        node: its file.
        timeout_s: how long to wait for the edge.
    """
    machine = examine(node)
    reach: Reach | InputError
    try:
        link = link_of("camera", node.site, node.endpoint, node.keys, insecure=node.insecure)
        reach = reach_edge(link, node.camera, timeout_s)
    except InputError as error:
        reach = error
    return [
        *_source(node, machine),
        *_network(node, machine.detect_s),
        *suspended(node, machine),
        *clock_problems(node.endpoint),
        *_edge(node, reach),
    ]


def suspended(node: NodeTable, machine: Machine) -> Iterator[Finding]:
    """Say whether a machine that may be suspended can be."""
    what, advice = "sleep", "sleep = 'process' where the machine cannot be suspended"
    if node.sleep != "suspend":
        return
    if isinstance(machine.suspend, InputError):
        yield problem(what, str(machine.suspend), advice)
        return
    words = " ".join(machine.suspend)
    if node.suspend_command:
        yield ok(what, f"suspended by {words}")
    elif RAM not in machine.states:
        listed = ", ".join(machine.states) or "none"
        found = f"the kernel has no suspend to RAM (states: {listed})"
        yield problem(what, found, advice)
    else:
        yield ok(what, f"suspended by {words}", "try it once: it needs root")


def _source(node: NodeTable, machine: Machine) -> Iterator[Finding]:
    what, seen = "source", machine.seen
    if node.path is not None:
        yield from password_problems(what, node.source, node.path)
    if isinstance(seen, InputError):
        advice = "connect the camera" if node.source.startswith("usb:") else ""
        yield problem(what, str(seen), advice)
        return
    width, height = seen.image_size
    named = shown_source(node.source, Path() if node.path is None else node.path.parent)
    yield ok(what, f"{named}: {width} x {height} at {seen.rate_words()}")
    if seen.note:
        yield warning(what, seen.note)
    if seen.dark:
        yield warning(what, "its picture is dark", "is the lens covered?")
    if node.fps is not None and seen.fps < 0.9 * node.fps:
        asked = f"gives {seen.fps:.3g} frames per second, fps asks for {node.fps:g}"
        yield warning(what, asked, f"fps = {seen.fps:.3g}")


def _network(node: NodeTable, detect_s: float | InputError | None) -> Iterator[Finding]:
    if isinstance(detect_s, InputError):
        yield problem("network", str(detect_s))
    elif detect_s is not None:
        rate = three_digits(1 / detect_s)
        found = f"{node.detector}: {1000 * detect_s:.0f} ms per detection, {rate} per second"
        yield ok("network", f"{found}; the site's fps and deadline_ms must allow for it")


def _edge(node: NodeTable, reach: Reach | InputError) -> Iterator[Finding]:
    if isinstance(reach, InputError):
        advice = f"e3pose keys add {node.camera} on the edge, then copy its folder here"
        yield problem("certificate", str(reach), advice)
        return
    if reach.expires is not None:
        soon = reach.expires - datetime.datetime.now(datetime.timezone.utc) < SOON
        again = f"e3pose keys add {node.camera} --again on the edge, then copy its folder here"
        until = f"{reach.expires:%Y-%m-%d}"
        if soon:
            yield warning("certificate", f"expires on {until}", again)
        else:
            yield ok("certificate", f"valid until {until}")
    host, place = node.endpoint.host, node.endpoint.place
    if reach.exchange is not None:
        trip_ms, offset_ms = reach.exchange.delay_ns / 1e6, reach.exchange.offset_ns / 1e6
        level = warning if trip_ms > SLOW_TRIP_MS else ok
        yield level("edge", f"answers at {place}, {trip_ms:.1f} ms there and back")
        if abs(offset_ms) > CLOCK_MS:
            found = f"{offset_ms:+.1f} ms from the edge's"
            yield warning("clock", found, "corrected; for fast motion use chrony or PTP")
        return
    if reach.outcome == "unknown":
        found = f"no address is known for {host}"
        advice = "its name or address in endpoint, and DNS or /etc/hosts of this machine"
    elif reach.outcome == "refused":
        found, advice = f"nothing listens at {place}", "start e3pose edge there"
    elif reach.outcome == "no-route":
        found = f"no route to {place} ({reach.reason})"
        advice = "the network, and whether a firewall lets the port through"
    else:
        found = f"{place} listens, but the edge of site {node.site} does not answer this camera"
        advice = f"is {node.camera} in its calibration, is the site's name {node.site}, and are "
        advice += "the certificates of one authority?"
    yield problem("edge", found, advice)
