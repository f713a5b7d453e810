"""The page as a product: who does what, what happened, for every eye, hand, screen and network."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.site.web.browser import SIZES, Page, in_browser
from tests.site.web.watched import RIG, Watched, watched_site
from tests.waiting import eventually

from e3pose.model.skeleton import COCO17
from e3pose.simulate import SceneSettings, simulate
from e3pose.wire.arrays import pack
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import CameraStatus, Poses, Status

pytestmark = in_browser
FPS = 12.5
HOME = SceneSettings("home-fall", seconds=30.0, fps=FPS, cameras=3)
TABLES = """[events]
lies_s = 5.0
[[zone]]
name = "kitchen"
corners = [[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]]
"""


class Home:
    """A site in which somebody falls; the test plays its edge."""

    def __init__(self, watched: Watched) -> None:
        recording = simulate(HOME, 1)
        assert recording.truth is not None
        self.watched = watched
        self.joints_m = recording.truth.joints_m.astype(np.float32)  # (num_slots, 1, 17, 3)
        self.slot, self.shift_ns = 0, time.time_ns() - round(1e9 * len(self.joints_m) / FPS)

    def status(self, **more: Any) -> None:
        """Send a status in which one camera has a battery."""
        cameras = [
            CameraStatus(i, True, power_w=5.0, battery=0.5, cpu_s=71.0, cpu_saved=0.29)
            for i in RIG.camera_ids
        ]
        told = Status(
            "lab", self.slot, FPS, 2, 1, tuple(cameras), uptime_s=100.0, spent_j=7300.0,
            always_j=10_000.0, **more,
        )  # fmt: skip
        self.watched.edge.publish("e3pose/lab/status", encode(told))

    def publish(self, count: int = 1, unsure: bool = False) -> None:
        """Send the next slots; after the last, the last again and again."""
        for _ in range(count):
            joints_m = self.joints_m[min(self.slot, len(self.joints_m) - 1)]
            sigma_m = np.full((1, 17), 0.01, dtype=np.float32)
            if unsure:
                sigma_m[0, COCO17.joints.index("left_wrist")] = 0.3
            time_ns = self.shift_ns + round(self.slot / FPS * 1e9)
            poses = Poses(
                self.slot, time_ns, COCO17.joints, pack(np.array([7])), pack(joints_m),
                pack(sigma_m), pack(np.ones((1, 17), dtype=bool)), selected=("c0", "c1"),
                arrived=("c0", "c1"),
            )  # fmt: skip
            self.watched.edge.publish("e3pose/lab/poses", encode(poses))
            self.slot += 1

    def until_the_fall(self) -> None:
        """Send slots until the server was told of the fall."""
        while not any(event.kind == "fall" for event in self.watched.view.feed.told):
            assert self.slot < len(self.joints_m), "nobody fell"
            self.publish()


@pytest.fixture
def home(tmp_path: Path) -> Iterator[Home]:
    with watched_site(tmp_path, TABLES) as made:
        yield Home(made)


def opened(page: Page, home: Home, size: str = "screen") -> None:
    """Open the page, with a token that controls."""
    page.open(home.watched.view.url + "#token=" + home.watched.view.tokens.write, *SIZES[size])
    page.messages.clear()  # what the page before said of its server, which is gone
    assert page.shows("site", "lab")
    assert eventually(lambda: home.watched.view.feed.followers >= 1)


def alive(page: Page, home: Home, element: str, text: str) -> bool:
    """Send slots until an element has a text."""

    def shown() -> bool:
        home.publish()
        home.status()
        return text in page.text(element)

    return eventually(shown)


def test_a_fall_is_a_sentence_an_alarm_a_mark_and_a_part_of_the_day(page: Page, home: Home) -> None:
    opened(page, home)
    home.publish(20)
    assert alive(page, home, "people", "Person 7"), page.text("people")
    assert alive(page, home, "people", "in the kitchen for")
    home.until_the_fall()
    assert alive(page, home, "happened", "Person 7 fell near the kitchen at"), page.text("happened")
    assert "has not got up for" in page.text("happened")
    assert alive(page, home, "people", "Lying")
    assert page.run("document.querySelectorAll('.person.alarm').length") == 1
    alerted = page.run("document.querySelector('[role=alert]').textContent")
    assert alerted.startswith("Person 7 fell near the kitchen")
    red = (
        "(() => { const c = document.getElementById('line'), pen = c.getContext('2d');"
        " const found = pen.getImageData(0, 54, c.width, c.height - 54).data; let count = 0;"
        " for (let i = 0; i < found.length; i += 4)"
        " count += found[i] === 0xb9 && found[i + 1] === 0x1c;"
        " return count; })()"
    )
    assert eventually(lambda: page.run(red) > 10), page.of("known", "m.known.happened")
    page.run("document.querySelector('.person .name').click()")
    assert page.shows("day", "Person 7 today") and page.shows("day", "fell near the kitchen")
    assert "in the kitchen" in page.text("day")
    page.press("Escape")
    assert eventually(lambda: page.run("document.getElementById('day') === null"))
    # Who opens the page later, or again, is told what happened before.
    opened(page, home)
    assert alive(page, home, "happened", "Person 7 fell near the kitchen at")
    assert page.messages == []


def test_uncertain_parts_energy_and_notices_are_said_in_words(page: Page, home: Home) -> None:
    opened(page, home)

    def unsure() -> bool:
        home.publish(1, unsure=True)
        home.status(overload="The edge is too slow for its slots.")
        return "left arm uncertain" in page.text("people")

    assert eventually(unsure)
    assert page.shows("notices", "The edge is too slow for its slots.")
    assert page.shows("energy", "about 15.0 W") and "modelled" in page.text("energy")
    assert "batteries last at this power" in page.text("energy") and "(50 %" in page.text("energy")
    against = "compared with all cameras always active."
    assert page.text("saved") == (
        f"Saved since the start, whole camera: 0.8 Wh (27 %) {against} Modelled."
    )
    assert page.text("saved-cpu") == (
        f"Saved since the start, processor time: 1 min (29 %) {against} Measured."
    )
    home.status()
    assert eventually(lambda: "too slow" not in page.text("notices"))


def test_the_page_can_be_used_by_keyboard_alone(page: Page, home: Home) -> None:
    opened(page, home)
    assert alive(page, home, "people", "Person 7")
    named, focus = set(), "document.activeElement"
    for _ in range(40):
        page.press("Tab")
        named.add(
            page.run(f"{focus}.id || {focus}.getAttribute('aria-label') || {focus}.innerText")
        )
        if page.run(f"{focus}.id") in ("scene", "line"):
            # What has the focus shows it.
            assert page.run(f"getComputedStyle({focus}).outlineStyle") == "solid"
    assert {"wall", "scene", "sure", "Person 7", "line", "cameras"} <= named, named
    before = page.of("stage", "m.scene.place(1000, 0, 0)")
    page.run("document.getElementById('scene').focus()")
    page.press("ArrowLeft")
    assert page.of("stage", "m.scene.place(1000, 0, 0)") != before
    assert eventually(lambda: page.of("past", "Boolean(m.past.span)"))
    page.run("document.getElementById('line').focus()")
    page.press("ArrowLeft")
    assert page.shows("state", "past")
    assert page.run("document.getElementById('line').getAttribute('aria-valuetext')") != "now"
    page.press("-")
    assert page.shows("span", "1 h")
    page.run("document.getElementById('live').focus()")
    page.press("Enter")
    assert alive(page, home, "state", "live")
    page.run("document.querySelector('#details-box > summary').focus()")
    page.press("Enter")
    assert page.run("document.getElementById('details-box').open")


def test_axe_finds_nothing_serious(page: Page, home: Home) -> None:
    opened(page, home)
    home.until_the_fall()
    assert alive(page, home, "happened", "fell near")
    page.run("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    page.run("document.querySelectorAll('*').forEach((one) => { one.style.animation = 'none'; })")
    page.judge()


def test_a_slow_network_brings_the_page_all_the_same(page: Page, home: Home) -> None:
    page.slow()
    try:
        begun_s = time.monotonic()
        opened(page, home, "phone")
        assert time.monotonic() - begun_s < 30
        assert alive(page, home, "people", "Person 7")
    finally:
        page.slow(False)
    assert page.messages == []
