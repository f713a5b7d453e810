"""Notices come with what they are about, and go with it."""

from __future__ import annotations

import datetime
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
from tests.cases import each_case
from tests.site.web.watched import poses, status

from e3pose.site.connect import live_slot
from e3pose.site.web.notices import LEAST_FREE, LOOK_S, Around, Surroundings, notices
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
        (cameras(online=False, why="silent for 2 s"), Around(), "camera-gone",
         "1 camera of 3 gone: c2 (silent for 2 s)."),
        (cameras(battery=0.05), Around(), "battery", "Battery almost empty: c2."),
        (FINE, Around(free=10_000_000), "disk", "10 MB left"),
        (FINE, SOON, "certificate", "cam0 expires in 3 days, on 2026-11-29: e3pose keys"),
        (FINE, Around(certificates=(("edge", NOW - datetime.timedelta(days=1)),)), "certificate",
         "edge expired on 2026-11-25"),
    ],
    ids=["overload", "calibration", "camera", "battery", "disk", "certificate soon",
         "certificate over"],
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
