"""The table of verbs, and the one thread on which they multiply."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib.util import resolve_name

import pytest
from cyclopts import App
from tests.cases import each_case
from tests.cli.commands import run

from e3pose.base.installing import not_installed
from e3pose.cli.app import APP, EXPERT, GROUPS, VERBS, app, main, summary_of

PLACES = [
    (verb, place)
    for verbs in GROUPS.values()
    for verb, place in verbs.items()
    if isinstance(place, str)
]


@each_case(("verb", "place"), PLACES, ids=[verb for verb, _ in PLACES])
def test_the_line_of_a_verb_is_what_its_module_says(verb: str, place: str) -> None:
    said = app[verb].help.strip().partition("\n")[0]
    assert summary_of(place) == said != ""
    module, name = resolve_name(place, "e3pose.cli").split(":")
    has_verbs = isinstance(getattr(sys.modules[module], name), App)
    assert has_verbs == place.endswith(APP)


def shown(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """Return what a command prints on a terminal of 80 columns."""
    assert run(*words) == 0
    return capsys.readouterr().out


def test_help_shows_twelve_verbs_in_three_groups_and_all_on_request(
    capsys: pytest.CaptureFixture[str],
) -> None:
    first, everything = shown(capsys, "--help"), shown(capsys, "--help-all")
    for text, groups in ((first, [*GROUPS.values()][:3]), (everything, [*GROUPS.values()])):
        listed = {line[1:].split()[0] for line in text.splitlines() if line[2:3].isalpha()}
        assert listed & {*VERBS} == {verb for verbs in groups for verb in verbs}
    assert sum(len(verbs) for verbs in [*GROUPS.values()][:3]) == 12
    assert "--help-all" in first and len(first.splitlines()) <= 48


def test_help_of_replay_fits_two_screens_and_names_what_has_the_rest(
    capsys: pytest.CaptureFixture[str],
) -> None:
    first = shown(capsys, "replay", "--help")
    assert len(first.splitlines()) <= 48  # two of 24
    everything = shown(capsys, "replay", "--help-all")
    for title, word in EXPERT.items():
        assert f"{title}: " in first and f"see {word}" in first
        panel = shown(capsys, "replay", word).partition(f"╭─ {title} ")[2].partition("╰")[0]
        options = re.findall(r"^│ (--[\w-]+)", panel, re.M)
        assert options and panel in everything
        assert f"{title}: {len(options)} options" in first
        assert not {*options} & {*re.findall(r"^│ (--[\w-]+)", first, re.M)}


def test_several_commands_in_a_process_do_not_disturb_each_other(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for words in (["hub", "--help"], ["--help"], ["--install-completion", "x"], ["hub", "--help"]):
        with pytest.raises(SystemExit):
            main(words)
    for words in (["simulate", "--nonsense"], ["nonsense"], ["simulate", "--nonsense"]):
        with pytest.raises(SystemExit, match="2"):
            main(words)
    assert capsys.readouterr().err.count("(try --help)") >= 3


def test_a_package_that_a_verb_lacks_is_said_in_a_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    torn = App(name="e3pose")
    torn.command("tests.cli.torn_verb:top", name="top")
    monkeypatch.setattr("e3pose.cli.app.app", torn)
    with pytest.raises(SystemExit, match="2"):
        main(["top", "site"])
    assert capsys.readouterr().err == f"e3pose: {not_installed('cv2', 'camera')}\n"


# The threads that come with the first large product of matrices, or at the import of numpy.
CODE = """
import os, sys
def threads(): return len(os.listdir("/proc/self/task"))
import {first}
import numpy
numpy.ones((512, 512)) @ numpy.ones((512, 512))
print(threads())
"""


@pytest.mark.skipif(not os.path.isdir("/proc/self/task"), reason="counts threads as Linux does")
def test_programs_multiply_on_one_thread_unless_told() -> None:
    def threads(first: str, **said: str) -> int:
        usual = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
        command = [sys.executable, "-c", CODE.format(first=first)]
        return int(subprocess.check_output(command, env={**usual, **said}))

    if threads("sys") == 1:
        pytest.skip("numpy has one thread here")
    assert threads("e3pose.cli") == 1
    assert threads("e3pose.cli", OPENBLAS_NUM_THREADS="2") == 2
