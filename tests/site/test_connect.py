"""Following a site from Python: slots as arrays, a while of them as a take."""

from __future__ import annotations

import datetime
import threading
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from tests.events.bodies import doing, seen
from tests.memory_transport import Hub, MemoryTransport
from tests.site.tables import write_site
from tests.store.named import write_named

from e3pose import connect, plot, to_frame
from e3pose.base.errors import InputError
from e3pose.model.skeleton import COCO17, SKELETONS
from e3pose.settings.site_file import load_site
from e3pose.site.connect import (
    MAX_WAITING,
    Connection,
    LiveSlot,
    certified_site,
    names_for,
    no_name,
    take_of_slots,
)
from e3pose.site.streams import STREAMS, Source, naming
from e3pose.wire.arrays import pack
from e3pose.wire.codec import encode
from e3pose.wire.keys.folder import add_keys, init_keys
from e3pose.wire.site_messages import Poses, Status

NOW = datetime.datetime.now(datetime.timezone.utc)
JOINTS = SKELETONS["coco17"].joints
INTERVAL_NS = 40_000_000


def poses(slot: int, *track_ids: int) -> Poses:
    """People of whom all joints are at (track, slot, joint) but the last, which is missing."""
    joints_m = np.full((len(track_ids), len(JOINTS), 3), np.nan, dtype=np.float32)
    for row, track in enumerate(track_ids):
        joints_m[row, :-1] = [(track, slot, joint) for joint in range(len(JOINTS) - 1)]
    return Poses(
        slot,
        10**18 + slot * INTERVAL_NS,
        JOINTS,
        pack(np.array(track_ids, dtype=np.int64)),
        pack(joints_m),
        pack(np.full(joints_m.shape[:2], 0.01, dtype=np.float32)),
        pack(np.ones(joints_m.shape[:2], dtype=bool)),
        selected=("cam1", "cam2"),
        arrived=("cam2",),
        stored_from=1,
        stored_to=slot - 1,
        store_shed=5,
    )


def publish(edge: MemoryTransport, *messages: Poses) -> None:
    for message in messages:
        edge.publish("e3pose/lab/poses", encode(message))


def test_slots_come_in_order_as_arrays() -> None:
    hub = Hub()
    with Connection("lab", hub.join()) as site:
        publish(hub.join(), poses(3, 7), poses(4, 7, 9))
        first, second = site.next(), site.next()
    assert first is not None and second is not None
    assert (first.slot, second.slot, len(second)) == (3, 4, 2)
    assert second.people.track_ids.tolist() == [7, 9]
    np.testing.assert_array_equal(second.people.joints_m[1, 5], [9, 4, 5])
    assert second.selected == ("cam1", "cam2") and second.arrived == ("cam2",)
    assert (second.stored_from, second.stored_to, second.store_shed) == (1, 3, 5)
    assert second.time_ns == 10**18 + 4 * INTERVAL_NS and second.people.measured.all()
    assert second.delay_ms == 0.0


def test_smoothed_slots_are_followed_in_place_of_those_at_once() -> None:
    hub = Hub()
    with Connection("lab", hub.join(), delayed=True) as site:
        edge = hub.join()
        publish(edge, poses(4, 7))
        edge.publish("e3pose/lab/poses-delayed", encode(replace(poses(3, 7), delay_ms=100.0)))
        slot = site.next()
    assert slot is not None and (slot.slot, slot.delay_ms) == (3, 100.0)


def test_iteration_ends_with_the_connection() -> None:
    hub = Hub()
    site, seen = Connection("lab", hub.join()), list[int]()
    publish(hub.join(), poses(1, 7))

    def watch() -> None:
        for slot in site:
            seen.append(slot.slot)
            site.close()

    watching = threading.Thread(target=watch)
    watching.start()
    watching.join(10)
    assert seen == [1] and not watching.is_alive()


def test_who_is_slow_loses_the_oldest_slots_and_may_skip_to_the_newest() -> None:
    hub = Hub()
    with Connection("lab", hub.join()) as site:
        publish(hub.join(), *(poses(slot) for slot in range(MAX_WAITING + 5)))
        assert site.dropped == 5
        slot = site.next()
        assert slot is not None and slot.slot == 5
        assert site.newest().slot == MAX_WAITING + 4


def test_site_that_is_silent_is_an_error_that_says_what_to_check() -> None:
    hub = Hub()
    with Connection("lab", hub.join(), wait_s=0.01) as site:
        with pytest.raises(InputError, match=r"site lab: no slot for 0\.01 s: check"):
            next(iter(site))
        with pytest.raises(InputError, match="no status"):
            site.status()
        hub.join().publish("e3pose/lab/status", encode(Status("lab", 3, 25.0, 2, 1, ())))
        assert site.status().slot == 3


def test_a_while_becomes_a_take_with_arrays_over_time() -> None:
    hub = Hub()
    with Connection("lab", hub.join()) as site:
        publish(hub.join(), poses(10, 7), poses(11, 7, 9), poses(13, 9))
        take = site.take(0.1)
    joints_m, tracks, first = take.dense()
    assert (joints_m.shape, tracks, first) == ((4, 2, 17, 3), (7, 9), 10)
    assert take.interval_s == pytest.approx(0.04) and take.skeleton.name == "coco17"
    np.testing.assert_array_equal(joints_m[1, 1, 5], [9, 11, 5])
    assert np.isnan(joints_m[2]).all() and np.isnan(joints_m[:, :, -1]).all()
    frame = to_frame(take)
    assert len(frame) == 4 * 16 and set(frame["origin"]) == {"measured"}
    row = frame[(frame.slot == 13) & (frame.joint == JOINTS[5])].iloc[0]
    assert (row.track, row.x, row.y, row.z) == (9, 9.0, 13.0, 5.0)
    assert row.time.value == 10**18 + 13 * INTERVAL_NS


def test_picture_shows_the_people_of_a_slot() -> None:
    import matplotlib

    matplotlib.use("agg")
    slots = [_slot(3, 7), _slot(4, 7, 9)]
    take = take_of_slots(slots, 0.04)
    drawn = plot(take)
    assert drawn.get_title() == "slot 4"
    assert [text.get_text() for text in drawn.get_legend().get_texts()] == ["person 7", "person 9"]
    with pytest.raises(InputError, match="slot: found 5, expected 3 to 4"):
        plot(take, 5)
    with pytest.raises(InputError, match="slots: found none"):
        take_of_slots([], 0.04)


def _slot(slot: int, *track_ids: int) -> LiveSlot:
    hub = Hub()
    with Connection("lab", hub.join()) as site:
        publish(hub.join(), poses(slot, *track_ids))
        return site.newest()


def test_endpoint_needs_the_keys_and_the_name_of_the_site(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='missing: keys="NAME"'):
        connect("tls/edge.local:7447")
    with pytest.raises(InputError, match='missing: site="NAME"'):
        connect("tcp/127.0.0.1:7447")
    with pytest.raises(InputError, match="endpoint"):
        connect("edge.local")
    init_keys(tmp_path / "keys", "lab", [], NOW)
    folder = add_keys(tmp_path / "keys", "wall", NOW, kind="viewer")
    assert certified_site(folder / "authority.pem") == "lab"


def test_events_of_people_are_told_as_they_happen() -> None:
    hub = Hub()
    names = {7: "Ada"}.get
    with Connection("lab", hub.join(), wait_s=0.2, names=lambda track: names(track, "")) as site:
        edge = hub.join()
        for one in seen(doing("fall-forward", 0)):
            joints_m = pack(one.people.joints_m.astype(np.float32))
            publish(edge, replace(poses(one.slot, 7), time_edge_ns=one.time_ns, joints_m=joints_m))
        told = []
        with pytest.raises(InputError, match="no slot"):
            for event in site.events():
                told.append((event.kind, event.track, event.name))
    assert told == [("fall", 7, "Ada"), ("got-up", 7, "Ada")]


def test_names_go_only_where_the_site_file_lists_it(tmp_path: Path) -> None:
    write_named(tmp_path / "poses.db")
    site = write_site(tmp_path, '[store]\npath = "poses.db"\n')
    assert names_for(site, "mqtt") is no_name, "without [events]"
    place = site.path
    place.write_text(place.read_text() + '[events]\nnames = ["mqtt", "python"]\n')
    site = load_site(place)
    assert names_for(site, "mqtt")(10) == names_for(site, "python")(10) == "Ada"
    source = Source("lab", COCO17, 12.5)
    told = {kind for kind in STREAMS if naming(source, site, f"{kind}://x").names(10)}
    assert told == {"mqtt", "mqtts"}
    place.write_text(place.read_text().replace('"mqtt"', '"mcap"'))
    with pytest.raises(InputError, match="names: found 'mcap', expected some of foxglove"):
        load_site(place)
