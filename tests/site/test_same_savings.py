"""One run's two savings are the same figures on every page, in every file and on every terminal."""

from __future__ import annotations

import html
import io
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from rich.console import Console
from tests.cli.commands import run
from tests.memory_transport import Hub
from tests.site.left_by_demo import canned
from tests.waiting import eventually

from e3pose.energy.saving import whole
from e3pose.recording import ProcessorTime, load_recording
from e3pose.recording.processor import save_processor
from e3pose.settings.resolved import resolve_site
from e3pose.simulate import DetectorSettings, SceneSettings
from e3pose.site.demo import printed_lines, run_demo
from e3pose.site.demo.live import Heard
from e3pose.site.screen import screen
from e3pose.site.web.program import open_view
from e3pose.store import Store
from e3pose.wire.codec import encode

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


@dataclass(frozen=True)
class Demo:
    """A demo that was run: its folder, what it printed, and what its site left."""

    folder: Path
    printed: str
    heard: Heard


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    heard = list[Heard]()

    def live(*args: Any) -> Heard:
        heard.append(canned(*args))
        return heard[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("e3pose.site.demo.live.run_live", live)
        patch.setenv("E3POSE_CACHE", str(tmp_path_factory.mktemp("cache")))
        dest = tmp_path_factory.mktemp("out") / "demo"
        printed = "\n".join(printed_lines(run_demo(dest, offline=True, stand_in=SMALL)))
    return Demo(dest, printed, heard[0])


def test_demo_states_the_same_savings_everywhere(demo: Demo) -> None:
    figures = said(demo.printed)
    # All four cameras in the first ten of twenty slots, then two: xavier-nx draws 12.5 or 6.25 W,
    # so that 12.5 % are saved.
    assert figures == {"whole camera": (13, "modelled"), "processor time": (29, "measured")}
    assert of_json(json.loads((demo.folder / "summary.json").read_text())["savings"]) == figures
    assert said(text_of(demo.folder / "report.html")) == figures
    assert said((demo.folder / "e3pose-demo.txt").read_text()) == figures
    out = io.StringIO()
    Console(file=out, width=200).print(screen(demo.heard.status, 0.0))
    assert said(out.getvalue()) == figures


def test_page_and_report_of_the_store_state_them_too(demo: Demo, tmp_path: Path) -> None:
    figures, site = said(demo.printed), demo.folder / "site"
    assert run("export", site, tmp_path / "later.html") == 0
    stored = said(text_of(tmp_path / "later.html"))
    assert stored == {"whole camera": figures["whole camera"]}
    times = [row["time_ns"] for row in Store(site / "live.db").rows("slots")]
    hub = Hub()
    with open_view(
        resolve_site(site), "127.0.0.1:0", transport=hub.join(), report=lambda line: None
    ) as view:
        status = demo.heard.status
        assert status is not None
        hub.join().publish(f"e3pose/{status.site}/status", encode(status))
        with httpx.Client(base_url=view.url, timeout=30) as client:
            asked = {"start": min(times), "end": max(times)}
            spent = client.get("/api/spent", params=asked).json()
            assert eventually(lambda: client.get("/api/status").status_code == 200)
            live = client.get("/api/status").json()["saved"]
    assert of_json({"whole_camera": spent["whole_camera"]}) == stored
    assert of_json(live) == figures


def test_replay_states_the_same_savings_everywhere(
    demo: Demo, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = demo.folder / "site" / "recording"
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
