"""An install without lab and hub: their verbs say what to install, all others work."""

from __future__ import annotations

import subprocess
import sys
from functools import reduce
from pathlib import Path

import pytest
from cyclopts import App
from tests.cases import each_case

from e3pose.cli.app import app
from e3pose.cli.lab import BELOW, HUB, LAB, LAB_VERBS
from e3pose.edge.learn.job import LACKS_TORCH
from e3pose.edge.learn.trainer import main as train

# Runs the program where the packages of lab and hub cannot be found.
WITHOUT = """
import sys
sys.modules["e3pose_lab"] = sys.modules["e3pose_hub"] = None
from e3pose.cli.app import main
main()
"""

MOVED = [(verb, "replay") if verb == "learn" else (verb,) for verb in LAB_VERBS]
MOVED += [(above, name) for above, names in BELOW.items() for name in names]


def without_lab(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", WITHOUT, *words]
    return subprocess.run(command, capture_output=True, text=True, cwd="/", timeout=120)


@each_case("words", MOVED)
def test_verb_says_in_a_line_what_to_install(words: tuple[str, ...]) -> None:
    ended = without_lab(*words, "recording", "--out", "there", "--steps=3", "--quick")
    assert ended.stderr == "e3pose: e3pose_lab is not installed: pip install 'e3pose[lab]'\n"
    assert (ended.returncode, ended.stdout) == (2, "")


@each_case("words", [(), ("--help",), ("run", "house"), ("query", "house", "--csv", "a")])
def test_hub_says_in_a_line_what_to_install(words: tuple[str, ...]) -> None:
    ended = without_lab("hub", *words)
    if words == ("--help",):
        assert ended.returncode == 0 and "pip install 'e3pose[hub]'" in ended.stdout
    else:
        assert ended.stderr == "e3pose: e3pose_hub is not installed: pip install 'e3pose[hub]'\n"
        assert (ended.returncode, ended.stdout) == (2, "")


def test_help_lists_them_with_what_to_install() -> None:
    said = without_lab("--help").stdout
    assert "Gather the summaries of many sites. Not installed:" in " ".join(said.split())
    assert all(f"{verb} " in said for verb in LAB_VERBS)
    assert said.count("e3pose[lab]") == len(LAB_VERBS)
    for above, names in BELOW.items():
        said = without_lab(above, "--help").stdout
        assert said.count("e3pose[lab]") == len(names) and all(f"{name} " in said for name in names)


def test_other_verbs_work_without() -> None:
    ended = without_lab("models", "list")
    assert ended.returncode == 0 and "openpose" in ended.stdout


def test_with_the_lab_its_verbs_are_its_own() -> None:
    found = [reduce(App.__getitem__, words, app) for words in MOVED]
    modules = {str(verb.default_command.__module__) for verb in found}
    assert {module.partition(".")[0] for module in modules} == {LAB}
    assert (Path(__file__).parents[2] / "lab" / LAB).is_dir()


def test_with_the_hub_its_verbs_are_its_own() -> None:
    assert {str(app["hub"][verb].default_command.__module__) for verb in ("run", "view")} == {
        f"{HUB}.cli"
    }


def test_trainer_of_an_edge_says_what_to_install(capsys: pytest.CaptureFixture[str]) -> None:
    assert train(["job"], lab="no_lab.train.online") == LACKS_TORCH
    assert capsys.readouterr().err == "no_lab is not installed: pip install 'e3pose[train]'\n"
