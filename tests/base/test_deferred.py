"""Modules that are imported when they are first used."""

from __future__ import annotations

import pytest

from e3pose.base.deferred import names_of


def test_names_of_a_package_come_from_their_homes() -> None:
    find = names_of("e3pose", {"plural": "base.quantities"})
    assert find("plural")(2, "slot") == "2 slots"
    with pytest.raises(AttributeError, match=r"module 'e3pose' has no attribute 'absent'"):
        find("absent")
