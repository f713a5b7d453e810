"""What goes wrong in streams is told to those who look at the site, and no longer than it does."""

from __future__ import annotations

import datetime
import io
import os
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

from e3pose.site.screen import screen
from e3pose.site.stream_problems import FOLDER, FRESH_S, ProblemFile, problems_of
from e3pose.site.web.notices import Around, Surroundings, notices
from e3pose.wire.site_messages import Status

STATUS = Status("lab", 1, 20.0, 1, 1, ())


def test_trouble_is_told_while_it_lasts(tmp_path: Path) -> None:
    site, stream = tmp_path / "site.toml", SimpleNamespace(problem="")
    file = ProblemFile(site)
    file.update([stream, object()])
    assert problems_of(site) == [] and not (tmp_path / FOLDER).exists()
    stream.problem = "webhook example.org: cannot deliver (status 500), 3 notices waiting"
    file.update([stream])
    assert problems_of(site) == [stream.problem]
    (path,) = (tmp_path / FOLDER).iterdir()
    assert path.stat().st_mode & 0o077 == 0
    stream.problem = ""
    file.update([stream])
    assert problems_of(site) == [] and not list((tmp_path / FOLDER).iterdir())


def test_what_a_killed_program_left_is_told_no_longer(tmp_path: Path) -> None:
    site = tmp_path / "site.toml"
    ProblemFile(site).update([SimpleNamespace(problem="broker is away")])
    (path,) = (tmp_path / FOLDER).iterdir()
    old_s = path.stat().st_mtime - FRESH_S - 1
    os.utime(path, (old_s, old_s))
    assert problems_of(site) == []


def test_a_file_of_somebody_else_is_bounded_and_cannot_draw(tmp_path: Path) -> None:
    (tmp_path / FOLDER).mkdir()
    (tmp_path / FOLDER / "9.txt").write_bytes(b"\x1b[2Jgone\xff\n" * 1000 + b"x" * 10**6)
    found = problems_of(tmp_path / "site.toml")
    assert len(found) == 4 and all(len(line) <= 200 for line in found)
    assert not any("\x1b" in line for line in found)


def test_a_folder_that_cannot_be_written_stops_no_stream(tmp_path: Path) -> None:
    (tmp_path / FOLDER).write_text("a file")
    ProblemFile(tmp_path / "site.toml").update([SimpleNamespace(problem="broker is away")])
    assert problems_of(tmp_path / "site.toml") == []


@pytest.mark.parametrize("width", [80, 120])
def test_top_and_the_page_show_it(tmp_path: Path, width: int) -> None:
    said = "webhook example.org: cannot deliver (status 500), 3 notices waiting"
    out = io.StringIO()
    Console(width=width, file=out).print(screen(STATUS, 0.0, [said]))
    assert f"stream: {said}" in " ".join(out.getvalue().split())
    ProblemFile(tmp_path / "site.toml").update([SimpleNamespace(problem=said)])
    now = datetime.datetime(2026, 11, 26, tzinfo=datetime.timezone.utc)
    around = Surroundings(site=tmp_path / "site.toml").look(now)
    assert around == Around(None, (), (said,))
    (notice,) = [one for one in notices(STATUS, None, around, now) if one.kind == "stream"]
    assert notice.text == f"Webhook{said[7:]}."
