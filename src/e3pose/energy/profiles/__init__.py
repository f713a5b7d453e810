"""Power profiles: what a camera node draws in each mode, with the source of each figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast

from e3pose.base.shipped import read_shipped
from e3pose.energy.modes import LOOKS, RESTS, SLOT_S, WAKE_S, CameraModes, Look, Rest
from e3pose.energy.profiles.fields import check_keys, error, number, text
from e3pose.energy.profiles.rows import MAX_WATTS, read_looks, read_rests

Mode = Literal["active", "power-saving", "aggressive-power-saving"]
Activity = Mode | Literal["asleep", "suspended"]  # what a camera does; components have no sleep

MODES: tuple[Mode, ...] = ("active", "power-saving", "aggressive-power-saving")
PROFILES = ("xavier-nx", "tx2", "generic")
# The paper compares the power of these, and leaves out what selection does not change (`rest`).
PAPER_GROUPS = ("cpu_gpu", "wifi", "ddr")
GROUPS = (*PAPER_GROUPS, "rest")

FORMAT = "e3pose-power-profile"
VERSION = 2
READABLE = (1, VERSION)  # 1 has no rows of rests and looks
MAX_BYTES = 100_000
MAX_COMPONENTS = 32


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
    """What a camera node draws in each mode, by component, and what else it can do.

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


def _decode(data: Mapping[str, Any], where: str) -> DeviceProfile:
    if data.get("format") != FORMAT:
        raise error(where, "format", data.get("format"), f"{FORMAT!r}")
    version = data.get("version")
    if isinstance(version, bool) or version not in READABLE:
        raise error(where, "version", version, f"{VERSION}")
    rows = {key: data[key] for key in ("rests", "looks") if key in data and version != 1}
    rest = {key: value for key, value in data.items() if key not in rows}
    check_keys(rest, ("format", "version", "name", "title", "components"), where)
    name, title = (text(data[key], where, key) for key in ("name", "title"))
    tables = data["components"]
    if not isinstance(tables, dict) or not 1 <= len(tables) <= MAX_COMPONENTS:
        raise error(where, "components", tables, f"1 to {MAX_COMPONENTS} tables")
    components = tuple(_component(key, table, where) for key, table in tables.items())
    profile = DeviceProfile(name, title, components)
    if not profile.paper_watts("active") > 0:
        raise error(where, "components", "no active power", "some of CPU, GPU, WiFi or DDR")
    for quieter, louder in zip(MODES[1:], MODES, strict=False):
        if profile.watts(quieter) > profile.watts(louder):
            found = f"{profile.watts(quieter):g} W in all"
            raise error(where, quieter, found, f"at most {profile.watts(louder):g} W ({louder})")
    idle_w, off_w = profile.watts("power-saving"), profile.watts("aggressive-power-saving")
    return replace(
        profile,
        rests=read_rests(rows.get("rests"), where, idle_w, off_w),
        looks=read_looks(rows.get("looks"), where),
    )


def _component(key: str, table: Any, where: str) -> Component:
    field = f"components.{key[:40]}"
    if not isinstance(table, dict):
        raise error(where, field, table, "a table")
    check_keys(table, ("group", *MODES), where, f"{field}.")
    if table["group"] not in GROUPS:
        raise error(where, f"{field}.group", table["group"], f"one of {', '.join(GROUPS)}")
    watts: dict[Mode, float] = {}
    sources: dict[Mode, str] = {}
    for mode in MODES:
        figure = table[mode]
        if not isinstance(figure, dict):
            raise error(where, f"{field}.{mode}", figure, "{ watts = ..., source = '...' }")
        check_keys(figure, ("watts", "source"), where, f"{field}.{mode}.")
        watts[mode] = number(figure["watts"], MAX_WATTS, where, f"{field}.{mode}.watts")
        sources[mode] = text(figure["source"], where, f"{field}.{mode}.source")
    return Component(key, cast(str, table["group"]), watts, sources)
