"""Fields of a power profile, checked one by one."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any

from e3pose.base.errors import InputError


def check_keys(
    table: Mapping[str, Any], expected: tuple[str, ...], where: str, prefix: str = ""
) -> None:
    """Raise `InputError` for a key that is missing or unknown."""
    for key in expected:
        if key not in table:
            raise InputError(f"{where}: {prefix}{key}: found nothing, expected a value")
    for key in table:
        if key not in expected:
            raise InputError(
                f"{where}: {prefix}{key[:40]}: found an unknown key, expected {', '.join(expected)}"
            )


def number(value: Any, most: float, where: str, field: str) -> float:
    """Return a number from 0 to `most`; raise `InputError` for anything else."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (is_number and isfinite(value) and 0 <= value <= most):
        raise error(where, field, value, f"0 to {most:g}")
    return float(value)


def text(value: Any, where: str, field: str) -> str:
    """Return a text of reasonable length; raise `InputError` for anything else."""
    if not isinstance(value, str) or not 1 <= len(value) <= 1000:
        raise error(where, field, value, "a text of 1 to 1000 characters")
    return value


def error(where: str, field: str, found: object, expected: str) -> InputError:
    """Return the error of a field."""
    return InputError(f"{where}: {field}: found {str(found)[:80]!r}, expected {expected}")
