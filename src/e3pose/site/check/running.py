"""Problems of a running edge and its cameras."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import suppress

from e3pose.edge.camera_state import sleeps_as_told
from e3pose.model.blind_slot import blind_words
from e3pose.site.check.finding import Finding, ok, problem, warning
from e3pose.site.check.link import CLOCK_MS
from e3pose.wire.endpoint import Endpoint
from e3pose.wire.site_messages import Status

LISTEN_S = 1.0  # to find out whether a port is taken
BLIND_SHARE = 0.02  # of the last minute's slots


def running_problems(status: Status | None, endpoint: Endpoint) -> Iterator[Finding]:
    """Yield how the running edge and its cameras are, if there is one.

    Args:
        status: what it says; None if it does not answer.
        endpoint: where it was asked.
    """
    if status is None:
        found, advice = f"not running at {endpoint}", "e3pose edge, or e3pose up on one machine"
        host, port = endpoint.address
        with suppress(OSError):
            socket.create_connection((host, port), LISTEN_S).close()
            found = f"something listens at {endpoint}, but no edge of this site answers"
            advice = f"wait while it starts, or see whose port it is: ss -ltnp 'sport = :{port}'"
        yield warning("edge", found, advice)
        return
    yield ok("edge", f"running, slot {status.slot}, lead {status.lead}")
    advice = "a faster machine, fewer slots per second (fps) or fewer cameras"
    yield from [warning("edge", status.overload, advice)] * bool(status.overload)
    yield from [problem("calibration", status.doubt)] * bool(status.doubt)
    if status.blind_share > BLIND_SHARE:
        found = f"{status.blind_share:.0%} of the last minute's slots blind"
        advice = f"since its start: {blind_words(status.blind)}; docs/how-to/monitor.md"
        yield warning("edge", found, advice)
    for camera in status.cameras:
        what = f"camera {camera.camera_id}"
        if sleeps_as_told(camera):
            yield ok(what, camera.why)
        elif not camera.online:
            advice = "see its log"
            if camera.battery == 0 and not camera.gauge:
                advice = "charge it, then delete NAME.battery.json beside its camera file"
            yield problem(what, camera.why, advice)
        elif camera.turned_deg is not None:
            found = f"has moved: turned by {camera.turned_deg:.1f} degrees or more"
            advice = f"e3pose calibrate extrinsics SITE --only {camera.camera_id}"
            yield warning(what, found, advice)
        elif camera.why:
            yield warning(what, camera.why)
        elif abs(camera.clock_offset_ms) > CLOCK_MS:
            found = f"clock offset {camera.clock_offset_ms:+.1f} ms"
            yield warning(what, found, "corrected; for fast motion use chrony or PTP")
        else:
            found = f"connected, clock offset {camera.clock_offset_ms:+.1f} ms"
            if camera.unchanged is not None:
                found += f", image unchanged in {camera.unchanged:.0%} of its looks"
            yield ok(what, found)
