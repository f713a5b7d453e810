"""Report pages in a browser: light and dark, pictures that follow the player, for every eye."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from tests.cli.commands import run as verb
from tests.distributions import ROOT
from tests.site.web.browser import SIZES, Page, in_browser
from tests.waiting import eventually

from e3pose.detectors.weights import MODELS, is_installed
from e3pose.site.demo_clip import find_clip

pytestmark = in_browser


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("report")
    asks = ("--people", 2, "--cameras", 2, "--seconds", 4, "--videos")
    assert verb("simulate", folder / "walk", *asks) == 0
    assert verb("replay", folder / "walk", "--cameras", 1, "--report", folder / "r.html") == 0
    return (folder / "r.html").as_uri()


def opened(page: Page, report: str) -> None:
    page.messages.clear()
    page.open(report, *SIZES["screen"])
    assert eventually(lambda: page.run("Boolean(document.querySelector('#strips .main-svg'))"))


def test_pictures_follow_the_player(page: Page, report: str) -> None:
    opened(page, report)
    picture = "document.getElementById('film').src"
    assert page.run("seek(0), FILM.at[0]") == 0
    first = page.run(picture)
    assert first.startswith("data:image/jpeg;base64,")
    page.run("seek(last)")
    end = page.run(picture)
    assert end != first and page.run("document.getElementById('film').naturalWidth") > 100
    page.run("document.getElementById('film-of').selectedIndex = 1")
    page.run("document.getElementById('film-of').dispatchEvent(new Event('change'))")
    assert page.run(picture) not in (first, end)
    assert page.messages == []


def test_page_turns_dark_with_the_system_while_it_is_open(page: Page, report: str) -> None:
    opened(page, report)
    ground = "getComputedStyle(document.body).backgroundColor"
    ink = "document.querySelector('#strips .xtick text, #strips text').style.fill"
    light = page.run(ground), page.run(ink)
    page.dark(True)
    try:
        assert eventually(lambda: page.run(ground) != light[0])
        assert eventually(lambda: page.run(ink) != light[1])
        assert page.run("inksNow() === DARK")
    finally:
        page.dark(False)
    assert eventually(lambda: (page.run(ground), page.run(ink)) == light)
    assert page.messages == []


def test_axe_finds_nothing_serious(page: Page, report: str) -> None:
    opened(page, report)
    page.judge("{ exclude: ['.js-plotly-plot'] }")  # the charts are Plotly's own drawings


# The pages that README and tutorials name, and how they are made here: without a network.
NAMED = {
    "demo-output/report.html": "demo demo-output --offline",
    "walk.html": "replay demo-output/recording --cameras 2 --report walk.html",
    "paper.html": "replay demo-output/recording --pipeline paper --report paper.html",
    "last.html": "export demo-output/site last.html",
}
FAULTS = r"No pictures|Traceback|not installed|undefined|NaN|expected (a|an|one)\b|found '"


@pytest.mark.nightly  # two minutes for the demo
@pytest.mark.skipif(
    find_clip() is None or not any(map(is_installed, MODELS)),
    reason="clip or network of the demo are not in the cache: e3pose demo fetches them",
)
def test_every_page_that_readme_and_tutorials_name_shows_what_it_should(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    texts = [ROOT / "README.md", *ROOT.glob("docs/tutorial/*.md")]
    assert {*re.findall(r"[\w/-]+\.html", "".join(map(Path.read_text, texts)))} == {*NAMED}
    monkeypatch.chdir(tmp_path)
    for name, command in NAMED.items():
        assert verb(*command.split()) == 0, command
        for size in ("screen", "phone"):
            opened(page, (tmp_path / name).as_uri())
            page.resize(*SIZES[size])
            page.run("seek(Math.floor(last / 2))")
            said = page.run("document.body.innerText")
            assert not re.search(FAULTS, said), (name, re.search(FAULTS, said))
            assert "person 1" in said, name
            inks = (
                "(() => { const c = document.getElementById('scene'), d = c.getContext('2d')"
                ".getImageData(0, 0, c.width, c.height).data; return new Set(d).size; })()"
            )
            assert page.run(inks) > 20, (name, size)
            assert page.run("[...document.images].every((one) => one.naturalWidth > 100)"), name
            assert page.messages == [], name
        # A store has no pictures, and its page has no place for them.
        assert page.run("document.images.length") == (name != "last.html"), name
