"""What people did in the past is found again from the store: posture, speed, zones, since when."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from tests.site.web.watched import RIG, STARTED_NS, Watched, watched_site

from e3pose.events.states import STATES
from e3pose.events.watch import advance, begin_watch
from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.model.zone_event import ZoneEvent
from e3pose.pipeline import SlotRecord
from e3pose.settings.events_table import EventsTable
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.stored import stored_slots
from e3pose.store import Run, Store, StoreWriter

FPS = 12.5
BEGUN_NS = STARTED_NS + 3600 * 10**9  # another run than that of `watched_site`
ZONE = """[[zone]]
name = "kitchen"
corners = [[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]]
"""


def store_fall(place: Path) -> int:
    """Store somebody who falls and lies there as track 7 of a further run; return the slots."""
    recording = simulate(SceneSettings("home-fall", seconds=30.0, fps=FPS, cameras=3), 1)
    assert recording.truth is not None
    joints_m, zeros, flags = recording.truth.joints_m, np.zeros(3), np.ones(3, dtype=bool)
    run = Run("lab", "lab", BEGUN_NS, 1 / FPS, "coco17", COCO17.joints, RIG.camera_ids)
    with StoreWriter(place, run) as writer:
        for slot, bodies in enumerate(joints_m):
            made = SlotRecord(
                slot=slot, time_s=slot / FPS, selected=flags, arrived=flags,
                people=People(np.array([7]), bodies, sigma_m=np.full((1, 17), 0.01)),
                occlusion=zeros, deficit=zeros, next_selection=flags,
            )  # fmt: skip
            writer.append(made, time_ns=at_ns(slot), wait=True)
        for kind, slot, stayed_s in (("enter", 10, 0.0), ("leave", 200, 15.2), ("enter", 300, 0.0)):
            zone = ZoneEvent(kind, "kitchen", 7, 1, stayed_s, slot, at_ns(slot))  # type: ignore[arg-type]
            writer.zone(zone)
        assert writer.flush(30.0)
    return len(joints_m)


def at_ns(slot: int) -> int:
    return BEGUN_NS + round(slot / FPS * 1e9)


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Watched]:
    with watched_site(tmp_path_factory.mktemp("site"), ZONE) as made:
        store_fall(made.folder / "lab.db")
        yield made


@pytest.fixture
def client(watched: Watched) -> Iterator[httpx.Client]:
    with watched.client() as made:
        yield made


def asked(first: int, last: int, limit: int = 2000, **more: Any) -> dict[str, Any]:
    span = {"start": str(at_ns(first)), "end": str(at_ns(last))}
    return {**span, "doing": True, "limit": limit, **more}


def slots_of(client: httpx.Client, first: int, last: int, **more: Any) -> list[dict[str, Any]]:
    answer = client.get("/api/poses", params=asked(first, last, **more))
    assert answer.status_code == 200, answer.text
    return list(answer.json()["slots"])


def test_postures_of_the_past_are_the_live_ones(client: httpx.Client, watched: Watched) -> None:
    found = slots_of(client, 130, 370)
    states = {slot["slot"]: slot["people"][0]["state"] for slot in found}
    assert states[140] in ("standing", "walking") and states[360] == "lying", states
    # Whoever followed all slots from the first says the same.
    watch = begin_watch(EventsTable(), COCO17.joints)
    live: dict[int, str] = {}
    for _, slot in stored_slots(Store(watched.folder / "lab.db").read(run=2)):
        watch, _ = advance(watch, slot)
        live[slot.slot] = STATES[int(watch.shown[7].states.argmax())]
    same = np.mean([live[slot] == state for slot, state in states.items()])
    assert same > 0.97, same
    assert found[0]["people"][0]["speed_mps"] is not None


def test_since_when_somebody_is_there_and_in_a_zone(client: httpx.Client) -> None:
    (slot,) = slots_of(client, 150, 150)
    (person,) = slot["people"]
    assert person["since_ns"] == at_ns(0)
    assert person["zones"] == [{"name": "kitchen", "since_ns": at_ns(10)}]
    (away,) = slots_of(client, 250, 250)
    assert away["people"][0]["zones"] == []
    (back,) = slots_of(client, 310, 310)
    assert back["people"][0]["zones"] == [{"name": "kitchen", "since_ns": at_ns(300)}]


def test_pages_say_the_same_as_one_answer(client: httpx.Client) -> None:
    whole = slots_of(client, 200, 259)
    first = client.get("/api/poses", params=asked(200, 259, limit=31)).json()
    rest = slots_of(client, 200, 259, cursor=first["cursor"])
    apart = [slot["people"][0]["state"] for slot in first["slots"] + rest]
    assert apart == [slot["people"][0]["state"] for slot in whole]


def test_poses_without_doing_are_as_before(client: httpx.Client) -> None:
    plain = client.get("/api/poses", params={"start": str(at_ns(150)), "end": str(at_ns(150))})
    assert set(plain.json()["slots"][0]["people"][0]) == {
        "track", "joints_m", "sigma_m", "measured",
    }  # fmt: skip
    refused = client.get("/api/poses", params={"doing": True, "joint": "nose"})
    assert refused.status_code == 422 and "whole bodies" in refused.json()["detail"]
    empty = client.get("/api/poses", params={"doing": True, "start": "1000000000000000000",
                                             "end": "1000000000000000001"})  # fmt: skip
    assert empty.status_code == 200 and empty.json()["slots"] == []


def test_slots_that_lie_in_two_chunks_are_one(watched: Watched) -> None:
    store = Store(watched.folder / "lab.db")
    whole = [
        (run, slot.slot, slot.people.track_ids.tolist()) for run, slot in stored_slots(store.read())
    ]
    for chunk in (1, 3, 7):
        parts = stored_slots(store.read(chunk=chunk))
        assert [(run, slot.slot, slot.people.track_ids.tolist()) for run, slot in parts] == whole
    assert whole[0] == (1, 0, [10, 11]) and len(set(whole[0][2])) == 2
    assert list(stored_slots([])) == []
