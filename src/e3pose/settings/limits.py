"""Checks shared by site files and camera files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from msgspec import Meta

from e3pose.base.errors import InputError
from e3pose.base.quantities import check_within

Sleep = Literal["off", "process", "suspend"]  # how orders may put a camera to sleep
SECONDS = "{seconds}"  # of a command that suspends: the time until its alarm
Rotation = Literal[0, 90, 180, 270]  # degrees clockwise that make people in an image upright
Pace = Annotated[float, Meta(ge=1e-3, le=1)]  # share of the speed of files and recordings


def check_smooth_delay(delay_ms: float, pipeline: str) -> None:
    """Raise `InputError` for a delay after which no poses can be smoothed; 0 is for none."""
    check_within("smooth_delay_ms", delay_ms, 0, 2_000)
    if delay_ms and pipeline == "paper":
        raise InputError(
            "smooth_delay_ms",
            "with the pipeline paper, whose estimator has nothing to smooth with",
            "the pipeline memory",
        )


def check_sleep(sleep: Sleep, command: Sequence[str]) -> None:
    """Raise `InputError` for a command that nothing uses, or that has no alarm."""
    if command and sleep != "suspend":
        raise InputError("suspend_command", f"it with sleep = {sleep!r}", "sleep = 'suspend'")
    if command and not any(SECONDS in word for word in command):
        raise InputError("suspend_command", "no {seconds}", "it in a word, for the alarm")


def check_source(name: str) -> None:
    """Raise `InputError` for the bare number of a device, which could be a file as well."""
    if name.isascii() and name.isdigit():
        raise InputError("source", repr(name), f"usb:{name} for the device /dev/video{name}")
