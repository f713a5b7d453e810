"""Distributions of one version, and lock files that pin what they ask for."""

from __future__ import annotations

import importlib
import json
import os
import re
import runpy
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from email import message_from_bytes
from email.message import Message
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name, parse_wheel_filename
from tests.cases import each_case
from tests.distributions import FOLDERS, PACKAGES, PRODUCT, PROJECTS, ROOT

import e3pose

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
    tmp_path: Path,
    licenses: list[dict[str, Any]],
    refused: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "sbom.json"
    component = {"name": "thing", "version": "1", "licenses": licenses}
    path.write_text(json.dumps({"components": [component]}))
    monkeypatch.setattr(sys, "argv", ["licences.py", str(path)])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(ROOT / "requirements" / "licences.py"), run_name="__main__")
    assert ended.value.code == int(refused)
    assert "thing" in capsys.readouterr().out


def requirements(name: str) -> list[Requirement]:
    """Return all that a distribution needs, whatever extra is asked for."""
    said = PROJECTS[name]
    extras = said.get("optional-dependencies", {}).values()
    return [Requirement(line) for part in (said["dependencies"], *extras) for line in part]


def test_all_have_one_version_and_ask_for_it_of_each_other() -> None:
    assert len(PROJECTS) >= 3
    homes = {said["urls"]["Homepage"] for said in PROJECTS.values()}
    assert len(homes) == 1, "the README's links lead to one repository"
    for package, folder in FOLDERS.items():
        assert importlib.import_module(package).__version__ == e3pose.__version__
        assert (folder / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    for name in PROJECTS:
        others = {*PROJECTS} - {name} if name == PRODUCT else {PRODUCT}
        for other in others:
            asked = {str(one.specifier) for one in requirements(name) if one.name == other}
            assert asked == {f"=={e3pose.__version__}"}, f"{name} asks for {other} {asked}"


def run(*words: object, cwd: Path, **more: str) -> str:
    """Run a command as on a machine without this checkout; return what it prints."""
    kept = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
    ended = subprocess.run(
        [str(word) for word in words], cwd=cwd, env={**kept, **more}, capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stdout[-3000:] + ended.stderr[-3000:]
    return ended.stdout


@pytest.mark.nightly
@pytest.mark.network
@pytest.mark.parametrize("python", ["3.10", "3.13"])
def test_cameras_install_on_boards_of_64_bits_alone(python: str, tmp_path: Path) -> None:
    needs = [str(each) for each in asked("camera", "models")]
    for machine, works in (("aarch64", True), ("armv7l", False)):
        kinds = (f"manylinux_2_28_{machine}", f"manylinux_2_17_{machine}", f"linux_{machine}")
        ended = subprocess.run(
            [sys.executable, "-m", "pip", "install", "--dry-run", "--only-binary=:all:",
             "--target", str(tmp_path), "--python-version", python,
             *(word for kind in kinds for word in ("--platform", kind)), *needs],
            capture_output=True,
            text=True,
        )  # fmt: skip
        assert (ended.returncode == 0) is works, ended.stderr[-1000:]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder in which `make dist` left its files."""
    folder = tmp_path_factory.mktemp("built")
    run(
        *("make", f"DIST={folder / 'dist'}", f"DISTRIBUTOR={folder / 'tools'}"),
        *(f"VENV={Path(sys.prefix)}", f"PYTHON={sys.executable}", "dist"),
        cwd=ROOT,
    )
    return folder / "dist"


def metadata(wheel: Path) -> Message:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (one for one in archive.namelist() if one.endswith(".dist-info/METADATA"))
        return message_from_bytes(archive.read(name))


@pytest.mark.nightly
@pytest.mark.network
def test_what_an_index_shows(built: Path) -> None:
    found = {parse_wheel_filename(path.name)[0]: path for path in built.glob("*.whl")}
    assert {*found} == {*PROJECTS}
    assert len([*built.iterdir()]) == 2 * len(PROJECTS)  # and an sdist of each
    for name, wheel in found.items():
        said = metadata(wheel)
        assert (said["Name"], said["Version"]) == (name, e3pose.__version__)
        assert said["Summary"] and said["Description-Content-Type"] == "text/markdown"
        text = str(said.get_payload())
        assert text.startswith(f"# {name}\n") and "pip install 'e3pose[" in text
        assert not re.search(r"\]\((?!https?:)", text), "a link to a file that is not there"
        files = {one.split("/")[0] for one in zipfile.ZipFile(wheel).namelist()}
        package = name.replace("-", "_")
        assert files == {package, f"{package}-{e3pose.__version__}.dist-info"}
        licences = {Path(one).name for one in said.get_all("License-File", [])}
        assert "LICENSE" in licences and ("LICENSE-preact" in licences) == (name == "e3pose")


@pytest.fixture(scope="module")
def index(built: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the address of a package index that has all wheels."""
    folder = tmp_path_factory.mktemp("index")
    for wheel in built.glob("*.whl"):
        page = folder / parse_wheel_filename(wheel.name)[0] / "index.html"
        page.parent.mkdir()
        page.write_text(f'<!DOCTYPE html><a href="{wheel.as_uri()}">{wheel.name}</a>')
    return folder.as_uri()


@pytest.mark.nightly
@pytest.mark.network
def test_it_installs_by_name_and_works_in_an_empty_folder(index: str, tmp_path: Path) -> None:
    bin_, empty = tmp_path / "venv" / "bin", tmp_path / "empty"
    empty.mkdir()
    run(sys.executable, "-m", "venv", bin_.parent, cwd=empty)

    def install(what: str) -> None:
        run(bin_ / "pip", "install", "--extra-index-url", index, what, cwd=empty)

    def call(*words: object) -> str:
        return run(bin_ / "e3pose", *words, cwd=empty, NUMBA_CACHE_DIR=str(tmp_path / "compiled"))

    install("e3pose[all]")
    assert "simulate" in call("--help-all") and call("--version").strip() == e3pose.__version__
    call("simulate", "walk", "--people", "1", "--seconds", "1", "--cameras", "3")
    # The paper's pipeline is compiled in a third of the time of the default.
    call("replay", "walk", "--pipeline", "paper", "--cameras", "2", "--poses", "walk.parquet")
    assert (empty / "walk.parquet").is_file()
    verbs = {"hub": "hub", "reproduce": "lab"}  # and the extra that brings each
    for verb in verbs:
        assert "Not installed" in call(verb, "--help")
    assert [name for name in PACKAGES if [*bin_.parent.glob(f"lib/*/site-packages/{name}")]] == [
        PRODUCT
    ]
    for verb, extra in verbs.items():
        install(f"e3pose[{extra}]")
        assert "Not installed" not in call(verb, "--help")
