"""The file of a power profile, as it is written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from msgspec import Meta

from e3pose.base.errors import InputError
from e3pose.base.table import check_bounds, entry
from e3pose.energy.modes import RestName

MAX_TEXT = 1000
Watts = Annotated[float, Meta(ge=0, le=10_000)]
Joules = Annotated[float, Meta(ge=0, le=10_000)]
Seconds = Annotated[float, Meta(ge=0, le=3600)]
MeasuredLook = Literal["whole", "part", "tracked", "gate"]
POWER = "{ watts = 1.0, source = '...' }"


def _text(found: Any) -> str:
    if not isinstance(found, str) or not 1 <= len(found) <= MAX_TEXT:
        raise InputError("", repr(str(found)[:80]), f"a text of 1 to {MAX_TEXT} characters")
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """Figures, and where they are from."""

    source: str = entry(read=_text)

    def __post_init__(self) -> None:
        """Check the figures."""
        check_bounds(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class PowerRow(Row):
    """What a component draws in one mode."""

    watts: Watts


@dataclass(frozen=True, slots=True, kw_only=True)
class RestRow(Row):
    """One `[rests.NAME]`: `modes.Rest` without its name."""

    watts: Watts
    enter_s: Seconds
    wake_s: Seconds
    wake_sd_s: Seconds


@dataclass(frozen=True, slots=True, kw_only=True)
class LookRow(Row):
    """One `[looks.NAME]`: `modes.Look` without its name."""

    joules: Joules
    latency_s: Seconds


@dataclass(frozen=True, slots=True, kw_only=True)
class ComponentTable:
    """One `[components.NAME]`."""

    group: Literal["cpu_gpu", "wifi", "ddr", "rest"]
    active: PowerRow = entry(write=POWER)
    power_saving: PowerRow = entry(write=POWER)
    aggressive_power_saving: PowerRow = entry(write=POWER)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfileFile:
    """All of the file."""

    format: Literal["e3pose-power-profile"]
    version: Literal[1, 2] = entry(write="2")
    name: str = entry(read=_text)
    title: str = entry(read=_text)
    components: Mapping[str, ComponentTable]
    rests: Mapping[RestName, RestRow] = field(default_factory=dict)
    looks: Mapping[MeasuredLook, LookRow] = field(default_factory=dict)
