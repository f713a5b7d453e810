"""A test in one's own room says what was seen, and why no fall was told."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pytest
from tests.events.bodies import doing, seen

from e3pose.events import watch as watching
from e3pose.events.people import Seen
from e3pose.events.trial import NOBODY_DOWN, NOBODY_SEEN, Trial, account, advance, as_json
from e3pose.model.skeleton import COCO17
from e3pose.settings.events_table import EventsTable
from e3pose.settings.site_file import ZoneTable
from e3pose.simulate.episode_kinds import BED_M

LATE_NS = 100_000_000


def tried(
    slots: Iterable[Seen], table: EventsTable | None = None, zones: Sequence[ZoneTable] = ()
) -> tuple[Trial, list[str]]:
    """Return what was seen of some slots, of two cameras that take turns, and what was said."""
    watch = watching.begin_watch(table or EventsTable(), COCO17.joints, zones)
    trial, said = Trial(), list[str]()
    for slot in slots:
        watch, events = watching.advance(watch, slot)
        cameras = (f"cam{slot.slot % 2}",)
        trial, lines = advance(trial, watch, events, cameras, slot.time_ns + LATE_NS)
        said += lines
    return trial, said


def test_a_fall_is_told_with_its_delay_and_cameras() -> None:
    trial, said = tried(seen(doing("fall-forward", 0)))
    (fall,) = (one for one in trial.told if one.event.kind == "fall")
    assert fall.after_s == pytest.approx((fall.event.time_ns - fall.event.start_ns) / 1e9 + 0.1)
    slots, views = fall.views
    assert sum(views.values()) == slots > 20 and set(views) == {"cam0", "cam1"}
    assert any("is lying on the floor" in line for line in said)
    assert any(line.startswith("FALL begun: Person 1 fell") for line in said)
    sentences = account(trial, EventsTable())
    assert any(line.startswith("FALL of person 1: told 2.") for line in sentences), sentences
    assert any("lies_s is 20 s" in line for line in sentences), "it lay for less"
    assert as_json(trial, sentences)["told"][0]["kind"] == "fall"


def test_a_state_is_said_once_when_it_has_settled() -> None:
    _, said = tried(seen(doing("sit-hard", 0)))
    states = [line.split()[3] for line in said if line.startswith("Person")]
    assert states.count("sitting") == 1 and states[0] == states[-1] == "standing"


def test_nobody_seen_says_what_to_do() -> None:
    empty = (Seen(s.slot, s.time_ns, s.track_ids[:0], s.joints_m[:0], s.sigma_m[:0])
             for s in seen(doing("squat", 0)))  # fmt: skip
    trial, said = tried(empty)
    assert account(trial, EventsTable()) == [NOBODY_SEEN] and not said
    assert trial.lasted_s > 20 and trial.seen_s == 0


@pytest.mark.parametrize(
    ("kind", "why"),
    [("lie-on-floor", "slowly"), ("sit-on-floor", "sat there"), ("pick-up", NOBODY_DOWN)],
)
def test_what_is_no_fall_says_why(kind: str, why: str) -> None:
    trial, _ = tried(seen(doing(kind, 1)))
    assert any(why in line for line in account(trial, EventsTable())), account(trial, EventsTable())


def test_too_short_a_lie_names_the_setting() -> None:
    table = EventsTable(fall_s=60.0)
    trial, _ = tried(seen(doing("fall-left", 0)), table)
    assert any("after 60 s (fall_s)" in line for line in account(trial, table))


def test_lying_on_a_bed_is_said_to_be_no_floor() -> None:
    square = ((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0))
    trial, said = tried(
        seen(doing("lie-on-bed", 0)), zones=(ZoneTable("bed", square, height_m=BED_M),)
    )
    assert any("lying on bed, not on the floor" in line for line in said)
    assert any("is no floor" in line for line in account(trial, EventsTable()))


def test_a_site_without_the_kind_says_so() -> None:
    table = EventsTable(kinds=("waved",))
    trial, _ = tried(seen(doing("fall-left", 0)), table)
    assert any("does not list it" in line for line in account(trial, table))


def test_a_new_number_is_the_same_person() -> None:
    slots = list(seen(doing("fall-left", 0)))
    late = [Seen(s.slot, s.time_ns, s.track_ids + 7 * (s.slot > 100), s.joints_m, s.sigma_m)
            for s in slots]  # fmt: skip
    trial, _ = tried(late)
    assert set(trial.stays) == {8}
    assert sum(trial.stays[8].seconds.values()) == pytest.approx(trial.lasted_s, rel=0.05)
