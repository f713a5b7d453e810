"""The set-up in a real browser: from the first click to live 3D, with simulated films."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tests.ports import free_port
from tests.site.web.browser import SIZES, Page, in_browser
from tests.waiting import eventually

from e3pose.detectors.timing import time_detections
from e3pose.model.rotations import similarity
from e3pose.recording import load_recording
from e3pose.recording.calibration import load_rig
from e3pose.settings.site_file import load_site
from e3pose.site.setup.program import SetupServer, open_setup

pytestmark = in_browser
WORK_S, LIVE_S = 600.0, 600.0  # on a machine that does much else, and compiles first
WALK_S, SECOND_S = 16.0, 7.0
# Films of the same person, shorter, slower and smaller, and a network measured for a moment: four
# cameras draw, decode and look at a tenth of the pixels, and half of the slots are solved.
FILM_S, FILM_FPS, FILM_SIZE, MEASURE_S = 18.0, 6.25, (400, 300), 0.3
CENTRE_M = 0.4  # in a room of eight metres


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SetupServer]:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("home"))
        patch.setattr("e3pose.site.setup.cameras.SIMULATED_S", FILM_S)
        patch.setattr("e3pose.site.setup.cameras.SIMULATED_FPS", FILM_FPS)
        patch.setattr("e3pose.site.setup.cameras.SIMULATED_SIZE", FILM_SIZE)
        quickly = partial(time_detections, seconds=MEASURE_S)
        patch.setattr("e3pose.site.setup.networks.time_detections", quickly)
        with open_setup(None, "127.0.0.1:0") as server:
            yield server


def there(page: Page, selector: str, timeout_s: float = 30.0) -> bool:
    """Wait until an element is there and can be used; return whether it is in time."""
    found = f"(e => Boolean(e && !e.disabled))(document.querySelector({selector!r}))"
    return eventually(lambda: page.run(found), timeout_s)


def push(page: Page, selector: str) -> None:
    """Push a button by the keyboard."""
    assert there(page, selector), selector
    page.run(f"document.querySelector({selector!r}).focus()")
    page.press("Enter")


def type_into(page: Page, selector: str, text: str) -> None:
    """Type into a field."""
    assert there(page, selector), selector
    page.run(f"(e => {{ e.focus(); e.select?.(); }})(document.querySelector({selector!r}))")
    page.call("Input.insertText", text=text)


def again(page: Page, step: str) -> None:
    """Load the page again; it must be where it was."""
    page.call("Page.reload")
    assert page.shows("step-title", step), page.text("page")


def done(served: SetupServer, kind: str) -> bool:
    task = served.table.setup.tasks.newest
    assert task is None or not task.problem, task.problem
    return task is not None and task.kind == kind and task.state == "done"


def recorded(served: SetupServer, kind: str, seconds: float) -> bool:
    task = served.table.setup.tasks.newest
    assert task is None or not task.problem, task.problem
    return task is not None and task.kind == kind and task.shown.get("seconds", 0) >= seconds


def test_without_the_token_there_is_nothing(page: Page, served: SetupServer) -> None:
    page.open(f"http://{served.address}/")
    assert page.shows("state", "no access")
    assert page.shows("notice", "`e3pose setup` prints it. Open the whole address")


@pytest.mark.timeout(2400)
def test_first_click_to_live_people(page: Page, served: SetupServer) -> None:
    desk = served.table.setup
    page.messages.clear()
    page.open(served.url, *SIZES["screen"])
    assert there(page, "#create") and "token" not in page.run("location.href")
    page.judge()
    type_into(page, "#name", "room")
    push(page, "#create")
    assert page.shows("step-title", "Cameras") and page.text("site") == "room"

    push(page, "#simulate")
    assert eventually(lambda: done(served, "cameras"), WORK_S)
    pictures = "[...document.querySelectorAll('#cameras img')].filter((i) => i.naturalWidth).length"
    assert eventually(lambda: page.run(pictures) == 4)
    again(page, "Cameras")
    assert eventually(lambda: page.run(pictures) == 4), "the pictures are there after a reload"
    page.judge()

    push(page, "#next")
    assert page.shows("step-title", "Network")
    push(page, "#use-drawn")
    assert eventually(lambda: done(served, "site"), WORK_S)
    assert page.shows("step", "poses a second here with four cameras")
    again(page, "Network")
    page.judge()
    site_file = desk.folder / "site.toml"  # another site may run beside this test
    endpoint = f"127.0.0.1:{free_port()}"
    site_file.write_text(re.sub(r"127\.0\.0\.1:\d+", endpoint, site_file.read_text()))

    push(page, "#next")
    push(page, "#record-walk")
    assert page.shows("covered", "poses"), page.text("page")
    again(page, "Walk")  # the walk goes on meanwhile
    assert eventually(lambda: recorded(served, "walk", WALK_S), WORK_S)
    assert page.shows("covered", "Seen by two cameras at once")
    page.judge()
    push(page, "#enough-stop")
    assert eventually(lambda: done(served, "walk"), WORK_S)
    assert load_recording(desk.folder / "walk").num_slots > 0

    push(page, "#next")
    type_into(page, "#height", "171")
    push(page, "#solve")
    assert eventually(lambda: desk.tasks.busy or desk.placed())
    again(page, "Solve")
    assert eventually(lambda: done(served, "solve"), WORK_S)
    drawn = "document.querySelectorAll('.overlay canvas').length"
    assert eventually(lambda: page.run(drawn) == 4, 60)
    assert "Placed to within about" in page.text("step")
    page.judge()
    assert placed_within(desk.root / "room-films", desk.folder / "rig.toml") < CENTRE_M
    origin_by_a_click(page, served)

    push(page, "#to-check")
    push(page, "#record-second")
    assert eventually(lambda: recorded(served, "second", SECOND_S), WORK_S)
    assert there(page, "#walk-floor"), "the floor is known now"
    push(page, "#enough-stop")
    assert eventually(lambda: done(served, "second"), WORK_S)
    push(page, "#check")
    assert eventually(lambda: done(served, "check"), WORK_S)
    assert page.shows("verdict", "mm off in the median over the floor")
    again(page, "Check")
    assert page.shows("verdict", "of the floor is green")
    page.judge()

    push(page, "#next")
    push(page, "#live-start")
    assert eventually(lambda: page.text("state") == "live", LIVE_S), page.text("page")
    page.judge()
    # A picture that is asked for just as work begins is refused, which a browser notes.
    refused = re.compile(r"409 \(Conflict\) http://127\S+/api/setup/cameras/\w+/picture$")
    assert [words for words in page.messages if not refused.search(words)] == []
    change_while_it_runs(page, served)
    assert there(page, "#live-page")
    live = page.run("document.getElementById('live-page').href")
    page.open(live)
    assert page.shows("state", "live")
    assert eventually(lambda: page.text("count") == "1 person", 60), page.text("page")


def placed_within(films: Path, calibration: Path) -> float:
    """Return how far the worst camera stands from its true place, metres, sizes as they are."""
    found, truth = load_rig(calibration).centers_m, load_recording(films).rig.centers_m
    scale, R, t = similarity(found, truth)
    assert abs(scale - 1) < 0.1
    return float(np.linalg.norm(scale * found @ R.T + t - truth, axis=1).max())


def origin_by_a_click(page: Page, served: SetupServer) -> None:
    """Click the middle of the lower edge of a picture: what it shows becomes the origin."""
    desk = served.table.setup
    before = load_rig(desk.calibration)
    push(page, "#aim-origin")
    box = page.run(
        "(b => [b.x, b.y, b.width, b.height])(document.querySelector('.overlay canvas')"
        ".getBoundingClientRect())"
    )
    page.run(f"window.scrollTo(0, {box[1]} - 100)")
    x, y, width, height = page.run(
        "(b => [b.x, b.y, b.width, b.height])(document.querySelector('.overlay canvas')"
        ".getBoundingClientRect())"
    )
    for kind in ("mousePressed", "mouseReleased"):
        page.call("Input.dispatchMouseEvent", type=kind, x=x + width / 2, y=y + 0.8 * height,
                  button="left", clickCount=1)  # fmt: skip
    assert page.shows("step", "--origin="), page.text("step")
    rig = load_rig(desk.calibration)
    camera = rig.cameras[0]
    origin_px = camera.project(np.zeros((1, 3)))[0]
    assert origin_px == pytest.approx([0.5 * FILM_SIZE[0], 0.8 * FILM_SIZE[1]], abs=2)
    apart = [np.linalg.norm(r.centers_m[0] - r.centers_m[2]) for r in (before, rig)]
    assert apart[0] == pytest.approx(apart[1])


def change_while_it_runs(page: Page, served: SetupServer) -> None:
    """Another goal and a zone are taken at once; a battery waits for a restart, with one click."""
    folder = served.table.setup.folder
    push(page, "#to-change")
    page.judge()
    type_into(page, "#cameras-count", "3")
    push(page, "#save")
    assert page.shows("said", "At once:"), page.text("page")
    assert load_site(folder).loop.num_selected == 3
    for corner in ("0,0", "1,0", "1,1"):
        type_into(page, "#zone-corner", corner)
        page.press("Enter")
    type_into(page, "#zone-name", "door")
    push(page, "#keep-zone")
    push(page, "#save")
    assert page.shows("said", "At once: zones from the site file"), page.text("page")
    assert [zone.name for zone in load_site(folder).zone] == ["door"]
    type_into(page, "#settings fieldset:nth-of-type(2) input", "50")
    push(page, "#save")
    assert page.shows("said", "takes batteries at its next start"), page.text("page")
    push(page, "#restart")
    assert eventually(lambda: served.table.live.body()["live"], LIVE_S)
    push(page, "#to-live")
    assert page.shows("live-words", "room is live")
    again(page, "Go live")


STEPS = {
    "cameras": "Cameras", "network": "Network", "walk": "Walk", "solve": "Solve", "check": "Check",
    "live": "Go live", "change": "Change",
}  # fmt: skip


def test_a_slow_network_only_takes_longer(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every step opens and takes orders, with the keyboard alone; the last is loaded again."""
    monkeypatch.chdir(tmp_path)
    with open_setup(None, "127.0.0.1:0") as server:
        page.messages.clear()
        page.slow()
        try:
            page.open(server.url, *SIZES["phone"])
            type_into(page, "#name", "try")
            push(page, "#example")
            assert page.shows("site", "try")
            for step, title in STEPS.items():
                push(page, f"#to-{step}")
                assert page.shows("step-title", title), page.text("page")
                width = f"document.documentElement.scrollWidth === {SIZES['phone'][0]}"
                assert eventually(partial(page.run, width)), step
            again(page, STEPS["change"])
            type_into(page, "#cameras-count", "3")
            push(page, "#save")
            assert page.shows("said", "Wrote try/site.toml"), page.text("page")
            assert load_site(tmp_path / "try").loop.num_selected == 3
            assert page.messages == []
        finally:
            page.slow(False)


LATE = """
(ask => { window.fetch = async (...asked) => {
  const answer = await ask(...asked);
  window.late = String(asked[0]).endsWith("/state");
  if (window.late) await new Promise((go) => setTimeout(go, 1500));
  return answer;
}; })(window.fetch)
"""


def test_an_answer_from_before_an_order_turns_no_page_back(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with open_setup(None, "127.0.0.1:0") as server:
        page.open(server.url, *SIZES["screen"])
        type_into(page, "#name", "try")
        page.run(LATE)
        assert eventually(lambda: page.run("window.late"))
        push(page, "#example")
        assert page.shows("site", "try")
        assert not eventually(lambda: page.text("site") != "try", 2.5)


def test_the_keyboard_reaches_everything(page: Page, served: SetupServer) -> None:
    page.open(served.url, *SIZES["screen"])
    new = "document.getElementById('create') !== null"
    assert eventually(lambda: page.run(new) or page.text("site") == "room")
    if page.run(new):  # the tests before were not run
        type_into(page, "#name", "room")
        push(page, "#example")
    assert page.shows("site", "room")
    named, focus = set(), "document.activeElement"
    for _ in range(40):
        page.press("Tab")
        named.add(page.run(f"{focus}.id || {focus}.innerText"))
        if page.run(f"{focus}.tagName") == "BUTTON":
            assert page.run(f"getComputedStyle({focus}).outlineStyle") != "none"
    assert {"to-cameras", "to-check", "to-change", "command", "Copy"} <= named, named
