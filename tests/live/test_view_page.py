"""The live page in a real browser: what it draws, who sees nothing, and how it looks on a phone."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.site.web.browser import Page, in_browser
from tests.site.web.watched import SLOTS, STARTED_NS, Watched, record, watched_site
from tests.waiting import eventually

pytestmark = in_browser
TRACK_10 = (0x00, 0x9E, 0x73)  # its colour in output/report/scene.js
TRACK_11 = (0xCC, 0x79, 0xA7)


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Watched]:
    with watched_site(tmp_path_factory.mktemp("site")) as made:
        yield made


def pixels(page: Page, colour: tuple[int, int, int]) -> int:
    """Return how many pixels of the window have a colour."""
    return int((np.abs(page.picture().astype(int) - colour).max(axis=-1) <= 2).sum())


def at(page: Page, x: float, y: float, z: float) -> tuple[int, int, int]:
    """Return the colour where a point of the world, millimetres, is drawn."""
    box = "document.getElementById('scene').getBoundingClientRect()"
    place = page.of(
        "stage", f"(([x, y], b) => [b.x + x, b.y + y])(m.scene.place({x}, {y}, {z}), {box})"
    )
    column, row = (round(value) for value in place)
    red, green, blue = page.picture()[row, column].tolist()
    return red, green, blue


def follow(page: Page, watched: Watched, *size: int) -> None:
    """Open the live page in a window of a size; return once it hears of every slot."""
    page.open("about:blank")
    assert eventually(lambda: watched.view.feed.followers == 0), "the page before is still there"
    page.open(watched.view.url, *size)
    assert page.shows("site", "lab")
    assert eventually(lambda: watched.view.feed.followers == 1)


def test_people_stand_where_the_edge_says(page: Page, watched: Watched) -> None:
    follow(page, watched)
    watched.publish(20)
    assert page.shows("slot", "20") and page.shows("people", "Person 11")
    # The joints of a person lie on a line: the left shin, from knee to ankle, is at (x, 0.2 m).
    knee, ankle = record(20).people.joints_m[1][[13, 15]]
    middle = 1000 * (knee + ankle) / 2
    assert eventually(lambda: at(page, *middle) == TRACK_11)
    assert pixels(page, TRACK_10) > 100 and pixels(page, TRACK_11) > 100
    assert "c1" in page.text("table") and page.text("count") == "2 people"
    assert page.messages == []


def test_a_switch_shows_the_smoothed_poses_and_how_late_they_are(
    page: Page, watched: Watched
) -> None:
    follow(page, watched)
    watched.publish(20)
    assert page.shows("slot", "20")
    assert page.run("document.getElementById('when') === null")
    watched.publish_smoothed(15)
    watched.publish(21)
    assert eventually(lambda: page.run("document.getElementById('when') !== null"))
    assert page.text("smoothed-ms") == "200"
    page.run("document.getElementById('smoothed').click()")
    assert page.shows("where", "smoothed, published after 231 ms")
    assert page.shows("slot", "15")
    ankle = 1000 * (record(15).people.joints_m[1][[13, 15]].mean(axis=0) + [3.0, 0.0, 0.0])
    assert eventually(lambda: at(page, *ankle) == TRACK_11)
    watched.publish(22)
    watched.publish_smoothed(16)
    assert page.shows("slot", "16")
    page.run("document.getElementById('now').click()")
    assert page.shows("slot", "22")
    assert "smoothed" not in page.text("where") and page.messages == []


def test_past_is_played_from_the_store_and_the_present_found_again(
    page: Page, watched: Watched
) -> None:
    page.open(watched.view.url)
    assert page.shows("site", "lab")
    assert eventually(lambda: page.of("past", "Boolean(m.past.span)"))
    page.of("past", "void m.seek(m.past.span.begin_s + 1.0)")
    assert page.shows("state", "past")
    assert page.shows("slot", str(SLOTS - 1))  # it plays to the end of what is stored
    assert page.of("known", "m.known.shown.selected.has('c0') && !m.known.shown.selected.has('c2')")
    rows = "[...document.querySelectorAll('#table tbody tr')].map((r) => r.textContent)"
    c0, c1, c2 = page.run(rows)
    assert "active100 %" in c0 and "7.5 W–~75 %" in c0, "what was stored of then"
    assert "c1idle" in c1 and "idle0 %" in c2
    assert "c2: silent for 2 s" in page.text("events") and page.text("count") == "2 people"
    assert not page.run("document.getElementById('of-then').hidden")
    page.of("past", "void m.goLive()")
    watched.publish(50)
    assert page.shows("slot", "50")
    assert page.run("document.getElementById('of-then').hidden")


def test_walls_behind_the_scene_are_drawn(page: Page, watched: Watched) -> None:
    follow(page, watched)
    watched.publish(60)
    assert page.shows("slot", "60")
    # On the wall that faces whoever looks along x, above all people.
    room = page.of("known", "m.known.room")
    (x, y0, _), (_, y1, top) = room["low"], room["high"]
    wall = [
        page.of("stage", f"m.scene.place({x}, {(y0 + y1) / 2}, {share * top})")
        for share in (0.5, 1.0)
    ]
    assert all(wall) and wall[1][1] < wall[0][1]
    column, row = (round(v) for v in page.run(
        f"(([x, y]) => {{ const b = document.getElementById('scene').getBoundingClientRect();"
        f" return [b.x + x, b.y + y]; }})({wall[1]})"
    ))  # fmt: skip
    edge = page.picture()[row - 2 : row + 3, column].min(axis=0)
    assert (edge < 0xF2).all(), "its upper edge, on a ground of 0xFF"


def test_wrong_token_shows_nothing_and_says_so(page: Page, watched: Watched) -> None:
    page.open(watched.view.url + "#token=wrong-wrong-wrong-wrong")
    assert page.shows("state", "no access") and page.shows("notice", "wrong token")
    assert page.text("page").count("e3pose") == 2, "nothing of the site"
    assert page.run("location.hash") == ""
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
    follow(page, watched, 390, 844)
    watched.publish(30)
    assert page.shows("slot", "30")
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
        "size": [640, 480], "slot": 3, "apart_ms": -12, "count": 4, "energy_j": 0.5, "why": "",
        "age_s": 75.0, "captured_ns": 1_795_000_000_000_000_000, "drawn": False,
        "people": [
            {"track": 11, "joints_px": [*joints[:5], *shoulders, *joints[7:]],
             "measured": [True] * 17}
        ],
    }  # fmt: skip
    page.run(
        "(async () => { const { decodedImage, tiles } = await import('/pictures.js');"
        f" const image = await decodedImage('{jpeg}'), found = {json.dumps(found)};"
        " tiles.set('c0', { image, found, have: '', canvases: new Set() });"
        " document.querySelector('.tile').click(); })()"
    )
    assert page.shows("large-said", "4 pictures so far took about 0.50 J")
    assert "1 min ago" in page.text("large-said") and "12 ms before" in page.text("large-said")
    at = (
        "(([x, y]) => {{ const c = document.getElementById('large-frame');"
        " return [...c.getContext('2d').getImageData(x * c.width, y * c.height, 1, 1).data]; }})"
        "([{}, {}])"
    )
    shoulder = at.format(150 / 320, 100 / 240)
    assert eventually(lambda: tuple(page.run(shoulder)[:3]) == TRACK_11)
    assert page.run(at.format(150 / 320, 200 / 240))[:3] == pytest.approx([200] * 3, abs=3)
    page.run("document.getElementById('large').close()")


STRIP = (
    "(([share, row]) => {{ const c = document.getElementById('strips');"
    " const left = m.leftOf(c.getContext('2d')), ratio = devicePixelRatio;"
    " const x = left + share * (c.clientWidth - left), y = m.ROW * row + m.ROW / 2;"
    " const data = c.getContext('2d').getImageData(x * ratio, y * ratio, 9, 5).data;"
    " return [...data].filter((_, i) => i % 4 < 3); }})([{}, {}])"
)
IDLE, ACTIVE, LOST, BLIND = (
    (0xE6, 0xE9, 0xEE),
    (0x1F, 0x29, 0x37),
    (0xB9, 0x1C, 0x1C),
    (0xD9, 0x77, 0x06),
)


def strip(page: Page, share: float, row: int) -> set[tuple[int, ...]]:
    """Return the colours of the time line at a share of its width, in a camera's row."""
    return {
        tuple(c) for c in np.reshape(page.of("strips", STRIP.format(share, row)), (-1, 3)).tolist()
    }


def follows(page: Page, watched: Watched, *slots: int, blind: str = "") -> None:
    """Publish slots, and wait until the page shows the last."""
    for first in range(0, len(slots), 10):  # a server drops what a browser does not take
        for slot in slots[first : first + 10]:
            watched.publish(slot, blind)
        assert page.shows("slot", str(slot))


def stopped(page: Page, since_s: float = 0.0) -> float:
    """Stop the clock of the page some seconds after the last slot came, and draw the time line.

    Otherwise it moves on between one look and the next.

    Returns:
        The share of its width at which two seconds before the last slot are.
    """
    came_ms = page.of("known", "m.known.cameAt")
    page.run(f"((now) => {{ performance.now = () => now; }})({came_ms + 1000 * since_s})")
    page.of("strips", "m.drawStrips(document.getElementById('strips'))")
    last_s = page.of("known", "m.known.history.at(-1).t")
    return float(page.of("strips", f"1 - (m.stripEnd() - {last_s} + 2) / 30"))


def test_time_that_the_page_did_not_see_is_unknown_and_not_idle(
    page: Page, watched: Watched
) -> None:
    follow(page, watched)
    assert IDLE not in strip(page, 0.5, 2), "no slot came yet"
    follows(page, watched, *range(1000, 1101))  # four seconds of thirty
    assert stopped(page) == pytest.approx(1 - 2 / 30)
    share = stopped(page, 6.0)  # without further slots, those that came move to the left
    assert share == pytest.approx(1 - 8 / 30)
    assert strip(page, share, 2) == {IDLE} and strip(page, share, 0) == {ACTIVE}
    assert strip(page, share, 1) == {LOST}
    for row in range(3):
        assert not {IDLE, ACTIVE, LOST} & strip(page, 0.3, row), "before the page was opened"
    follows(page, watched, 1200)  # what came between was lost
    gap = stopped(page)
    assert not {IDLE, ACTIVE, LOST} & strip(page, gap, 0)
    strips = "document.getElementById('strips')"
    pointed = f"m.atPointer({strips}, {{ offsetX: 0.5 * {strips}.clientWidth, offsetY: 4 }})"
    unknown = page.of("strips", pointed)
    assert "c0" in unknown and "unknown" in unknown


def test_blind_slots_have_a_colour_a_cause_and_a_figure_of_their_own(
    page: Page, watched: Watched
) -> None:
    follow(page, watched)
    follows(page, watched, *range(2000, 2100), blind="orders-late")
    share = stopped(page)
    for row in range(3):
        assert strip(page, share, row) == {BLIND}, "also of cameras that were not selected"
    assert "orders late: 100" in page.text("blind-why")
    said = page.of(
        "strips",
        f"((c, left) => m.atPointer(c, {{ offsetX: left + {share} * (c.clientWidth - left),"
        " offsetY: 40 }))(document.getElementById('strips'),"
        " m.leftOf(document.getElementById('strips').getContext('2d')))",
    )
    assert said.startswith("c2, ") and "blind slot, orders late (slot 20" in said
    assert page.shows("blind", "25 %")
    title = page.run("document.getElementById('blind').title")
    assert "30 of 120 slots (orders late: 30)" in title


def test_live_events_have_the_time_of_day(page: Page, watched: Watched) -> None:
    follow(page, watched)
    watched.publish(70)
    assert page.shows("events", "c2 connected")
    first, second = page.run(
        "[...document.querySelectorAll('#events li')].map((e) => e.textContent)"
    )
    clock = page.of("words", f"m.clock({STARTED_NS / 1e9})")
    assert first == f"{clock} c2 connected" and second == "time unknown c1 connected"


def test_time_before_the_first_slot_shows_nothing_of_now(page: Page, watched: Watched) -> None:
    page.messages.clear()
    follow(page, watched)
    follows(page, watched, 80)
    assert eventually(lambda: pixels(page, TRACK_11) > 100)
    assert eventually(lambda: page.of("past", "Boolean(m.past.span)"))
    page.of("past", "void m.seek(m.past.span.begin_s - 3600)")
    assert page.shows("notice", "No slot is stored at ") and page.text("state") == "past"
    assert "The next one is of" in page.text("notice") and "nothing stored" in page.text("where")
    assert eventually(lambda: pixels(page, TRACK_11) == 0)
    assert page.text("people") == "unknown" and page.text("count") == "–"
    rows = page.run("[...document.querySelectorAll('#table tbody tr')].map((r) => r.innerText)")
    assert len(rows) == 3 and not any("W" in row or "mains" in row for row in rows)
    page.of("past", "void m.setPlaying(true)")
    assert page.shows("slot", str(SLOTS - 1))  # it goes on where there is something
    page.of("past", "void m.goLive()")
    follows(page, watched, 81)
    assert page.messages == []
