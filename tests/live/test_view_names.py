"""Names and colours on the page: what an operator types stays with the person."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.site.web.browser import SHOWN_S, Page, in_browser
from tests.site.web.watched import Watched, watched_site
from tests.waiting import eventually

from e3pose.base.errors import InputError
from e3pose.model.camera_fields import check_camera_id
from e3pose.store.people import people_of, set_name

pytestmark = in_browser
GOLD = (0xB3, 0x86, 0x00)  # of the palette in output/report/scene.js


@pytest.fixture
def watched(tmp_path: Path) -> Iterator[Watched]:
    with watched_site(tmp_path) as made:
        yield made


def opened(page: Page, watched: Watched, token: str) -> None:
    page.open(f"{watched.view.url}#token={token}", 1280, 900)
    page.messages.clear()  # what the page before said of its server
    assert page.shows("site", "lab")
    assert eventually(lambda: watched.view.feed.followers >= 1)
    watched.publish(20)
    assert eventually(lambda: page.of("known", "m.known.run === 1"))
    assert eventually(lambda: "10" in page.text("people") or "Ada" in page.text("people"), SHOWN_S)


def day_of(page: Page, place: int) -> None:
    """Open the day of a person in the list."""
    page.run(f"document.querySelectorAll('.person .name')[{place}].click()")
    assert page.shows("day", "Seen from")


def close(page: Page) -> None:
    page.press("Escape")
    assert eventually(lambda: page.run("document.getElementById('day') === null"))


def type_name(page: Page, name: str) -> None:
    page.run(
        "(() => { const box = document.getElementById('name'); box.focus(); box.select(); })()"
    )
    page.call("Input.insertText", text=name)
    page.press("Enter")


def gold(page: Page) -> int:
    return int((np.abs(page.picture().astype(int) - GOLD).max(axis=-1) <= 2).sum())


def test_a_name_and_a_colour_stay_with_the_person(page: Page, watched: Watched) -> None:
    opened(page, watched, watched.view.tokens.write)
    assert page.text("people").count("Person") == 2 and gold(page) == 0
    day_of(page, 0)
    page.run("document.querySelector('#colours input[value=gold]').click()")
    type_name(page, "Ada <b>L</b>")
    assert page.shows("called-said", "Named 1 track. Colour: gold")
    assert page.shows("day-title", "Ada <b>L</b>")
    close(page)
    assert page.shows("people", "Ada <b>L</b>") and eventually(lambda: gold(page) > 100)
    # Another number that is the same person.
    day_of(page, 1)
    page.run("(() => { const box = document.getElementById('name'); box.focus(); })()")
    page.call("Input.insertText", text="Ada <b>L</b>")
    assert page.shows("called-said", "both are then the same person")
    page.press("Enter")
    assert page.shows("called-said", "Named 1 track")
    close(page)
    assert eventually(lambda: page.text("people").count("Ada <b>L</b>") == 2)
    (person,) = people_of(watched.folder / "lab.db")
    assert person.tracks == ((1, 10), (1, 11)) and person.colour == "gold"
    # It is there after a reload, for a viewer, and in the past.
    opened(page, watched, watched.view.tokens.read)
    assert eventually(lambda: page.text("people").count("Ada <b>L</b>") == 2)
    day_of(page, 0)
    assert page.run("document.getElementById('called') === null")
    close(page)
    page.of("past", "void m.seek(m.past.span.begin_s + 1.0)")
    assert page.shows("state", "past")
    assert eventually(lambda: page.text("people").count("Ada <b>L</b>") == 2)
    assert page.messages == []


HOSTILE = """<img src=x onerror="window.hit=1"><svg onload='window.hit=1'>{{x}}${x}"""


def test_a_name_runs_no_script(page: Page, watched: Watched) -> None:
    """In the list, in the drawing, in the dialog and its box, and in the past.

    Names of cameras, zones and sites are letters, digits and dashes; those of people are anything.
    """
    for word in (HOSTILE, "<script>x"):
        with pytest.raises(InputError):
            check_camera_id(word)  # also of zones, and of a site by the same letters
    set_name(watched.folder / "lab.db", ((1, 10),), HOSTILE)
    opened(page, watched, watched.view.tokens.write)
    assert eventually(lambda: HOSTILE in page.text("people"))
    day_of(page, 0)
    assert page.shows("day-title", HOSTILE)
    assert page.run("document.getElementById('name').value") == HOSTILE
    close(page)
    page.of("past", "void m.seek(m.past.span.begin_s + 1.0)")
    assert page.shows("state", "past") and eventually(lambda: HOSTILE in page.text("people"))
    made = "document.querySelectorAll('img[onerror], svg[onload], img[src=x]').length"
    assert page.run(made) == 0 and page.run("window.hit === undefined")
    assert page.messages == []  # nor did anything hold it back


def test_somebody_who_was_taken_for_another_gets_the_own_name(page: Page, watched: Watched) -> None:
    set_name(watched.folder / "lab.db", ((1, 10), (1, 11)), "Ada")
    opened(page, watched, watched.view.tokens.write)
    assert eventually(lambda: page.text("people").count("Ada") == 2)
    day_of(page, 1)
    assert eventually(lambda: page.run("document.getElementById('only') !== null"))
    page.run("document.getElementById('only').click()")
    type_name(page, "Bob")
    assert page.shows("day-title", "Bob")
    close(page)
    assert page.shows("people", "Bob") and page.shows("people", "Ada")
    day_of(page, 1)
    type_name(page, "7")
    assert page.shows("called-said", "not only digits")
    close(page)
    assert page.shows("people", "Bob")
    assert [text for text in page.messages if "422" not in text] == []
