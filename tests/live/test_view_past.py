"""The past on the page: postures, zones, events of then; a time line that asks for little."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from tests.site.web.browser import Page, in_browser
from tests.site.web.test_past import FPS, ZONE, at_ns, store_fall
from tests.site.web.watched import RIG, Watched, watched_site
from tests.waiting import eventually

from e3pose.model.people import People
from e3pose.model.skeleton import SKELETONS
from e3pose.pipeline import SlotRecord
from e3pose.store import Event, Run, StoreWriter

pytestmark = in_browser
HAND, HAND_FROM = SKELETONS["left_hand21"], -20_000  # slots, before the run of the fall


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Watched]:
    with watched_site(tmp_path_factory.mktemp("site"), ZONE + "[events]\n") as made:
        store_fall(made.folder / "lab.db")
        run = Run("lab", "lab", at_ns(0), 1 / FPS, "coco17", (), ())
        with StoreWriter(made.folder / "lab.db", run) as writer:
            told_ns = at_ns(330)
            writer.event(
                Event(told_ns, "fall", "Person 7 fell", track_id=7, zone="kitchen",
                      phase="begun", start_ns=at_ns(325), score=0.9)
            )  # fmt: skip
            assert writer.flush(30.0)
        store_hand(made.folder / "lab.db")
        yield made


def store_hand(place: Path) -> None:
    """Store a hand alone as track 3 of a run of its own."""
    flags, zeros = np.ones(3, dtype=bool), np.zeros(3)
    run = Run("lab", "lab", at_ns(HAND_FROM), 1 / FPS, HAND.name, HAND.joints, RIG.camera_ids)
    joints_m = np.linspace([0.0, 0.0, 1.0], [0.1, 0.2, 1.2], 21)[None]
    people = People(np.array([3]), joints_m, sigma_m=np.full((1, 21), 0.01))
    with StoreWriter(place, run) as writer:
        for slot in range(20):
            record = SlotRecord(
                slot=slot, time_s=slot / FPS, selected=flags, arrived=flags, people=people,
                occlusion=zeros, deficit=zeros, next_selection=flags,
            )  # fmt: skip
            writer.append(record, time_ns=at_ns(HAND_FROM + slot), wait=True)
        assert writer.flush(30.0)


def opened(page: Page, watched: Watched) -> None:
    page.open(watched.view.url, 1280, 900)
    page.messages.clear()
    assert page.shows("site", "lab")
    assert eventually(lambda: page.of("past", "Boolean(m.past.span)"))


def test_past_says_what_people_did_and_where(page: Page, watched: Watched) -> None:
    opened(page, watched)
    page.of("past", f"void m.seek({at_ns(345) / 1e9}).then(() => m.setPlaying(false))")
    assert page.shows("state", "past")
    page.of("past", "m.setPlaying(true)")
    assert page.shows("people", "Lying")
    assert "in the kitchen for" in page.text("people") and "m" in page.text("people")
    assert page.of("known", "m.known.room.zones[0].count") == 1
    # The half minute before is there: paths, the strip of cameras, what happened until then.
    assert page.of("known", "m.known.history.length") > 300
    assert page.shows("happened", "fell near the kitchen")
    page.of("past", f"void m.seek({at_ns(140) / 1e9}).then(() => m.setPlaying(false))")
    upright = ("standing", "walking")
    assert eventually(lambda: any(word in page.text("people").lower() for word in upright))
    assert "fell" not in page.text("happened"), "it did not happen yet"
    assert page.messages == []


def test_past_draws_the_skeleton_of_then(page: Page, watched: Watched) -> None:
    opened(page, watched)
    page.of("past", f"void m.seek({at_ns(HAND_FROM + 5) / 1e9}).then(() => m.setPlaying(false))")
    assert eventually(lambda: page.of("known", "m.known.shown?.people[0]?.track") == 3)
    assert page.of("known", "m.known.shown.limbs") == [list(limb) for limb in HAND.limbs]
    lines = (
        "(() => { let lines = 0; const pen = CanvasRenderingContext2D.prototype, one = pen.lineTo;"
        "pen.lineTo = function (...to) { lines++; one.apply(this, to); };"
        "m.scene.touch(); m.scene.draw(); pen.lineTo = one; return lines; })()"
    )
    drawn = page.of("stage", lines)
    page.of("known", "m.known.shown.limbs = []")
    assert drawn - page.of("stage", lines) == 2 * len(HAND.limbs)  # and their shadows
    assert page.messages == []


def asked(page: Page) -> list[dict[str, list[str]]]:
    """Return what the page asked of the time line since it was opened."""
    urls = page.run(
        "performance.getEntriesByType('resource').map((one) => one.name)"
        ".filter((name) => name.includes('/api/timeline'))"
    )
    return [parse_qs(urlsplit(url).query) for url in urls]


def test_time_line_asks_again_only_for_what_is_new(page: Page, watched: Watched) -> None:
    opened(page, watched)
    assert eventually(lambda: len(asked(page)) >= 1)
    assert eventually(lambda: not page.of("timeline", "m.line.asking"))
    page.of("timeline", "m.look()")
    whole, again = asked(page)[0], asked(page)[-1]
    assert int(whole["parts"][0]) >= 200 and len(asked(page)) >= 2
    assert int(again["parts"][0]) <= 16, again  # those of the last seconds, which may still grow
    for zoom in range(6):  # from a minute to a week
        page.of("timeline", f"((m.line.zoom = {zoom}), m.look())")
        assert eventually(lambda: shows(page, zoom)), zoom  # noqa: B023
    # Whoever changes it while an answer is on its way gets that of what is shown.
    page.of("timeline", "((m.line.zoom = 0), void m.look(), (m.line.zoom = 2), void m.look())")
    assert eventually(lambda: shows(page, 2))
    # In the past, what lies around the moment is there.
    page.of("past", f"void m.seek({at_ns(140) / 1e9})")
    page.of("timeline", "((m.line.zoom = 1), m.look())")
    stored = "[...m.line.known.parts.values()].reduce((sum, [slots]) => sum + slots, 0)"
    assert eventually(lambda: page.of("timeline", stored) == store_slots())
    tracks = "[...m.line.known.tracks.values()].map((row) => row.track_id)"
    assert 7 in page.of("timeline", tracks)
    assert page.messages == []


def shows(page: Page, zoom: int) -> bool:
    """Return whether the line knows the whole stretch of a zoom."""
    found = f"m.line.known.zoom === {zoom} && m.line.known.parts.size >= 200"
    return bool(page.of("timeline", found))


def store_slots() -> int:
    """Return how many slots `store_fall` stores."""
    return round(30 * FPS)
