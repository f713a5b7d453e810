"""Power profiles: what a camera node draws in each mode, with the source of each figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

from e3pose.base.errors import InputError
from e3pose.base.shipped import read_shipped

Mode = Literal["active", "power-saving", "aggressive-power-saving"]

MODES: tuple[Mode, ...] = ("active", "power-saving", "aggressive-power-saving")
PROFILES = ("xavier-nx", "tx2", "generic")
# The paper compares the power of these, and leaves out what selection does not change (`rest`).
PAPER_GROUPS = ("cpu_gpu", "wifi", "ddr")
GROUPS = (*PAPER_GROUPS, "rest")

FORMAT = "e3pose-power-profile"
VERSION = 1
MAX_BYTES = 100_000
MAX_COMPONENTS = 32
MAX_WATTS = 10_000.0


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
    """What a camera node draws in each mode, by component."""

    name: str
    title: str
    components: tuple[Component, ...]

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


def _decode(data: Mapping[str, Any], where: str) -> DeviceProfile:
    if data.get("format") != FORMAT:
        raise _error(where, "format", data.get("format"), f"{FORMAT!r}")
    if isinstance(data.get("version"), bool) or data.get("version") != VERSION:
        raise _error(where, "version", data.get("version"), f"{VERSION}")
    _check_keys(data, ("format", "version", "name", "title", "components"), where)
    name, title = (_text(data[key], where, key) for key in ("name", "title"))
    tables = data["components"]
    if not isinstance(tables, dict) or not 1 <= len(tables) <= MAX_COMPONENTS:
        raise _error(where, "components", tables, f"1 to {MAX_COMPONENTS} tables")
    components = tuple(_component(key, table, where) for key, table in tables.items())
    profile = DeviceProfile(name, title, components)
    if not profile.paper_watts("active") > 0:
        raise _error(where, "components", "no active power", "some of CPU, GPU, WiFi or DDR")
    for quieter, louder in zip(MODES[1:], MODES, strict=False):
        if profile.watts(quieter) > profile.watts(louder):
            found = f"{profile.watts(quieter):g} W in all"
            raise _error(where, quieter, found, f"at most {profile.watts(louder):g} W ({louder})")
    return profile


def _component(key: str, table: Any, where: str) -> Component:
    field = f"components.{key[:40]}"
    if not isinstance(table, dict):
        raise _error(where, field, table, "a table")
    _check_keys(table, ("group", *MODES), where, f"{field}.")
    if table["group"] not in GROUPS:
        raise _error(where, f"{field}.group", table["group"], f"one of {', '.join(GROUPS)}")
    watts: dict[Mode, float] = {}
    sources: dict[Mode, str] = {}
    for mode in MODES:
        figure = table[mode]
        if not isinstance(figure, dict):
            raise _error(where, f"{field}.{mode}", figure, "{ watts = ..., source = '...' }")
        _check_keys(figure, ("watts", "source"), where, f"{field}.{mode}.")
        value = figure["watts"]
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (number and 0 <= value <= MAX_WATTS):
            raise _error(where, f"{field}.{mode}.watts", value, f"0 to {MAX_WATTS:g}")
        watts[mode] = float(value)
        sources[mode] = _text(figure["source"], where, f"{field}.{mode}.source")
    return Component(key, cast(str, table["group"]), watts, sources)


def _check_keys(
    table: Mapping[str, Any], expected: tuple[str, ...], where: str, prefix: str = ""
) -> None:
    for key in expected:
        if key not in table:
            raise InputError(f"{where}: {prefix}{key}: found nothing, expected a value")
    for key in table:
        if key not in expected:
            raise InputError(
                f"{where}: {prefix}{key[:40]}: found an unknown key, expected {', '.join(expected)}"
            )


def _text(value: Any, where: str, field: str) -> str:
    if not isinstance(value, str) or not 1 <= len(value) <= 1000:
        raise _error(where, field, value, "a text of 1 to 1000 characters")
    return value


def _error(where: str, field: str, found: object, expected: str) -> InputError:
    return InputError(f"{where}: {field}: found {str(found)[:80]!r}, expected {expected}")
