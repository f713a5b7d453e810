"""What is imported or installed later: modules by name, messages that say how."""

from __future__ import annotations

import json
import re
from importlib.metadata import Distribution
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.distributions import PRODUCT, PROJECTS, ROOT

from e3pose.base.deferred import names_of
from e3pose.base.installing import FOLDERS, install_command


def test_it_installs_by_name_or_from_the_clone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clone = tmp_path / "my clone"
    clone.mkdir()
    for origin, expected in (
        (None, "pip install 'e3pose[lab]'"),
        ({"url": "https://index/e3pose.whl"}, "pip install 'e3pose[lab]'"),
        ({"url": clone.as_uri()}, "pip install 'e3pose[lab]'"),  # it went away
        ({"url": clone.as_uri()}, f"pip install '{clone}[lab]' '{clone / 'lab'}'"),
    ):
        said = SimpleNamespace(read_text=lambda name, of=origin: of and json.dumps(of))
        monkeypatch.setattr(Distribution, "from_name", lambda name, found=said: found)
        install_command.cache_clear()
        assert install_command("lab") == expected
        (clone / "pyproject.toml").write_text("") if origin and "file:" in origin["url"] else None
    install_command.cache_clear()


def test_no_message_has_a_command_of_its_own() -> None:
    literal = re.compile(r"pip install '?e3pose")
    found = [
        str(path.relative_to(ROOT))
        for part in ("src", "hub", "lab/e3pose_lab")
        for path in (ROOT / part).rglob("*.py")
        if literal.search(path.read_text())
    ]
    assert found == ["src/e3pose/base/installing.py"]


def test_every_extra_of_another_distribution_names_its_folder() -> None:
    extras = PROJECTS[PRODUCT]["optional-dependencies"]
    others = {name for name, needs in extras.items() if needs[0].startswith("e3pose-")}
    assert others == {*FOLDERS} and all((ROOT / part).is_dir() for part in FOLDERS.values())


def test_names_of_a_package_come_from_their_homes() -> None:
    find = names_of("e3pose", {"plural": "base.quantities"})
    assert find("plural")(2, "slot") == "2 slots"
    with pytest.raises(AttributeError, match=r"module 'e3pose' has no attribute 'absent'"):
        find("absent")
