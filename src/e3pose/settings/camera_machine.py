"""The machine of one camera: what a site file and a camera file may both say of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from e3pose.base.table import entry
from e3pose.settings.limits import check_within

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
    threads: int | None = entry(
        None, group=DETECTION, help="CPU threads of the network. Default: all cores."
    )
    wake_s: float = entry(0.5, help="Seconds from aggressive power-saving to the first frame.")
    delay_ms: float = entry(
        0.0,
        help="""Milliseconds from the moment that a frame shows to its arrival; `e3pose sync` finds
        them.""",
    )
    battery_wh: float | None = entry(
        None, group="Energy", help="Battery capacity. Default: mains power."
    )

    def __post_init__(self) -> None:
        check_within("wake_s", self.wake_s, 0, 3600)
        check_within("delay_ms", self.delay_ms, 0, 10_000)
        if self.threads is not None:
            check_within("threads", self.threads, 1, 1024)
        if self.battery_wh is not None:
            check_within("battery_wh", self.battery_wh, 1e-3, 1e6)
