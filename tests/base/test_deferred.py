"""Modules that are imported when they are first used."""

from __future__ import annotations

import pytest

from e3pose.base.deferred import names_of, require_module


def test_names_of_a_package_come_from_their_homes() -> None:
    find = names_of("e3pose", {"plural": "base.quantities"})
    assert find("plural")(2, "slot") == "2 slots"
    with pytest.raises(AttributeError, match=r"module 'e3pose' has no attribute 'absent'"):
        find("absent")


def test_missing_module_is_named_before_the_work() -> None:
    require_module("json")
    with pytest.raises(ModuleNotFoundError) as raised:
        require_module("no_such_module")
    assert raised.value.name == "no_such_module"
