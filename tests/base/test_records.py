"""Frozen records that change in every slot."""

from dataclasses import dataclass

import pytest

from e3pose.base.records import changed


@dataclass(frozen=True, slots=True)
class Parent:
    one: int


@dataclass(frozen=True, slots=True)
class Child(Parent):
    two: str = "2"


def test_a_record_is_another_one_with_other_fields() -> None:
    record = Child(1)
    assert changed(record, one=3) == Child(3) and record == Child(1)
    assert changed(record, one=3, two="4") == Child(3, "4")
    with pytest.raises(AttributeError, match="three"):
        changed(record, three=3)
