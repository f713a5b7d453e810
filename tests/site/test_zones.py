"""Who enters, stays in and leaves a part of the floor."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.model.people import People
from e3pose.model.region import distance_m, in_polygon, middles_m
from e3pose.settings.site_file import ZoneTable
from e3pose.site.connect import LiveSlot
from e3pose.site.zones import Zones, advance

FPS = 10
# An L, so that the polygon is not convex.
CORNERS = ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0))
ZONE = ZoneTable("door", CORNERS, dwell_s=0.5)


def slot(number: int, **places: tuple[float, float]) -> LiveSlot:
    """People by track (`t7`) whose two joints are around a place; a third is missing."""
    joints_m = np.full((len(places), 3, 3), np.nan, dtype=np.float32)
    for row, (x, y) in enumerate(places.values()):
        joints_m[row, :2] = [(x - 0.2, y, 1.0), (x + 0.2, y, 1.5)]
    tracks = np.array([int(name[1:]) for name in places], dtype=np.int64)
    people = People(tracks, joints_m, sigma_m=np.zeros(joints_m.shape[:2]))
    time_ns = 10**18 + number * 10**9 // FPS
    return LiveSlot(number, time_ns, people, ("a", "b", "c"), (), (), 0)


def events_of(zones: Zones, *slots: LiveSlot) -> tuple[Zones, list[tuple[str, int, int, int]]]:
    """Return the state after slots, and kind, track, count and slot of what happened."""
    found: list[tuple[str, int, int, int]] = []
    for one in slots:
        zones, events = advance(zones, one)
        found += [(event.kind, event.track, event.count, event.slot) for event in events]
    return zones, found


def test_polygon_has_what_lies_in_it_and_the_middle_of_nobody_is_nowhere() -> None:
    places = np.array([[0.5, 0.5], [1.5, 0.5], [0.5, 1.5], [1.5, 1.5], [-0.1, 1], [np.nan, 0]])
    corners = np.array(CORNERS)
    assert in_polygon(places, corners).tolist() == [True, True, True, False, False, False]
    assert in_polygon(places, corners[::-1]).tolist() == in_polygon(places, corners).tolist()
    assert distance_m(places[3:5], corners) == pytest.approx([0.5, 0.1])
    # Middle of somebody without joints is nowhere.
    assert np.isnan(middles_m(np.full((1, 3, 3), np.nan))).all()
    assert middles_m(slot(0, t7=(1, 2)).people.joints_m)[0] == pytest.approx([1, 2])


def test_people_enter_stay_and_leave() -> None:
    zones = Zones((ZONE,))
    zones, events = events_of(zones, slot(0, t7=(3, 3)), slot(1, t7=(0.5, 0.5)))
    assert events == [("enter", 7, 1, 1)] and zones.counts() == {"door": 1}
    zones, events = events_of(zones, slot(2, t7=(0.5, 1), t9=(1.5, 0.5)))
    assert events == [("enter", 9, 2, 2)]
    zones, events = events_of(zones, *(slot(n, t7=(0.5, 1), t9=(1.5, 0.5)) for n in range(3, 12)))
    assert events == [("dwell", 7, 2, 6), ("dwell", 9, 2, 7)]  # each once
    zones, events = events_of(zones, slot(12, t7=(3, 3), t9=(1.5, 0.5)))
    assert events == [("leave", 7, 1, 12)] and zones.counts() == {"door": 1}


def test_who_sways_at_the_edge_or_is_lost_has_not_left_at_once() -> None:
    _, events = events_of(
        Zones((ZONE,)),
        *(slot(n, t7=(-0.03 if n % 2 else 0.03, 0.5)) for n in range(4)),
        slot(4, t7=(-0.2, 0.5)),
    )
    assert [kind for kind, *_ in events] == ["enter", "leave"]
    # Track that is lost has left after a second.
    zones, events = events_of(
        Zones((ZONE,)), slot(0, t7=(0.5, 0.5)), *(slot(n) for n in range(1, 10))
    )
    assert events == [("enter", 7, 1, 0)]
    _, events = events_of(zones, slot(10), slot(11), slot(12))
    assert events == [("leave", 7, 0, 11)]


@each_case(
    ("change", "message"),
    [
        ({"name": "a b"}, "name"),
        ({"corners": CORNERS[:2]}, "corners: found 2, expected 3 to 100"),
        ({"corners": ((0.0, 1e9), *CORNERS[:2])}, "corners"),
        ({"dwell_s": -1.0}, "dwell_s"),
    ],
)
def test_zone_that_is_none_is_refused(change: dict[str, object], message: str) -> None:
    fields = {"name": "door", "corners": CORNERS, "dwell_s": 1.0}
    with pytest.raises(InputError, match=message):
        ZoneTable(**{**fields, **change})  # type: ignore[arg-type]
