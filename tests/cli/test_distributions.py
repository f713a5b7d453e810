"""An install without lab and hub: their verbs say what to install, all others work."""

from __future__ import annotations

import subprocess
import sys
from functools import reduce

import pytest
from cyclopts import App
from tests.cases import each_case
from tests.distributions import FOLDERS

from e3pose.base.errors import Exit
from e3pose.base.installing import not_installed
from e3pose.cli.app import app
from e3pose.cli.distributions import BELOW, EXTRAS, HUB, LAB, VERBS
from e3pose.edge.learn.trainer import main as train

# Runs the program where the packages of lab and hub cannot be found.
WITHOUT = """
import sys
sys.modules["e3pose_lab"] = sys.modules["e3pose_hub"] = None
from e3pose.cli.app import main
main()
"""

FIRST = {"learn": "replay", "hub": "run"}  # a verb of those that have verbs of their own
MOVED = {(verb, FIRST[verb]) if verb in FIRST else (verb,): at[0] for verb, at in VERBS.items()}
MOVED |= {(above, name): LAB for above, names in BELOW.items() for name in names}


def without_others(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", WITHOUT, *words]
    return subprocess.run(command, capture_output=True, text=True, cwd="/", timeout=120)


@each_case("words, package", MOVED.items())
def test_verb_says_in_a_line_what_to_install(words: tuple[str, ...], package: str) -> None:
    ended = without_others(*words, "recording", "--out", "there", "--steps=3", "--quick")
    extra = EXTRAS[package]
    assert ended.stderr == f"e3pose: {not_installed(package, extra)}\n"
    assert (ended.returncode, ended.stdout) == (2, "")


def unwrapped(ended: subprocess.CompletedProcess[str]) -> str:
    return " ".join(ended.stdout.replace("│", " ").split())


def test_help_lists_them_with_what_to_install() -> None:
    said = unwrapped(without_others("--help-all"))
    assert all(f"{verb} " in said for verb in VERBS)
    for package, extra in EXTRAS.items():
        mine = [at for at in VERBS.values() if at[0] == package]
        assert mine and said.count(f"(extra {extra})") == len(mine)
    for above, names in BELOW.items():
        said = unwrapped(without_others(above, "--help"))
        assert said.count("(extra lab)") == len(names) and all(f"{name} " in said for name in names)


def test_other_verbs_work_without() -> None:
    ended = without_others("models", "list")
    assert ended.returncode == 0 and "openpose" in ended.stdout


def test_installed_they_have_their_own_verbs() -> None:
    assert {*EXTRAS} == {HUB, LAB} == {*FOLDERS}
    for words, package in MOVED.items():
        verb = reduce(App.__getitem__, words, app)
        assert str(verb.default_command.__module__).partition(".")[0] == package


def test_trainer_of_an_edge_says_what_to_install(capsys: pytest.CaptureFixture[str]) -> None:
    assert train(["job"], lab="no_lab.train.online") == Exit.REFUSED
    assert capsys.readouterr().err == not_installed("no_lab", "train") + "\n"
