"""Shared parts of site files and camera files: the machine of a camera, types and checks."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta

from e3pose.base.errors import InputError
from e3pose.base.quantities import check_within
from e3pose.base.table import check_bounds, entry

DETECTION = "Detection"  # a group of options
Sleep = Literal["off", "process", "suspend"]  # how orders may put a camera to sleep
SECONDS = "{seconds}"  # of a command that suspends: the time until its alarm
Rotation = Literal[0, 90, 180, 270]  # degrees clockwise that make people in an image upright
Pace = Annotated[float, Meta(ge=1e-3, le=1)]  # share of the speed of files and recordings


def read_size(found: object) -> tuple[int, int]:
    """Read an image size such as `1280x720`."""
    match = re.fullmatch(r"(\d{2,5}) ?x ?(\d{2,5})", str(found))
    if match is None:
        raise InputError("", repr(str(found)[:40]), "WIDTHxHEIGHT in pixels, such as 1280x720")
    return int(match[1]), int(match[2])


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraMachine:
    """Settings of the computer that detects, and of its battery; see `LoopSettings` for the help.

    Raises:
        InputError: naming the key, for what no camera has.
    """

    model: Path | None = entry(None, group=DETECTION, help="Network file.")
    provider: str = entry(
        "auto",
        group=DETECTION,
        help="Execution provider: auto, tensorrt, cuda, openvino, coreml, cpu.",
    )
    threads: Annotated[int, Meta(ge=1, le=1024)] | None = entry(
        None, group=DETECTION, help="CPU threads of the network. Default: all cores."
    )
    wake_s: Annotated[float, Meta(ge=0, le=3600)] = entry(
        0.5, help="Seconds from aggressive power-saving to the first frame."
    )
    delay_ms: Annotated[float, Meta(ge=0, le=10_000)] = entry(
        0.0,
        help="""Milliseconds from the moment that a frame shows to its arrival; `e3pose sync` finds
        them.""",
    )
    gate: bool = entry(
        False,
        group=DETECTION,
        help="""Let the network rest while nothing changes in the image: for rooms that are often
        empty, and people who sit still. The network runs every two seconds all the same.""",
    )
    size: tuple[int, int] | None = entry(
        None,
        read=read_size,
        help="""Image size to ask a webcam or board for, such as 1280x720. Default: that of the
        site's calibration, else 1280x720.""",
    )
    battery_wh: Annotated[float, Meta(ge=1e-3, le=1e6)] | None = entry(
        None, group="Energy", help="Battery capacity. Default: mains power."
    )

    def __post_init__(self) -> None:
        check_bounds(self)


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
