"""Read numbers and words from sysfs, or the reason why they are missing."""

from __future__ import annotations

import math
from pathlib import Path

from e3pose.base.errors import reason_of
from e3pose.energy.meters.base import MeterError

MAX_CHARS = 4096  # the kernel never shows more than a page


def read_text(path: Path) -> str:
    """Return the first line of a file; raise `MeterError` naming it if it cannot be read."""
    try:
        with path.open("rb") as file:
            content = file.read(MAX_CHARS)
    except OSError as error:
        raise MeterError(f"{path}: {reason_of(error).lower()}") from None
    return content.decode("utf-8", errors="replace").strip().split("\n")[0].strip()


def read_number(path: Path) -> float:
    """Return the number in a file; raise `MeterError` if it is none, or not finite."""
    text = read_text(path)
    try:
        value = float(text)
    except ValueError:
        raise MeterError(f"{path}: found {text[:40]!r}, expected a number") from None
    if not math.isfinite(value):
        raise MeterError(f"{path}: found {text[:40]!r}, expected a finite number")
    return value


def number_or_none(path: Path) -> float | None:
    """Return the number in a file, None where there is no such file or no number in it."""
    try:
        return read_number(path)
    except MeterError:
        return None
