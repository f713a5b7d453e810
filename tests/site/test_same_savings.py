"""One run's two savings are the same figures on every page, in every file and on every terminal."""

from __future__ import annotations

import html
import io
import json
import re
from pathlib import Path
from typing import Any

import httpx
import pytest
from rich.console import Console
from tests.cli.commands import run
from tests.memory_transport import Hub
from tests.site.left_by_site import leave
from tests.waiting import eventually

from e3pose.energy.saving import whole
from e3pose.recording import ProcessorTime, load_recording
from e3pose.recording.processor import save_processor
from e3pose.settings.resolved import resolve_site
from e3pose.simulate import DetectorSettings, SceneSettings, simulate
from e3pose.site.example import write_recorded
from e3pose.site.screen import screen
from e3pose.site.web.program import open_view
from e3pose.store import Store
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import Status

pytestmark = pytest.mark.slow

SMALL = SceneSettings(
    people=2, seconds=2.0, fps=10, cameras=4, detector=DetectorSettings(perfect=True)
)
NAMED = re.compile(r"(whole camera|processor time) (-?\d+) % \((measured|modelled)\)")
CARD = re.compile(r"(-?\d+) % (whole camera|processor time) saved \((measured|modelled)\)")
SAVES = re.compile(r"\bsav(?:es?|ed|ings?)\b|\bless\b", re.I)
PERCENT = re.compile(r"(-?\d+(?:\.\d+)?) ?%")
Figures = dict[str, tuple[int, str]]


def said(text: str) -> Figures:
    """Return the savings that a text states; no sentence states another, or another basis."""
    found: dict[str, set[tuple[int, str]]] = {}
    for name, percent, basis in NAMED.findall(text):
        found.setdefault(name, set()).add((int(percent), basis))
    for percent, name, basis in CARD.findall(text):
        found.setdefault(name, set()).add((int(percent), basis))
    assert all(len(each) == 1 for each in found.values()), found
    stated = {name: next(iter(each)) for name, each in found.items()}
    for sentence in re.split(r"(?<=[.:;])\s|\n", text):
        if SAVES.search(sentence):
            percents = {float(one) for one in PERCENT.findall(sentence)}
            assert percents <= {float(one) for one, _ in stated.values()}, sentence
    assert not (stated.keys() >= {"processor time"} and "not measured" in text)
    return stated


def of_json(table: Any) -> Figures:
    """Return the savings of a table of `whole_camera` and `processor_time`."""
    return {
        name.replace("_", " "): (whole(one["percent"]), one["basis"])
        for name, one in table.items()
        if one is not None
    }


def text_of(page: Path) -> str:
    """Return what a page shows, without its scripts."""
    body = re.sub(r"<(script|style).*?</\1>", "", page.read_text(encoding="utf-8"), flags=re.S)
    return html.unescape(re.sub(r"<[^>]*>", " ", body.replace("</b><span>", " ")))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A site whose cameras play a recording, with what it stored of one round."""
    return write_recorded(tmp_path_factory.mktemp("site"), simulate(SMALL, 0)).parent


@pytest.fixture(scope="module")
def status(site: Path) -> Status:
    return leave(site / "site.toml")


def test_screen_page_and_report_of_a_site_state_the_same_savings(
    site: Path, status: Status, tmp_path: Path
) -> None:
    out = io.StringIO()
    Console(file=out, width=200).print(screen(status, 0.0))
    figures = said(out.getvalue())
    # All four cameras in the first ten of twenty slots, then two: xavier-nx draws 12.5 or 6.25 W,
    # so that 12.5 % are saved.
    assert figures == {"whole camera": (13, "modelled"), "processor time": (29, "measured")}
    assert run("export", site, tmp_path / "later.html") == 0
    stored = said(text_of(tmp_path / "later.html"))
    assert stored == {"whole camera": figures["whole camera"]}
    times = [row["time_ns"] for row in Store(site / "live.db").rows("slots")]
    hub = Hub()
    with open_view(
        resolve_site(site), "127.0.0.1:0", transport=hub.join(), report=lambda line: None
    ) as view:
        hub.join().publish(f"e3pose/{status.site}/status", encode(status))
        with httpx.Client(base_url=view.url, timeout=30) as client:
            asked = {"start": min(times), "end": max(times)}
            spent = client.get("/api/spent", params=asked).json()
            assert eventually(lambda: client.get("/api/status").status_code == 200)
            live = client.get("/api/status").json()["saved"]
    assert of_json({"whole_camera": spent["whole_camera"]}) == stored
    assert of_json(live) == figures


def test_replay_states_the_same_savings_everywhere(
    site: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = site / "recording"
    cameras = load_recording(folder).rig.camera_ids
    save_processor(folder, dict.fromkeys(cameras, ProcessorTime(0.1, 0.02, 9)))
    page, table = tmp_path / "page.html", tmp_path / "figures.json"
    capsys.readouterr()
    asked = ("--policy", "round-robin", "--cameras", "2")
    assert run("replay", folder, *asked, "--report", page, "--json", table) == 0
    figures = said(capsys.readouterr().out)
    assert set(figures) == {"whole camera", "processor time"}
    assert {basis for _, basis in figures.values()} == {"modelled"}
    assert said(text_of(page)) == figures
    assert of_json(json.loads(table.read_text())["savings"]) == figures
    assert run("evaluate", folder, "--policies", "round-robin", "--cameras", "2", "--seeds", "1",
               "--json", tmp_path / "rows.json") == 0  # fmt: skip
    (row,) = json.loads((tmp_path / "rows.json").read_text())["rows"]
    means = {
        name: {"percent": one["percent"]["mean"], "basis": one["basis"]}
        for name, one in row["savings"].items()
    }
    assert of_json(means) == figures
    printed = " ".join(capsys.readouterr().out.split())
    assert "whole camera saved %: saved, compared with all cameras" in printed
