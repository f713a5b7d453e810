"""Quantities as users write them: 40mm, 10h, and one value for all cameras or for each."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from e3pose.errors import InputError

T = TypeVar("T")

QUANTITY = re.compile(r"\s*([0-9]*\.?[0-9]+)\s*([a-z]*)\s*", re.IGNORECASE)
LENGTHS_M = {"mm": 0.001, "cm": 0.01, "m": 1.0}
LONGEST_S = 1e8  # three years
FREQUENCIES_HZ = {"hz": 1.0}
DURATIONS_S = {"ms": 0.001, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}


def length_m(option: str, text: str) -> float:
    """Read a length with its unit, such as 40mm, 4cm or 0.04m, in metres."""
    return _quantity(option, text, LENGTHS_M, "40mm")


def duration_s(option: str, text: str) -> float:
    """Read a duration with its unit, such as 90s, 30min, 10h or 2d, in seconds."""
    return _quantity(option, text, DURATIONS_S, "10h")


def frequency_hz(option: str, text: str) -> float:
    """Read a frequency with its unit, such as 6Hz."""
    return _quantity(option, text, FREQUENCIES_HZ, "6Hz")


def per_camera(
    option: str, text: str, camera_ids: Sequence[str], read: Callable[[str], T], example: str
) -> list[T]:
    """Read one value for all cameras, exceptions as `camera=value`, or both, with commas.

    Args:
        option: for errors.
        text: such as `50`, `50,cam1=20` or `cam1=20,cam2=50`.
        camera_ids: of the rig.
        read: reads one value.
        example: of the option, for errors.

    Returns:
        One value a camera.

    Raises:
        InputError: for a camera that the rig does not have, or one that is left without a value.
    """
    usual: list[T] = []
    special: dict[str, T] = {}
    for part in text.split(","):
        name, equals, value = part.strip().rpartition("=")
        if not equals:
            if usual:
                raise InputError(f"{option}: found two values for all cameras, expected {example}")
            usual.append(read(part.strip()))
        elif name not in camera_ids:
            raise InputError(
                f"{option}: found camera {name[:40]!r}, expected one of {', '.join(camera_ids)}"
            )
        else:
            special[name] = read(value)
    missing = [camera_id for camera_id in camera_ids if camera_id not in special]
    if missing and not usual:
        raise InputError(f"{option}: found nothing for camera {missing[0]}, expected {example}")
    return [special[c] if c in special else usual[0] for c in camera_ids]


def check_seconds(option: str, value: float | None) -> None:
    """Raise `InputError` for a number of seconds that nobody can wait for; None is none."""
    if value is not None and not 0 <= value <= LONGEST_S:
        raise InputError(f"{option}: found {value:g}, expected 0 to {LONGEST_S:g} seconds")


def number(option: str, text: str, example: str) -> float:
    """Read a number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"{option}: found {text[:40]!r}, expected {example}")
    return value


def _quantity(option: str, text: str, units: Mapping[str, float], example: str) -> float:
    found = QUANTITY.fullmatch(text[:40])
    if found is None or found[2].lower() not in units:
        raise InputError(
            f"{option}: found {text[:40]!r}, expected a number and {', '.join(units)}, "
            f"such as {example}"
        )
    value = float(found[1]) * units[found[2].lower()]
    if not value > 0:
        raise InputError(f"{option}: found {text[:40]!r}, expected more than 0")
    return value
