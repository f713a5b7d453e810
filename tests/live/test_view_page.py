"""The live page in a real browser: what it draws, who sees nothing, and how it looks on a phone."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.site.web.browser import Page, browser, browser_path
from tests.site.web.watched import SLOTS, Watched, record, watched_site
from tests.waiting import eventually

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(browser_path() is None, reason="found no chromium, .ci/run installs one"),
]
TRACK_10 = (0x00, 0x9E, 0x73)  # its colour in report/scene.js
TRACK_11 = (0xCC, 0x79, 0xA7)


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Watched]:
    with watched_site(tmp_path_factory.mktemp("site")) as made:
        yield made


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("browser")) as made:
        yield made


def pixels(page: Page, colour: tuple[int, int, int]) -> int:
    """Return how many pixels of the window have a colour."""
    return int((np.abs(page.picture().astype(int) - colour).max(axis=-1) <= 2).sum())


def at(page: Page, x: float, y: float, z: float) -> tuple[int, int, int]:
    """Return the colour where a point of the world, millimetres, is drawn."""
    place = page.run(
        f"(([x, y]) => {{ const box = document.getElementById('scene').getBoundingClientRect();"
        f" return [box.x + x, box.y + y]; }})(scene.place({x}, {y}, {z}))"
    )
    column, row = (round(value) for value in place)
    red, green, blue = page.picture()[row, column].tolist()
    return red, green, blue


def test_people_stand_where_the_edge_says(page: Page, watched: Watched) -> None:
    page.open(watched.view.url)
    assert page.shows("site", "lab")
    assert eventually(lambda: watched.view.feed.followers == 1)
    watched.publish(20)
    assert page.shows("where", "slot 20") and page.shows("people", "track 11")
    # The joints of a person lie on a line: the left shin, from knee to ankle, is at (x, 0.2 m).
    knee, ankle = record(20).poses.joints_m[1][[13, 15]]
    middle = 1000 * (knee + ankle) / 2
    assert eventually(lambda: at(page, *middle) == TRACK_11)
    assert pixels(page, TRACK_10) > 100 and pixels(page, TRACK_11) > 100
    assert "c1" in page.text("table") and page.text("count") == "2"
    assert page.messages == []


def test_past_is_played_from_the_store_and_the_present_found_again(
    page: Page, watched: Watched
) -> None:
    page.open(watched.view.url)
    assert page.shows("site", "lab")
    assert eventually(lambda: not page.run("document.getElementById('scrub').disabled"))
    page.run("seek(span.begin_s + 1.0)")
    assert page.shows("state", "past")
    assert eventually(lambda: "slot" in page.text("where"))
    assert page.shows("where", f"slot {SLOTS - 1}")  # it plays to the end of what is stored
    assert page.run("shown.selected.has('c0') && !shown.selected.has('c2')")
    rows = "[...document.querySelectorAll('#table tbody tr')].map((r) => r.textContent)"
    c0, c1, c2 = page.run(rows)
    assert "active100 %" in c0 and "7.5 W~75 %" in c0, "what was stored of then"
    assert "c1saving" in c1 and "saving0 %" in c2
    assert "c2: silent for 2 s" in page.text("events") and page.text("count") == "2"
    assert not page.run("document.getElementById('of-then').hidden")
    page.run("goLive()")
    watched.publish(50)
    assert page.shows("where", "slot 50")
    assert page.run("document.getElementById('of-then').hidden")


def test_walls_behind_the_scene_are_drawn(page: Page, watched: Watched) -> None:
    page.open(watched.view.url)
    assert page.shows("site", "lab")
    assert eventually(lambda: watched.view.feed.followers == 1)
    watched.publish(60)
    assert page.shows("where", "slot 60")
    # On the wall that faces whoever looks along x, above all people.
    low_x = "room.low[0], (room.low[1] + room.high[1]) / 2"
    wall = [
        page.run(f"scene.place({low_x}, room.floor + {share} * (room.high[2] - room.floor))")
        for share in (0.5, 1.0)
    ]
    assert all(wall) and wall[1][1] < wall[0][1]
    column, row = (round(v) for v in page.run(
        f"(([x, y]) => {{ const b = document.getElementById('scene').getBoundingClientRect();"
        f" return [b.x + x, b.y + y]; }})({wall[1]})"
    ))  # fmt: skip
    edge = page.picture()[row - 2 : row + 3, column].min(axis=0)
    assert (edge < 0xF2).all(), "its upper edge, on a ground of 0xF6 and more"


def test_wrong_token_shows_nothing_and_says_so(page: Page, watched: Watched) -> None:
    page.open(watched.view.url + "#token=wrong-wrong-wrong-wrong")
    assert page.shows("state", "no access") and page.shows("notice", "wrong token")
    assert page.text("table") == "" and page.run("location.hash") == ""
    page.run("sessionStorage.clear()")


def test_another_page_gets_nothing(page: Page, watched: Watched, tmp_path: Path) -> None:
    (tmp_path / "evil.html").write_text("<!doctype html><title>another page</title>")
    page.open((tmp_path / "evil.html").as_uri())
    assert eventually(lambda: page.run("document.title") == "another page")
    url = watched.view.url
    read = f"fetch('{url}api/site').then((a) => a.status, () => 'refused')"
    assert page.run(read) == "refused"
    opened = (
        f"new Promise((done) => {{ const s = new WebSocket('{url.replace('http', 'ws')}api/live');"
        " s.onopen = () => done('open'); s.onerror = () => done('refused'); })"
    )
    assert page.run(opened) == "refused"
    assert watched.view.feed.followers == 0 or eventually(lambda: not watched.view.feed.followers)


def test_phone_has_room_for_all_of_it(page: Page, watched: Watched) -> None:
    page.open(watched.view.url, 390, 844)
    assert page.shows("site", "lab")
    assert eventually(lambda: watched.view.feed.followers == 1)
    watched.publish(30)
    assert page.shows("where", "slot 30")
    assert page.run("document.documentElement.scrollWidth") == 390
    assert eventually(lambda: pixels(page, TRACK_11) > 30)


def test_picture_of_a_camera_has_the_skeletons_in_it(page: Page, watched: Watched) -> None:
    page.open(watched.view.url)
    assert page.shows("site", "lab")
    image = np.full((240, 320, 3), 200, dtype=np.uint8)
    jpeg = base64.b64encode(cv2.imencode(".jpg", image)[1].tobytes()).decode()
    joints = [[None, None]] * 17
    shoulders = [[100, 200], [500, 200]]  # of the full image, twice as large
    found = {
        "jpeg": jpeg, "size": [640, 480], "slot": 3, "count": 4, "energy_j": 0.5,
        "people": [{"track": 11, "joints_px": [*joints[:5], *shoulders, *joints[7:]]}],
    }  # fmt: skip
    page.run(f"(looking = 'c0', drawPicture({json.dumps(found)}, 'c0'))")
    assert page.shows("picture-said", "4 pictures so far took about 0.50 J")
    pixel = "[...document.getElementById('frame').getContext('2d').getImageData({}, {}, 1, 1).data]"
    assert tuple(page.run(pixel.format(150, 100))[:3]) == TRACK_11
    assert page.run(pixel.format(150, 200))[:3] == pytest.approx([200] * 3, abs=3)
    page.run("look('')")
