"""Modules that are imported when they are first used."""

from __future__ import annotations

import subprocess
import sys

import pytest

from e3pose.base.deferred import Deferred, names_of, require_module


def test_what_a_module_has_is_found_by_its_name() -> None:
    import e3pose.base.quantities

    quantities = Deferred("e3pose.base.quantities")
    assert quantities.plural is e3pose.base.quantities.plural
    assert quantities.plural(2, "slot") == "2 slots"


def test_what_a_module_lacks_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_thing"):
        Deferred("e3pose.base.quantities").no_such_thing  # noqa: B018


def test_nothing_is_imported_before_the_first_use() -> None:
    code = (
        "import sys\nfrom e3pose.base.deferred import Deferred\n"
        "zipfile = Deferred('zipfile')\nbefore = 'zipfile' in sys.modules\n"
        "zipfile.ZipFile\nprint(before, 'zipfile' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["False", "True"]


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
