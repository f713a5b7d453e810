"""Quantities with units, and values for all cameras or for each."""

from __future__ import annotations

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.base.quantities import check_within, duration_s, length_m
from e3pose.settings.energy import read_battery_wh


@each_case(("text", "metres"), [("40mm", 0.04), ("4cm", 0.04), ("0.04m", 0.04), (" 40 MM ", 0.04)])
def test_lengths(text: str, metres: float) -> None:
    assert length_m(text) == pytest.approx(metres)


@each_case(
    ("text", "seconds"),
    [("90s", 90), ("30min", 1800), ("10h", 36_000), ("1.5d", 129_600), ("2w", 1_209_600)],
)
def test_durations(text: str, seconds: float) -> None:
    assert duration_s(text) == pytest.approx(seconds)


@each_case(
    ("value", "low", "high", "said"),
    [
        (0.5, 1, 600, "0.5, expected 1 to 600"),
        (float("nan"), 1e-3, 1, "nan, expected 0.001 to 1"),
        (1_234_567, 1, 100_000, "1234567, expected 1 to 100000"),
        (float("inf"), 0, float("inf"), "inf, expected a number of at least 0"),
    ],
)
def test_a_number_outside_its_range_is_said_with_it(
    value: float, low: float, high: float, said: str
) -> None:
    check_within("--seconds", 1, 1, 1)
    with pytest.raises(InputError) as caught:
        check_within("--seconds", value, low, high)
    assert str(caught.value) == f"--seconds: found {said}"


@each_case("text", ["", "40", "mm", "-40mm", "40km", "nan", "1e3mm", "0mm", "4 0mm"])
def test_anything_else_names_the_units(text: str) -> None:
    with pytest.raises(InputError, match=r"found .*expected .*such as 40mm"):
        length_m(text)


@each_case(
    ("text", "values"),
    [("50", [50, 50, 50]), ("50,b=20", [50, 20, 50]), ("a=1,b=2,c=3", [1, 2, 3]), (50, [50] * 3)],
)
def test_one_for_all_or_one_for_each(text: object, values: list[float]) -> None:
    assert read_battery_wh(text).each("battery_wh", ["a", "b", "c"]) == values


@each_case(
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
