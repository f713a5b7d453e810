"""Check the edge that runs, and its cameras."""

from __future__ import annotations

import socket
from collections.abc import Iterator

from e3pose.edge.camera_state import sleeps_as_told
from e3pose.model.blind_slot import blind_words
from e3pose.site.check.clock import CLOCK_MS
from e3pose.site.check.finding import Finding
from e3pose.wire.endpoint import Endpoint
from e3pose.wire.site_messages import CameraStatus, Status

LISTEN_S = 1.0  # to find out whether a port is taken
BLIND_SHARE = 0.02  # of the last minute's slots


def check_running(status: Status | None, endpoint: Endpoint) -> Iterator[Finding]:
    """Check the running edge and its cameras, if there is one.

    Args:
        status: what it says; None if it does not answer.
        endpoint: where it was asked.
    """
    if status is None:
        found, advice = f"not running at {endpoint}", "e3pose edge, or e3pose up on one machine"
        host, port = endpoint.address
        if _listens(host, port):
            found = f"something listens at {endpoint}, but no edge of this site answers"
            advice = f"wait while it starts, or see whose port it is: ss -ltnp 'sport = :{port}'"
        yield Finding("warning", "edge", found, advice)
        return
    yield Finding("ok", "edge", f"running, slot {status.slot}, lead {status.lead}")
    if status.overload:
        advice = "a faster machine, fewer slots per second (fps) or fewer cameras"
        yield Finding("warning", "edge", status.overload, advice)
    if status.blind_share > BLIND_SHARE:
        found = f"{status.blind_share:.0%} of the last minute's slots blind"
        advice = f"since its start: {blind_words(status.blind)}; docs/how-to/monitor.md"
        yield Finding("warning", "edge", found, advice)
    for camera in status.cameras:
        what = f"camera {camera.camera_id}"
        if sleeps_as_told(camera):
            yield Finding("ok", what, camera.why)
        elif not camera.online:
            advice = "see its log"
            if camera.battery == 0 and not camera.gauge:
                advice = "charge it, then delete NAME.battery.json beside its camera file"
            yield Finding("problem", what, camera.why, advice)
        elif camera.turned_deg is not None:
            found = f"has moved: turned by {camera.turned_deg:.1f} degrees or more"
            advice = f"e3pose calibrate extrinsics SITE --only {camera.camera_id}"
            yield Finding("warning", what, found, advice)
        elif camera.why:
            yield Finding("warning", what, camera.why)
        elif abs(camera.clock_offset_ms) > CLOCK_MS:
            found = f"clock offset {camera.clock_offset_ms:+.1f} ms"
            yield Finding("warning", what, found, "corrected; for fast motion use chrony or PTP")
        else:
            yield Finding("ok", what, _connected_words(camera))


def _connected_words(camera: CameraStatus) -> str:
    words = f"connected, clock offset {camera.clock_offset_ms:+.1f} ms"
    if camera.unchanged is None:
        return words
    return f"{words}, image unchanged in {camera.unchanged:.0%} of its looks"


def _listens(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), LISTEN_S).close()
    except OSError:
        return False
    return True
