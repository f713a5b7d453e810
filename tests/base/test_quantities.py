"""Quantities with units, and values for all cameras or for each."""

from __future__ import annotations

import pytest

from e3pose.base.errors import InputError
from e3pose.base.quantities import duration_s, length_m
from e3pose.settings.energy import read_battery_wh


@pytest.mark.parametrize(
    ("text", "metres"), [("40mm", 0.04), ("4cm", 0.04), ("0.04m", 0.04), (" 40 MM ", 0.04)]
)
def test_lengths(text: str, metres: float) -> None:
    assert length_m(text) == pytest.approx(metres)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("90s", 90), ("30min", 1800), ("10h", 36_000), ("1.5d", 129_600), ("2w", 1_209_600)],
)
def test_durations(text: str, seconds: float) -> None:
    assert duration_s(text) == pytest.approx(seconds)


@pytest.mark.parametrize("text", ["", "40", "mm", "-40mm", "40km", "nan", "1e3mm", "0mm", "4 0mm"])
def test_anything_else_names_the_units(text: str) -> None:
    with pytest.raises(InputError, match=r"found .*expected .*such as 40mm"):
        length_m(text)


@pytest.mark.parametrize(
    ("text", "values"),
    [("50", [50, 50, 50]), ("50,b=20", [50, 20, 50]), ("a=1,b=2,c=3", [1, 2, 3]), (50, [50] * 3)],
)
def test_one_for_all_or_one_for_each(text: object, values: list[float]) -> None:
    assert read_battery_wh(text).each("battery_wh", ["a", "b", "c"]) == values


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a=1", "nothing for camera b"),
        ("1,2", "two values"),
        ("1,z=2", "camera 'z'"),
        ("0", "found '0'"),
        ("1,a=inf", "found 'inf'"),
        ("", "found ''"),
        (True, "found True"),
    ],
)
def test_wrong_values_are_named(text: object, said: str) -> None:
    with pytest.raises(InputError) as error:
        read_battery_wh(text).each("battery_wh", ["a", "b"])
    assert said in str(error.value)
