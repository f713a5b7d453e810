"""Frozen records that change in every slot."""

from dataclasses import dataclass, field

import pytest

from e3pose.base.records import changed


@dataclass(frozen=True, slots=True)
class Parent:
    one: int


@dataclass(frozen=True, slots=True)
class Child(Parent):
    two: str = "2"
    three: int = field(default=3, kw_only=True)


def test_a_record_is_another_one_with_other_fields() -> None:
    record = Child(1)
    assert changed(record, one=3) == Child(3) and record == Child(1)
    assert changed(record, one=3, two="4") == Child(3, "4")
    assert changed(Child(1, three=5), one=3) == Child(3, three=5)
    with pytest.raises(AttributeError, match="four"):
        changed(record, four=4)
