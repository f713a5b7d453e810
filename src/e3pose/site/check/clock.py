"""Check whether a machine's clock is synchronised."""

from __future__ import annotations

import shutil
import subprocess

from e3pose.site.check.finding import Finding
from e3pose.wire.endpoint import Endpoint

CLOCK_MS = 5.0  # of a clock, before it is said


def check_clock(endpoint: Endpoint) -> Finding:
    """Check whether this machine's clock is synchronised, if cameras and edge have several.

    Args:
        endpoint: of the edge.
    """
    if endpoint.here_alone:
        return Finding("ok", "clock", "cameras and edge share this machine's clock")
    advice = "install chrony; for microseconds use PTP (linuxptp)"
    if shutil.which("chronyc"):
        answer = _ask("chronyc", "-c", "tracking").split(",")
        if len(answer) > 4 and answer[1] not in ("", "0.0.0.0"):
            found = f"synchronised by chrony to {answer[1]}, offset {answer[4]} s"
            return Finding("ok", "clock", found)
        return Finding("warning", "clock", "chrony has no server", "add a server to chrony.conf")
    if shutil.which("timedatectl"):
        if "NTPSynchronized=yes" in _ask("timedatectl", "show"):
            return Finding("ok", "clock", "synchronised by systemd-timesyncd")
        return Finding("warning", "clock", "not synchronised", advice)
    found = "no time synchronisation found; cameras measure and correct their offset"
    return Finding("warning", "clock", found, advice)


def _ask(*command: str) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=3, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout
