"""The machine of one camera: what a site file and a camera file may both say of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from e3pose.base.table import check_bounds, entry

DETECTION = "Detection"  # a group of options


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
    battery_wh: Annotated[float, Meta(ge=1e-3, le=1e6)] | None = entry(
        None, group="Energy", help="Battery capacity. Default: mains power."
    )

    def __post_init__(self) -> None:
        check_bounds(self)
