"""The table of verbs: what help says of each without its module, and what its module says."""

from __future__ import annotations

import sys
from importlib.util import resolve_name
from itertools import takewhile

import pytest
from cyclopts import App
from tests.cases import each_case
from tests.cli.commands import run

from e3pose.cli.app import APP, GROUPS, RETIRED, app, main, summary_of

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


@each_case("old", RETIRED)
def test_a_retired_word_names_the_command_that_does_it_now(
    old: str, capsys: pytest.CaptureFixture[str]
) -> None:
    command, dashes, option = old.partition("--")
    name, _, pattern = f"--{option}".partition(" ")
    value = pattern.replace("*", "mine") or "x"
    own = command.split() or ["replay"]  # a word of all commands
    ways = ([name, value], [f"{name}={value}"]) if dashes else ([], ["--help"])
    for typed in ways:
        assert run(*own, "site.toml", *typed) == 2
        out, err = capsys.readouterr()
        assert out == "" and err == f"e3pose: {old} is retired, use: {RETIRED[old]}\n"
    _, *new = RETIRED[old].split()
    assert run(*takewhile(str.islower, new[:2]), "--help") == 0, "the new command is there"
    offered = capsys.readouterr().out
    assert all(word in offered for word in new if word.startswith("--"))
    if dashes and not pattern:
        assert run(*own, "--help") == 0 and name not in capsys.readouterr().out


def test_a_word_that_looks_like_a_retired_one_is_not_taken(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for words in (["hub", "report"], ["store", "copy", "report", "--csv"], ["query", "report"]):
        run(*words)
        assert "retired" not in capsys.readouterr().err


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
    assert capsys.readouterr().err == "e3pose: cv2 is not installed: pip install 'e3pose[camera]'\n"
