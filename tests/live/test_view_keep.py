"""Keeping on the page: marking, clips, files with progress that outlives a reload, recordings."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.site.web.browser import SIZES, Page, in_browser
from tests.site.web.test_keep import RECORDING
from tests.site.web.test_past import ZONE, at_ns, store_fall
from tests.site.web.watched import Watched, store_site, watched_site
from tests.waiting import eventually

from e3pose.store.clips import Clip, clips_of, keep_clip
from e3pose.store.people import set_name

pytestmark = in_browser
PART = "20261118T110640Z"


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A site with a recording, and a store in which Ada falls."""
    folder = tmp_path_factory.mktemp("stored")
    part = folder / "recordings" / PART
    part.mkdir(parents=True)
    (part / "recording.toml").write_text(RECORDING)
    store_site(folder, ZONE + "[events]\n")
    store_fall(folder / "lab.db")
    set_name(folder / "lab.db", ((2, 7),), "Ada")
    return folder


@pytest.fixture
def watched(stored: Path, tmp_path: Path) -> Iterator[Watched]:
    shutil.copytree(stored, tmp_path, dirs_exist_ok=True)
    with watched_site(tmp_path) as made:
        yield made


def opened(page: Page, watched: Watched, token: str, size: str = "screen") -> None:
    page.open(f"{watched.view.url}#token={token}", *SIZES[size])
    page.messages.clear()
    assert page.shows("site", "lab")
    assert eventually(lambda: page.of("past", "Boolean(m.past.span)"))
    page.run("document.getElementById('tab-keep').click()")
    assert eventually(lambda: page.run("document.getElementById('keep') !== null"))


def write(page: Page, element: str, text: str) -> None:
    page.run(f"document.getElementById({element!r}).focus()")
    page.call("Input.insertText", text=text)


def press(page: Page, label: str) -> None:
    """Press the button that has a label for screen readers, or these words."""
    found = (
        "[...document.querySelectorAll('button')].find((one) => "
        f"(one.getAttribute('aria-label') || one.textContent.trim()) === {json.dumps(label)})"
    )
    assert eventually(lambda: page.run(f"Boolean({found}) && !{found}.disabled")), label
    page.run(f"{found}.click()")


def clips(watched: Watched) -> list[Clip]:
    return [clip for clip, _ in clips_of(watched.folder / "lab.db", "lab")]


def kept(watched: Watched) -> Clip:
    return keep_clip(watched.folder / "lab.db", "lab", Clip("Fall", at_ns(250), at_ns(370), "mat"))


def test_a_clip_is_marked_named_played_changed_and_removed(page: Page, watched: Watched) -> None:
    opened(page, watched, watched.view.tokens.write)
    assert page.run("document.getElementById('clip-save').disabled")
    page.of("past", f"void m.seek({at_ns(250) / 1e9}).then(() => m.setPlaying(false))")
    assert page.shows("state", "past")
    assert eventually(lambda: not page.of("past", "m.past.playing")), "else it stops the clip"
    # By keyboard, on the time line: from here, and on, and to here.
    page.run("document.getElementById('line').focus()")
    page.press("+")
    page.press("[")
    for _ in range(3):
        page.press("ArrowRight")
    page.press("]")
    marked = page.of("timeline", "m.line.marked")
    assert marked["from_s"] == pytest.approx(at_ns(250) / 1e9, abs=0.5)
    assert marked["to_s"] > marked["from_s"] + 2
    write(page, "clip-name", "<i>Fall</i>")
    write(page, "clip-note", "mat")
    page.press("Enter")
    assert page.shows("clips", "<i>Fall</i>") and page.shows("clips", "mat")
    (clip,) = clips(watched)
    assert (clip.name, clip.note) == ("<i>Fall</i>", "mat")
    press(page, "Play <i>Fall</i>")
    assert eventually(lambda: page.of("past", "m.past.playing"))
    assert eventually(lambda: not page.of("past", "m.past.playing"), 120.0)
    assert page.of("past", "m.past.at_s") == pytest.approx(clip.end_ns / 1e9, abs=1.5)
    press(page, "Edit <i>Fall</i>")
    page.run("document.querySelector('[aria-label=\"New name\"]').select()")
    page.run("document.querySelector('[aria-label=\"New name\"]').focus()")
    page.call("Input.insertText", text="Slipped")
    page.press("Enter")
    assert page.shows("clips", "Slipped") and [one.name for one in clips(watched)] == ["Slipped"]
    press(page, "Delete Slipped")
    assert clips(watched), "asked first"
    press(page, "Remove from the list")
    assert page.shows("clips", "No clips yet") and clips(watched) == []
    assert page.messages == []


def test_a_drag_on_the_time_line_marks_and_a_click_goes_there(page: Page, watched: Watched) -> None:
    opened(page, watched, watched.view.tokens.write)
    page.of("past", f"void m.seek({at_ns(250) / 1e9}).then(() => m.setPlaying(false))")
    assert page.shows("state", "past")

    def mouse(kind: str, share: float) -> None:
        # The line moves when there is more to say below it.
        left, y, width = page.run(
            "(({ left, top, width }) => [left, top + 40, width])"
            "(document.getElementById('line').getBoundingClientRect())"
        )
        page.call("Input.dispatchMouseEvent", type=kind, x=left + share * width, y=y,
                  button="left", clickCount=1, buttons=1)  # fmt: skip

    mouse("mousePressed", 0.4)
    for share in (0.42, 0.45, 0.5):
        mouse("mouseMoved", share)
    mouse("mouseReleased", 0.5)
    marked = page.of("timeline", "m.line.marked")
    assert marked["to_s"] - marked["from_s"] == pytest.approx(60, rel=0.1)  # of ten minutes
    assert page.run("document.getElementById('from').value") != ""
    at_s = page.of("past", "m.past.at_s")
    mouse("mousePressed", 0.3)
    mouse("mouseReleased", 0.3)
    assert eventually(lambda: page.of("past", "m.past.at_s") < at_s - 60)


def test_files_of_chosen_people_outlive_a_reload(
    page: Page, watched: Watched, tmp_path: Path
) -> None:
    kept(watched)
    opened(page, watched, watched.view.tokens.write)
    press(page, "Download … of Fall")
    assert eventually(lambda: page.run("document.querySelector('.making .form') !== null"))

    def choose(form: str) -> None:
        page.run(
            "(() => { const box = document.querySelector('#clips .making .form');"
            f" box.value = {form!r}; box.dispatchEvent(new Event('change')); }})()"
        )

    people = "[...document.querySelectorAll('#clips fieldset label')].map((one) => one.textContent)"
    choose("csv")
    assert eventually(lambda: page.run(people) == ["Ada"])
    page.run("document.querySelector('#clips fieldset input').click()")
    assert page.run("document.querySelector('#clips .make').disabled"), "nobody is chosen"
    page.run("document.querySelector('#clips fieldset input').click()")
    press(page, "Make the file")
    # Loaded again at once: it is there, goes on, and is done.
    assert page.shows("files", "Fall · CSV")
    page.call("Page.reload")
    assert page.shows("site", "lab") and page.shows("files", "Fall · CSV")
    assert page.shows("files", "121 rows, metres, z up"), page.text("files")
    folder = tmp_path / "downloads"
    page.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(folder))
    page.run("document.querySelector('#files .get').click()")
    assert eventually(lambda: (folder / "Fall.csv").is_file())
    assert (folder / "Fall.csv").read_text().startswith("slot,time,")
    press(page, "Remove Fall · CSV")
    assert page.shows("files", "No files yet")
    assert page.messages == []


def test_what_cannot_be_made_says_why_and_can_be_tried_again(page: Page, watched: Watched) -> None:
    with watched.client(watched.view.tokens.write) as client:
        body: dict[str, Any] = {"form": "csv", "name": "Empty", "start_ns": 1, "end_ns": 2}
        assert client.post("/api/control/jobs", json=body).status_code == 200
    opened(page, watched, watched.view.tokens.write)
    assert page.shows("files", "Not made: found no poses that fit")
    press(page, "Try again")
    assert eventually(lambda: page.text("files").count("Not made") == 2)


def test_viewers_play_and_download_and_are_offered_no_more(page: Page, watched: Watched) -> None:
    kept(watched)
    opened(page, watched, watched.view.tokens.read, "phone")
    assert page.shows("clips", "Fall") and page.shows("recordings", "10 s")
    buttons = page.run(
        "[...document.querySelectorAll('#keep button')].map((one) => one.textContent.trim())"
    )
    assert buttons == ["▶ Play", "▶ Play from the store"]
    press(page, "Play Fall")
    assert page.shows("state", "past") and page.shows("people", "Ada")


def test_a_recording_is_deleted_when_somebody_is_sure(page: Page, watched: Watched) -> None:
    opened(page, watched, watched.view.tokens.write)
    press(page, f"Delete recording {PART}")
    assert (watched.folder / "recordings" / PART).is_dir()
    press(page, "Delete")
    assert page.shows("recordings", "No recordings.")
    assert not (watched.folder / "recordings" / PART).exists()


def test_axe_finds_nothing_serious(page: Page, watched: Watched) -> None:
    kept(watched)
    with watched.client(watched.view.tokens.write) as client:
        body = {"form": "csv", "name": "Empty", "start_ns": 1, "end_ns": 2}
        client.post("/api/control/jobs", json=body)
    opened(page, watched, watched.view.tokens.write)
    assert page.shows("files", "Not made")
    press(page, "Play Fall")
    assert page.shows("people", "Ada")
    for label in ("Download … of Fall", "Edit Fall", f"Delete recording {PART}"):
        press(page, label)
    page.run("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    page.judge()
    assert page.messages == []
