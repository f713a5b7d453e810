"""Power profiles: what a camera node draws in each mode, with the source of each figure."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta

from e3pose.base.bounded import read_shipped
from e3pose.base.errors import InputError
from e3pose.base.table import check_bounds, entry, read_table
from e3pose.energy.modes import LOOKS, RESTS, SLOT_S, WAKE_S, CameraModes, Look, Rest, RestName

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
    """The power of a component in one mode."""

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


Mode = Literal["active", "power-saving", "aggressive-power-saving"]
Activity = Mode | Literal["asleep", "suspended"]  # what a camera does; components have no sleep

MODES: tuple[Mode, ...] = ("active", "power-saving", "aggressive-power-saving")
PROFILES = ("xavier-nx", "tx2", "generic")
# The paper compares the power of these, and leaves out what selection does not change (`rest`).
PAPER_GROUPS = ("cpu_gpu", "wifi", "ddr")
GROUPS = (*PAPER_GROUPS, "rest")

FORMAT = "e3pose-power-profile"
VERSION = 2  # 1 has no rows of rests and looks
MAX_BYTES = 100_000
MAX_COMPONENTS = 32
HAIR_W = 1e-6  # what sums of components differ by


@dataclass(frozen=True, slots=True)
class Component:
    """One consumer inside a device.

    Attributes:
        name: such as `gpu`.
        group: where the paper's comparison counts it: `cpu_gpu`, `wifi`, `ddr`, or `rest` (not).
        watts: power by mode.
        sources: where each figure comes from, by mode.
    """

    name: str
    group: str
    watts: Mapping[Mode, float]
    sources: Mapping[Mode, str]


@dataclass(frozen=True, slots=True)
class DeviceProfile:
    """The power of a camera node in each mode, by component, and its other abilities.

    Attributes:
        name: of the profile.
        title: of the device, for people.
        components: its consumers.
        rests: the ways of resting that the file states, in the order of `modes.RESTS`.
        looks: the ways of looking that the file states, in the order of `modes.LOOKS`.
    """

    name: str
    title: str
    components: tuple[Component, ...]
    rests: tuple[Rest, ...] = ()
    looks: tuple[Look, ...] = ()

    def watts(self, mode: Mode, group: str | None = None) -> float:
        """Return the power in `mode` of the whole device, or of one group of components."""
        return sum(c.watts[mode] for c in self.components if group in (None, c.group))

    def paper_watts(self, mode: Mode) -> float:
        """Return the power in `mode` of the components the paper compares: CPU, GPU, WiFi, DDR."""
        return sum(self.watts(mode, group) for group in PAPER_GROUPS)


def load_profile(name_or_path: str | Path) -> DeviceProfile:
    """Load a power profile that comes with the package, or one of the user's own.

    Args:
        name_or_path: one of `PROFILES`, or the path of a TOML file
            (`docs/reference/power-profiles.md`).

    Raises:
        InputError: naming the file and the field that is wrong.
    """
    return _decode(
        *read_shipped(name_or_path, "e3pose.energy.profiles", PROFILES, "device profile", MAX_BYTES)
    )


def modes_of(profile: DeviceProfile, interval_s: float = SLOT_S) -> CameraModes:
    """Return the table of a camera by its power profile.

    Rows that the profile states go first. Otherwise a look at the whole image takes what an active
    slot draws beyond an idle one, idling draws what `power-saving` says and not capturing what
    `aggressive-power-saving` says; sleep and suspension have to be stated.

    Args:
        profile: of the camera's device.
        interval_s: seconds per slot, for a look that the profile states by its power alone.
    """
    idle_w = profile.watts("power-saving")
    whole_j = (profile.watts("active") - idle_w) * interval_s
    slot = f"active less power-saving, {1e3 * interval_s:.4g} ms"
    off_w = profile.watts("aggressive-power-saving")
    rests = {
        "idle": Rest("idle", idle_w, source="power-saving"),
        "not-capturing": Rest(
            "not-capturing", off_w, wake_s=WAKE_S, source="aggressive-power-saving"
        ),
        **{rest.name: rest for rest in profile.rests},
    }
    looks = {
        "whole": Look("whole", whole_j, source=slot),
        "nothing": Look("nothing", 0.0, source="a slot without a look"),
        **{look.name: look for look in profile.looks},
    }
    return CameraModes(
        looks=tuple(looks[name] for name in LOOKS if name in looks),
        rests=tuple(rests[name] for name in RESTS if name in rests),
        table=f"profile {profile.name}",
    )


def _decode(table: Mapping[str, Any], where: str) -> DeviceProfile:
    try:
        return _profile(read_table(ProfileFile, table))
    except InputError as error:
        raise error.at(where) from None


def _profile(file: ProfileFile) -> DeviceProfile:
    if file.version == 1 and (file.rests or file.looks):
        raise InputError("version", 1, f"{VERSION} where a file states rests or looks")
    if not 1 <= (found := len(file.components)) <= MAX_COMPONENTS:
        raise InputError("components", f"{found} tables", f"1 to {MAX_COMPONENTS} tables")
    profile = DeviceProfile(
        file.name,
        file.title,
        tuple(_component(name, table) for name, table in file.components.items()),
        tuple(
            Rest(name, **asdict(file.rests[name])) for name in sorted(file.rests, key=RESTS.index)
        ),
        tuple(
            Look(name, **asdict(file.looks[name])) for name in sorted(file.looks, key=LOOKS.index)
        ),
    )
    if not profile.paper_watts("active") > 0:
        raise InputError("components", "no active power", "some of CPU, GPU, WiFi or DDR")
    for quieter, louder in zip(MODES[1:], MODES, strict=False):
        if profile.watts(quieter) > profile.watts(louder):
            found_w = f"{profile.watts(quieter):g} W in all"
            raise InputError(quieter, found_w, f"at most {profile.watts(louder):g} W ({louder})")
    most_w = profile.watts("power-saving")
    for rest in modes_of(profile).rests:
        if rest.watts > most_w + HAIR_W:
            most = f"at most {most_w:g} W, of the lighter rests"
            raise InputError(f"rests[{rest.name}].watts", f"{rest.watts:g} W", most)
        most_w = rest.watts
    return profile


def _component(name: str, table: ComponentTable) -> Component:
    rows = (table.active, table.power_saving, table.aggressive_power_saving)
    watts = {mode: row.watts for mode, row in zip(MODES, rows, strict=True)}
    sources = {mode: row.source for mode, row in zip(MODES, rows, strict=True)}
    return Component(name, table.group, watts, sources)


def profile_text(profile: DeviceProfile) -> str:
    """Return the file of a profile, which `load_profile` reads as the same profile."""
    lines = [
        f"format = {_quoted(FORMAT)}",
        f"version = {VERSION}",
        f"name = {_quoted(profile.name)}",
        f"title = {_quoted(profile.title)}",
    ]
    for part in profile.components:
        lines += ["", f"[components.{_quoted(part.name)}]", f"group = {_quoted(part.group)}"]
        lines += [
            f"{mode} = {{ watts = {part.watts[mode]!r}, source = {_quoted(part.sources[mode])} }}"
            for mode in MODES
        ]
    for rest in profile.rests:
        lines += ["", f"[rests.{rest.name}]", *_rest(rest)]
    for look in profile.looks:
        lines += ["", f"[looks.{look.name}]", *_look(look)]
    return "\n".join(lines) + "\n"


def _rest(rest: Rest) -> list[str]:
    return [
        f"watts = {float(rest.watts)!r}",
        f"enter_s = {float(rest.enter_s)!r}",
        f"wake_s = {float(rest.wake_s)!r}",
        f"wake_sd_s = {float(rest.wake_sd_s)!r}",
        f"source = {_quoted(rest.source)}",
    ]


def _look(look: Look) -> list[str]:
    return [
        f"joules = {float(look.joules)!r}",
        f"latency_s = {float(look.latency_s)!r}",
        f"source = {_quoted(look.source)}",
    ]


def _quoted(text: str) -> str:
    return json.dumps(text)  # a basic string of TOML has the escapes of JSON
