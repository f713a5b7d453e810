"""Notices and postures as the page is told them."""

from __future__ import annotations

import datetime
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from tests.cases import each_case
from tests.site.web.watched import STARTED_NS, poses, status

from e3pose.events.body import carriage, joints_of
from e3pose.model.people import People
from e3pose.model.person_event import PersonEvent
from e3pose.model.skeleton import COCO17
from e3pose.settings.site_file import ZoneTable
from e3pose.site.connect import LiveSlot, live_slot
from e3pose.site.web.notices import LEAST_FREE, LOOK_S, Around, Surroundings, notices
from e3pose.site.web.postures import doing, posture, told, unsure_parts
from e3pose.site.zones import Zones, advance
from e3pose.wire.site_messages import CameraStatus, Status

NOW = datetime.datetime(2026, 11, 26, 12, tzinfo=datetime.timezone.utc)
FINE = msgspec.structs.replace(status(1000), uptime_s=100.0)
SLOT = replace(live_slot(poses(1000)), stored_from=0, stored_to=990)
SOON = Around(certificates=(("cam0", NOW + datetime.timedelta(days=3, hours=1)),))


def cameras(**last: Any) -> Status:
    third = CameraStatus(**{"camera_id": "c2", "online": True, **last})
    return msgspec.structs.replace(FINE, cameras=(*FINE.cameras[:2], third))


@each_case(
    ("told", "around", "kind", "words"),
    [
        (msgspec.structs.replace(FINE, overload="too slow"), Around(), "overload", "too slow"),
        (msgspec.structs.replace(FINE, doubt="people"), Around(), "calibration", "people"),
        (cameras(online=False, why="silent for 2 s", title="Küche"), Around(), "camera-gone",
         "1 camera of 3 gone: Küche (silent for 2 s)."),
        (cameras(battery=0.05), Around(), "battery", "Battery almost empty: c2."),
        (cameras(battery=0.05, title="Küche"), Around(), "battery", "empty: Küche."),
        (FINE, Around(free=10_000_000), "disk", "10 MB left"),
        (FINE, SOON, "certificate", "cam0 expires in 3 days, on 2026-11-29: e3pose keys"),
        (FINE, Around(certificates=(("edge", NOW - datetime.timedelta(days=1)),)), "certificate",
         "edge expired on 2026-11-25"),
    ],
    ids=["overload", "calibration", "camera", "battery", "titled battery", "disk",
         "certificate soon", "certificate over"],
)  # fmt: skip
def test_one_thing_is_wrong_and_told(told: Status, around: Around, kind: str, words: str) -> None:
    (found,) = notices(told, SLOT, around, NOW)
    assert found.kind == kind and words in found.text


@each_case(
    "told",
    [
        FINE, cameras(online=False, asleep_s=4.0), cameras(online=False, paused=True),
        msgspec.structs.replace(cameras(online=False), uptime_s=5.0),
    ],
    ids=["fine", "asleep", "paused", "just started"],
)  # fmt: skip
def test_nothing_is_wrong(told: Status) -> None:
    assert notices(told, SLOT, Around(free=LEAST_FREE), NOW) == []


def test_store_that_takes_nothing_is_told_but_not_while_it_begins() -> None:
    behind = replace(SLOT, stored_to=-1)
    (found,) = notices(FINE, behind, Around(), NOW)
    assert found.kind == "store" and "the last 40 seconds" in found.text
    assert notices(FINE, replace(behind, stored_from=950), Around(), NOW) == []
    assert notices(FINE, None, Around(), NOW) == []


def test_surroundings_are_looked_at_now_and_then(tmp_path: Path) -> None:
    now_s = [0.0]
    around = Surroundings(tmp_path / "lab.db", tmp_path / "no-keys", lambda: now_s[0])
    first = around.look(NOW)
    assert first.free is not None and first.free > 0 and not first.certificates
    around.store = None
    assert around.look(NOW) is first
    now_s[0] = LOOK_S
    assert around.look(NOW).free is None


def slot(number: int = 3) -> LiveSlot:
    found = live_slot(poses(number))
    joints_m = np.zeros_like(found.people.joints_m) + found.people.joints_m[:, :1]
    people = People(found.people.track_ids, joints_m, sigma_m=found.people.sigma_m)
    return replace(found, people=people)


def test_wide_or_unknown_joints_make_a_part_uncertain_and_others_not() -> None:
    wide = slot()
    bare = People(wide.people.track_ids, wide.people.joints_m)  # a sigma that is not stated
    assert unsure_parts(replace(wide, people=bare)) == [[], []]
    sigma_m, joints_m = wide.people.sigma_m.copy(), wide.people.joints_m.copy()
    sigma_m[0, COCO17.joints.index("left_wrist")] = 0.2
    joints_m[1, COCO17.joints.index("right_knee")] = np.nan
    joints_m[1, COCO17.joints.index("left_ear")] = np.nan  # the other ear is known
    found = unsure_parts(
        replace(wide, people=replace(wide.people, sigma_m=sigma_m, joints_m=joints_m))
    )
    assert found == [["left arm"], ["right leg"]]


def test_carriage_is_told_and_what_no_joint_tells_is_not() -> None:
    joints = joints_of(COCO17.joints)
    joints_m = np.full((17, 3), np.nan)

    def place(name: str, x: float, z: float) -> None:
        for side, y in (("left", 0.15), ("right", -0.15)):
            joints_m[COCO17.index(f"{side}_{name}")] = x, y, z

    place("hip", 0.0, 0.9)
    place("shoulder", 0.3, 1.2)  # leans by 45 degrees
    held = carriage(joints, joints_m, 0.0)
    np.testing.assert_allclose([held.hips_m, held.trunk_deg], [0.9, 45.0])
    assert np.isnan(held.arms_raised), "no wrist is known"
    joints_m[COCO17.index("left_wrist")] = 0.3, 0.15, 1.5
    np.testing.assert_allclose(carriage(joints, joints_m, 0.5)[::2], [0.4, 1.0])
    joints_m[COCO17.index("right_wrist")] = 0.3, -0.15, 1.0
    assert carriage(joints, joints_m, 0.0).arms_raised == 1.0
    assert set(posture(7, None).values()) == {None}


def test_zones_are_those_that_the_person_is_in_since_when() -> None:
    table = ZoneTable("hall", ((-2.0, -2.0), (0.0, -2.0), (0.0, 2.0), (-2.0, 2.0)))
    here = live_slot(poses(0))
    zones, _ = advance(Zones((table,)), here)
    left, right = doing(here, None, zones)
    assert left["zones"] == [{"name": "hall", "since_ns": STARTED_NS}] and right["zones"] == []
    assert left["state"] is None, "nobody follows people"


def test_event_has_what_a_page_makes_a_sentence_of() -> None:
    event = PersonEvent("fall", "begun", 3, "door", STARTED_NS, STARTED_NS + 1, 5, 0.9, "fell")
    words = told(event)
    assert words["kind"] == "fall" and words["track"] == 3 and words["zone"] == "door"
    assert words["sentence"].startswith("Person 3 fell (door)")
