"""The lock files pin what pyproject.toml asks for, and licences that we may not use are refused."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from tests.cases import each_case
from tests.distributions import PROJECTS, ROOT

LOCKS = {"dev": ("dev",), "container": ("edge", "camera", "models", "build")}
ENVIRONMENTS = [
    {"python_version": f"3.{minor}", "python_full_version": f"3.{minor}.5",
     "sys_platform": "linux", "platform_system": "Linux", "platform_machine": machine,
     "os_name": "posix", "implementation_name": "cpython",
     "platform_python_implementation": "CPython"}
    for minor in (10, 11, 12, 13)
    for machine in ("x86_64", "aarch64")
]  # fmt: skip


def asked(*extras: str) -> Iterator[Requirement]:
    """Yield what the project needs with some extras."""
    waiting = [f"e3pose[{','.join(extras)}]"]
    while waiting:
        requirement = Requirement(waiting.pop())
        if requirement.name not in PROJECTS:
            yield requirement
            continue
        said = PROJECTS[requirement.name]
        waiting += said["dependencies"]
        for extra in requirement.extras:
            waiting += said.get("optional-dependencies", {})[extra]


def pinned(name: str) -> list[tuple[Requirement, int]]:
    """Return what a lock file pins, and how many hashes each has."""
    lines = (ROOT / "requirements" / f"{name}.txt").read_text().replace("\\\n", " ").splitlines()
    return [
        (Requirement(one.partition(" --hash")[0]), one.count("--hash=sha256:")) for one in lines
    ]


@pytest.mark.parametrize("name", LOCKS)
def test_lock_file_pins_what_the_project_asks_for(name: str) -> None:
    pins = pinned(name)
    for environment in ENVIRONMENTS:
        versions = {
            canonicalize_name(pin.name): next(iter(pin.specifier)).version
            for pin, _ in pins
            if pin.marker is None or pin.marker.evaluate(environment)
        }
        for requirement in asked(*LOCKS[name]):
            if requirement.marker is not None and not requirement.marker.evaluate(environment):
                continue
            found = versions.get(canonicalize_name(requirement.name))
            assert found is not None, f"{name}.txt does not pin {requirement}: run `make lock`"
            assert requirement.specifier.contains(found, prereleases=True), (
                f"{name}.txt pins {requirement.name} {found}, pyproject.toml asks for "
                f"{requirement.specifier}: run `make lock`"
            )


@pytest.mark.parametrize("name", LOCKS)
def test_lock_file_has_hashes_and_no_addresses(name: str) -> None:
    assert all(hashes > 0 for _, hashes in pinned(name))
    text = (ROOT / "requirements" / f"{name}.txt").read_text()
    assert "://" not in text and not re.search(r"^\s*-(?!-hash)", text, re.MULTILINE)


def test_container_and_ci_have_the_same_versions() -> None:
    both = [{(pin.name, str(pin.specifier)) for pin, _ in pinned(name)} for name in LOCKS]
    assert both[1] <= both[0]


@each_case(
    ("licenses", "refused"),
    [
        ([{"license": {"id": "MIT"}}], False),
        ([{"license": {"id": "GPL-3.0-only"}}], True),
        ([{"license": {"id": "AGPL-3.0-or-later"}}], True),
        ([{"license": {"id": "LGPL-2.1-or-later"}}], False),
        ([{"expression": "MIT OR GPL-2.0-only"}], False),
        ([{"expression": "MIT AND GPL-2.0-only"}], True),
        ([{"expression": "GPL-2.0-only AND (MIT OR BSD-3-Clause)"}], True),
        ([{"expression": "(MIT OR GPL-2.0-only) AND BSD-3-Clause"}], False),
        ([{"license": {"name": "License :: OSI Approved :: BSD License"}}], False),
        ([{"license": {"name": "License :: OSI Approved :: GNU General Public License v3"}}], True),
        ([{"license": {"name": "GNU Affero General Public License"}}], True),
        ([{"license": {"name": "GNU Lesser General Public License v3 (LGPLv3)"}}], False),
        ([{"license": {"name": "For non-commercial use only"}}], True),
        ([{"license": {"id": "CC-BY-NC-4.0"}}], True),
        ([{"license": {"name": "License :: OSI Approved"}}], True),
        ([], True),
    ],
    ids=str,
)
def test_licences_that_we_may_not_use_are_refused(
    tmp_path: Path, licenses: list[dict[str, Any]], refused: bool
) -> None:
    path = tmp_path / "sbom.json"
    component = {"name": "thing", "version": "1", "licenses": licenses}
    path.write_text(json.dumps({"components": [component]}))
    script = ROOT / "requirements" / "licences.py"
    ended = subprocess.run([sys.executable, script, path], capture_output=True, text=True)
    assert ended.returncode == int(refused), ended.stdout + ended.stderr
    assert "thing" in ended.stdout
