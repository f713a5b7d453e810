"""An install without lab and hub: their verbs say what to install, all others work."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from functools import reduce
from typing import Any

import pytest
from cyclopts import App
from tests.distributions import FOLDERS

from e3pose.base.errors import Exit
from e3pose.base.installing import not_installed
from e3pose.cli.app import app
from e3pose.cli.distributions import BELOW, EXTRAS, HUB, LAB, VERBS
from e3pose.edge.learn.trainer import main as train

# Runs commands where the packages of lab and hub cannot be found; says how each ended.
WITHOUT = """
import contextlib, io, json, sys
sys.modules["e3pose_lab"] = sys.modules["e3pose_hub"] = None
from e3pose.cli.app import main
for words in json.load(sys.stdin):
    out, err, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(words)
        except SystemExit as end:
            code = end.code
    print(json.dumps([code, out.getvalue(), err.getvalue()]))
"""

FIRST = {"learn": "replay", "hub": "run"}  # a verb of those that have verbs of their own
MOVED = {(verb, FIRST[verb]) if verb in FIRST else (verb,): at[0] for verb, at in VERBS.items()}
MOVED |= {(above, name): LAB for above, names in BELOW.items() for name in names}


def without_others(*commands: Sequence[str]) -> list[list[Any]]:
    """Return the code, output and error output of each command, run in one process."""
    ended = subprocess.run(
        [sys.executable, "-c", WITHOUT], input=json.dumps(commands), capture_output=True, text=True,
        cwd="/", timeout=120,
    )  # fmt: skip
    return [json.loads(line) for line in ended.stdout.splitlines()]


def test_verb_says_in_a_line_what_to_install() -> None:
    options = ("recording", "--out", "there", "--steps=3", "--quick")
    ended = without_others(*([*words, *options] for words in MOVED))
    for package, one in zip(MOVED.values(), ended, strict=True):
        assert one == [2, "", f"e3pose: {not_installed(package, EXTRAS[package])}\n"]


def test_help_lists_them_with_what_to_install() -> None:
    ended = without_others(["--help-all"], *([above, "--help"] for above in BELOW))
    said, *below = (" ".join(out.replace("│", " ").split()) for _, out, _ in ended)
    assert all(f"{verb} " in said for verb in VERBS)
    for package, extra in EXTRAS.items():
        mine = [at for at in VERBS.values() if at[0] == package]
        assert mine and said.count(f"(extra {extra})") == len(mine)
    for names, said in zip(BELOW.values(), below, strict=True):
        assert said.count("(extra lab)") == len(names) and all(f"{name} " in said for name in names)


def test_other_verbs_work_without() -> None:
    ((code, out, _),) = without_others(["models", "list"])
    assert code == 0 and "openpose" in out


def test_installed_they_have_their_own_verbs() -> None:
    assert {*EXTRAS} == {HUB, LAB} == {*FOLDERS}
    for words, package in MOVED.items():
        verb = reduce(App.__getitem__, words, app)
        assert str(verb.default_command.__module__).partition(".")[0] == package


def test_trainer_of_an_edge_says_what_to_install(capsys: pytest.CaptureFixture[str]) -> None:
    assert train(["job"], lab="no_lab.train.online") == Exit.REFUSED
    assert capsys.readouterr().err == not_installed("no_lab", "train") + "\n"
