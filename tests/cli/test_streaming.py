"""`e3pose stream` where no edge runs."""

from __future__ import annotations

import re
import socket
from functools import partial
from pathlib import Path

import pytest
from tests.cases import each_case
from tests.cli import commands
from tests.ports import free_port
from tests.site.streams.test_streams import EVENT, FELL, SOURCE, WATCH, slot
from tests.waiting import eventually

from e3pose.base.errors import Exit, InputError
from e3pose.cli import streaming
from e3pose.recording import load_recording
from e3pose.site.example import write_recorded
from e3pose.site.streams import open_stream, send
from e3pose.site.streams.base import Unavailable
from e3pose.site.streams.send import Awaited


@pytest.fixture
def site(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Path:
    """A site whose edge does not run, which is waited for half a second."""
    assert commands.run("simulate", tmp_path / "scene", "--seconds", "1") == 0
    site = write_recorded(tmp_path / "site", load_recording(tmp_path / "scene"), "lab")
    port = rf"\1:{free_port()}"
    site.write_text(re.sub(r"(tcp/127\.0\.0\.1):\d+", port, site.read_text()))
    monkeypatch.setattr(streaming, "FIRST_SLOT_S", 0.5)
    capsys.readouterr()
    return site


def test_stream_for_some_seconds_ends_where_no_slot_comes(
    site: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dest = tmp_path / "poses.mcap"
    assert commands.run("stream", site, f"mcap:{dest}", "--for", "3600") == Exit.FAULT
    said = capsys.readouterr().err
    assert "site lab: found no slot in 0.5 s, expected an edge that runs" in said


AWAY = "mqtt://127.0.0.1:1"
HERE = "osc://127.0.0.1:9"


@each_case(
    ("targets", "code", "said"),
    [
        ([AWAY, HERE, "osc://nowhere.invalid:9"], Exit.FAULT, "found no slot"),  # two were awaited
        ([AWAY], Exit.FAULT, "expected a broker that runs"),
        ([HERE, "osc:/"], Exit.REFUSED, "target"),
        ([AWAY, "pigeon://127.0.0.1"], Exit.REFUSED, "found 'pigeon://127.0.0.1'"),
    ],
)
def test_target_that_is_away_keeps_no_other_from_its_slots(
    targets: list[str], code: Exit, said: str, site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert commands.run("stream", site, *targets, "--for", "3600") == code
    lines = capsys.readouterr().err.splitlines()
    awaited = [line for line in lines if "the others go on, tried again every 10 s" in line]
    assert len(awaited) == (2 if len(targets) == 3 else 0) and said in lines[-1], lines


def test_target_that_comes_back_gets_slots(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(send, "RETRY_S", 0.05)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        opening = partial(open_stream, f"foxglove://127.0.0.1:{taken.getsockname()[1]}", SOURCE)
        with pytest.raises(Unavailable, match="expected a free port"):
            opening()
        said = list[str]()
        stream = Awaited(opening, "a port in use", said.append)
        stream.slot(slot(7))
        stream.zone(EVENT)
        stream.people(WATCH, [FELL])
        assert stream.problem == "a port in use" and not said
    assert eventually(lambda: said == ["open now: a port in use"]) and stream.problem == ""
    stream.slot(slot(7))
    stream.close()
    with pytest.raises(InputError):
        open_stream("foxglove://127.0.0.1:1?origin=x", SOURCE)
