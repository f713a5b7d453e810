"""`e3pose setup`, and what `e3pose` alone does."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from tests.cli.commands import run

from e3pose.cli import app, main


def test_setup_prints_where_it_is_and_makes_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ("--listen", "127.0.0.1:0", "--no-browser", "--for", "0.3")
    assert run("setup", "room", *words) == 0
    printed = capsys.readouterr().out
    assert re.search(r"http://127\.0\.0\.1:\d+/#token=[A-Za-z0-9_-]{20,}\n", printed)
    assert (tmp_path / "room" / "setup.toml").exists()
    assert run("setup", *words) == 0, "a site is chosen on the page"


def alone(monkeypatch: pytest.MonkeyPatch, terminal: bool) -> None:
    monkeypatch.setattr(sys, "argv", ["e3pose"])
    for stream in (sys.stdin, sys.stdout):
        monkeypatch.setattr(stream, "isatty", lambda: terminal, raising=False)


def test_without_a_terminal_it_prints_its_help(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    alone(monkeypatch, terminal=False)
    with pytest.raises(SystemExit) as ended:
        main()
        raise SystemExit(0)
    assert not ended.value.code and "Start here" in capsys.readouterr().out


def test_on_a_terminal_it_says_that_it_sets_up(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    alone(monkeypatch, terminal=True)
    called = list[object]()
    monkeypatch.setattr(app, "app", lambda tokens, **_: called.append(tokens))
    monkeypatch.setattr(app, "make_app", lambda _: app.app)
    main()
    assert called == [["setup"]]
    assert "this is `e3pose setup`. `e3pose --help` lists the commands" in capsys.readouterr().out
    monkeypatch.setattr(app, "find_spec", lambda name: None)  # an install without the page
    main()
    assert called[1] == ["--help"]
