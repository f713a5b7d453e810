"""Quantities as people write them: 40mm, 10h, 20GB; in SI once they are read; 3 cameras in text.

What cannot be read raises an `InputError` without a thing: who knows what was asked for adds it
with `at`.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Mapping

from e3pose.base.errors import InputError

QUANTITY = re.compile(r"\s*([0-9]*\.?[0-9]+)\s*([a-z]*)\s*", re.IGNORECASE)
LENGTHS_M = {"mm": 0.001, "cm": 0.01, "m": 1.0}
FREQUENCIES_HZ = {"Hz": 1.0}
DURATIONS_S = {"ms": 0.001, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "w": 7 * 86400.0}
SIZES_BYTES = {"B": 1.0, "KB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12}
SHARES = {"": 1.0, "percent": 0.01}
ENERGIES_J = {"mJ": 0.001, "J": 1.0}
POWERS_W = {"mW": 0.001, "W": 1.0}
LONGEST_S = 1e8  # three years
MOST = 1e9  # of whatever unit: beyond it nothing is meant
LEAST_SIZE_BYTES = 10**6


def three_digits(value: float) -> str:
    """Write a number with three significant digits, without an exponent: 7610, 12.5, 0.00123."""
    return f"{float(f'{value:.3g}'):.12g}"


def length_m(text: str) -> float:
    """Read a length with its unit, such as 40mm, 4cm or 0.04m, in metres."""
    return quantity(text, LENGTHS_M, "40mm")


def duration_s(text: str) -> float:
    """Read a duration with its unit, such as 90s, 30min, 10h or 2d, in seconds."""
    return quantity(text, DURATIONS_S, "10h")


def power_w(text: str) -> float:
    """Read a power with its unit, such as 20W or 500mW, in watts."""
    return quantity(text, POWERS_W, "20W")


def frequency_hz(text: str) -> float:
    """Read a frequency with its unit, such as 6Hz."""
    return quantity(text, FREQUENCIES_HZ, "6Hz")


def age_s(text: str) -> float:
    """Read a retention time such as 12h, 30d or 2w, in seconds."""
    return quantity(text, DURATIONS_S, "30d")


def size_bytes(text: str) -> int:
    """Read the size of a store, such as 20GB or 500 MB, of a megabyte at least.

    Raises:
        InputError: for anything else, or less than 1 MB.
    """
    size = int(quantity(text, SIZES_BYTES, "20GB"))
    if size < LEAST_SIZE_BYTES:
        raise InputError("", repr(text), "at least 1MB")
    return size


def quantity(text: object, units: Mapping[str, float], example: str) -> float:
    """Read a number above 0 with one of some units, in whatever letters.

    Args:
        text: such as `1.5 h`.
        units: name to size.
        example: for the error.

    Raises:
        InputError: for anything else, 0, or a number beyond `MOST`.
    """
    wanted = f"a number and {', '.join(units)}, such as {example}"
    shown = repr(text[:40] if isinstance(text, str) else text)
    found = QUANTITY.fullmatch(text[:40]) if isinstance(text, str) else None
    unit = None if found is None else {u.lower(): u for u in units}.get(found[2].lower())
    if found is None or unit is None:
        raise InputError("", shown, wanted)
    if not 0 < float(found[1]) < MOST:
        raise InputError("", shown, f"more than 0 and not endless, such as {example}")
    return float(found[1]) * units[unit]


def number(text: object, what: str) -> float:
    """Read a number above 0; `what` names the expected quantity in an error."""
    try:
        value = float(text) if isinstance(text, str | int | float) else math.nan
    except ValueError:
        value = math.nan
    if isinstance(text, bool) or not (math.isfinite(value) and value > 0):
        shown = repr(text[:40] if isinstance(text, str) else text)
        raise InputError("", shown, what)
    return value


def milliseconds_s(value: object) -> float:
    """Read a number of milliseconds, in seconds.

    Raises:
        InputError: for anything but a number.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError("", repr(value)[:40], "a number of milliseconds")
    return value / 1000


def check_within(thing: str, value: float, low: float, high: float = math.inf) -> None:
    """Raise `InputError` for a number that is not finite and from `low` to `high`."""
    if not (low <= value <= high and math.isfinite(value)):
        found, least, most = (
            str(number) if isinstance(number, int) else f"{number:g}"
            for number in (value, low, high)
        )
        bounds = f"a number of at least {least}" if high == math.inf else f"{least} to {most}"
        raise InputError(thing, found, bounds)


def check_seconds(option: str, value: float | None) -> None:
    """Raise `InputError` for a number of seconds that nobody can wait for; None is none."""
    if value is not None and not 0 <= value <= LONGEST_S:
        raise InputError(option, f"{value:g}", f"0 to {LONGEST_S:g} seconds")


def plural(number: float, one: str, many: str = "") -> str:
    """Return `1 slot`, `2 slots`, `1.5 cameras`, `3 people`.

    Args:
        number: of them.
        one: what one of them is called.
        many: what several are called; with an s by default.
    """
    shown = str(number) if isinstance(number, int) else f"{number:g}"
    return f"{shown} {one if number == 1 else many or one + 's'}"


def shell(path: object) -> str:
    """Return a path or name as a word of a command to paste into a shell."""
    return shlex.quote(str(path))
