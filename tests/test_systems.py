"""macOS and Windows: two modules ask for the platform; all else works without what they lack."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Iterator

import pytest
from tests.distributions import PACKAGES, ROOT

SOURCE = PACKAGES["e3pose"]
# What runs at a site, and the hub.
TEXTS = {
    str(path.relative_to(SOURCE if at == SOURCE else at.parent)): path.read_text()
    for at in (SOURCE, PACKAGES["e3pose_hub"])
    for path in at.rglob("*.py")
}
# The rooms for what differs, and what each file that names a place of Linux does elsewhere.
ASKS = {"base/system.py", "base/child_process.py"}
PLACES = {
    "base/threads.py": "names no thread",
    "camera/probe.py": "finds no device, and no state to suspend to",
    "detectors/chooser.py": "finds no GPU of a Jetson",
    "detectors/weights/index.py": "finds no settings of pip",
    "settings/limits.py": "a message",
    "site/check/camera.py": "a message",
    "site/new_site.py": "a message",
}
LINUX_ONLY = {"fcntl", "grp", "pwd", "resource", "termios", "tty", "pty", "syslog", "msvcrt"}
# Encodings as on Windows: a text of ours that leaves its own open is an error.
WARNINGS = "filterwarnings=\nignore::EncodingWarning\nerror::EncodingWarning:e3pose\\..*"
TESTS = ("tests/base/test_lock.py", "tests/recording/test_writer.py", "tests/edge/test_server.py")
CHOSEN = "lock or writ or record or people_are_published or goes_on_where_it_was"


def asked(text: str) -> Iterator[str]:
    """Yield what a text asks of the platform: modules of one system, and which system it is."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names if name.name in LINUX_ONLY)
        elif isinstance(node, ast.ImportFrom) and node.module in LINUX_ONLY:
            yield str(node.module)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            name = f"{node.value.id}.{node.attr}"
            if name in ("sys.platform", "os.name", "platform.system"):
                yield name
        elif isinstance(node, ast.keyword) and node.arg in ("start_new_session", "preexec_fn"):
            yield str(node.arg)


def places(text: str) -> list[str]:
    """Return the texts that begin with or hold a path only Linux has."""
    texts = [node.value for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Constant)]
    roots = ("/dev/", "/proc/", "/sys/", "/etc")
    return [one for one in texts if isinstance(one, str) and any(r in one for r in roots)
            and "\n" not in one]  # fmt: skip


def test_the_platform_is_asked_in_its_rooms_alone() -> None:
    found = {file: [*asked(text)] for file, text in TEXTS.items()}
    assert {file for file, names in found.items() if names} == ASKS
    assert [*asked("import fcntl\nPopen(x, preexec_fn=f)\nsys.platform")] != []


def test_places_of_linux_are_named_where_they_may_be_missing() -> None:
    found = {file: places(text) for file, text in TEXTS.items()}
    assert {file for file, texts in found.items() if texts} == {*PLACES}


@pytest.mark.slow
@pytest.mark.parametrize("system", [pytest.param("darwin", marks=pytest.mark.nightly), "win32"])
def test_recordings_locks_and_an_edge_work_without_what_it_lacks(system: str) -> None:
    words = ("-q", "-o", WARNINGS, "-p", "tests.other_system", "-p", "no:cacheprovider")
    ended = subprocess.run(
        [sys.executable, "-m", "pytest", *words, "-k", CHOSEN, *TESTS],
        env={**os.environ, "OTHER_SYSTEM": system, "PYTHONWARNDEFAULTENCODING": "1"},
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stdout[-3000:] + ended.stderr[-1000:]
