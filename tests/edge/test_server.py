"""A site in one process under faults."""

from __future__ import annotations

import random
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.edge.one_process import QuickClock, Site, site_at_work, started
from tests.manual_clock import ManualClock
from tests.waiting import WAIT_S, eventually, settled

from e3pose.base.clock import SlotTimes
from e3pose.base.kernel import INTERPRETING
from e3pose.edge import camera_state, server
from e3pose.edge.consumers import Consumers
from e3pose.edge.gather import Gather
from e3pose.edge.precompile import Beside
from e3pose.model.look_request import LookRequest
from e3pose.pipeline import SlotRecord, step
from e3pose.select.policies.base import Selection, Situation
from e3pose.store.rows import Event
from e3pose.store.writer import WriterStatus
from e3pose.wire import topics
from e3pose.wire.arrays import unpack
from e3pose.wire.codec import decode, encode
from e3pose.wire.messages import Heartbeat, Hello, Order

pytestmark = pytest.mark.slow


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with site_at_work(tmp_path) as made:
        yield made


@pytest.mark.timed
def test_slots_follow_each_other_with_people_where_they_are_and_orders_in_time(site: Site) -> None:
    edge = site.edge
    assert eventually(lambda: bool(site.poses) and len(unpack(site.poses[-1].track_ids)) > 0)
    found = next(p for p in reversed(site.poses) if len(unpack(p.track_ids)) > 0)
    joints = unpack(found.joints_m)
    truth = site.recording.truth
    assert truth is not None
    nearest = np.nanmin(
        np.linalg.norm(truth.joints_m[:, :, None, :, :] - joints[None, None], axis=-1).mean(-1)
    )
    assert nearest < 0.15  # somebody of the truth, at some time of the loop
    assert edge.threads.failure is None
    assert edge.counts.lost == 0
    slots = [poses.slot for poses in site.poses]
    assert slots == list(range(slots[0], slots[0] + len(slots)))

    def in_time() -> bool:
        """Return whether orders for 30 slots come in time: on a busy machine in the end, since
        the lead follows."""
        before = {i: (node.schedule.orders, node.schedule.late) for i, node in site.nodes.items()}
        missed, ordered = edge.counts.missed.sum(), edge.counts.ordered.sum()
        done = edge.counts.slots + 30
        assert eventually(lambda: edge.counts.slots >= done)
        came = {
            i: (node.schedule.orders - before[i][0], node.schedule.late - before[i][1])
            for i, node in site.nodes.items()
        }
        share = (edge.counts.missed.sum() - missed) / max(edge.counts.ordered.sum() - ordered, 1)
        return all(orders >= 20 and late <= 2 for orders, late in came.values()) and share <= 0.1

    assert eventually(in_time)
    assert all(node.threads.failure is None for node in site.nodes.values())


def test_garbage_puts_a_camera_in_quarantine_and_no_other(site: Site) -> None:
    liar = site.hub.join()
    for _ in range(25):
        liar.publish("e3pose/lab/camera/cam1/view", b"garbage")
        liar.publish("e3pose/lab/camera/nobody/view", b"garbage")
    assert site.online() == {"cam0", "cam2"}
    edge = site.edge
    assert edge.inbox.unknown_senders >= 25
    edge.inbox._change(1, lambda camera: replace(camera, quarantined_until_ns=0))  # let time pass
    assert eventually(lambda: site.online() == {"cam0", "cam1", "cam2"})


@pytest.mark.timed
def test_partition_is_noticed_in_two_seconds_and_healed(site: Site) -> None:
    def cut(topic: str, payload: bytes) -> bytes | None:
        return None if "cam2" in topic else payload

    silences_s: list[float] = []

    def without_it() -> bool:
        camera = site.camera("cam2")
        if camera.online:  # by the edge's own clock, and so the same on a machine that is busy
            silences_s.append(camera.last_seen_s or 0.0)
        return site.online() == {"cam0", "cam1"}

    assert eventually(lambda: len(site.online()) == 3)
    site.hub.fault = cut
    assert eventually(without_it)
    assert 1.0 < max(silences_s) < 2.0
    edge = site.edge
    here = edge.counts.slots
    assert eventually(lambda: edge.counts.slots > here + 10)  # the others go on
    assert eventually(lambda: site.reported("camera-lost", "cam2"))
    site.hub.fault = lambda topic, payload: payload
    assert eventually(lambda: site.online() == {"cam0", "cam1", "cam2"})
    assert eventually(lambda: site.reported("camera-back", "cam2"))


def test_two_programs_with_one_name_are_distinguished(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera_state, "RIVAL_S", 4.0)  # each sends two messages per second
    first = site.nodes["cam1"]
    second = site.start_camera("cam1")
    sessions = sorted((first.session, second.session))
    reported = f"two programs run as cam1 (sessions {sessions[0]} and {sessions[1]})"
    assert eventually(lambda: reported in site.camera("cam1").why)
    assert site.online() == {"cam0", "cam2"}
    assert eventually(lambda: any(reported in event.message for event in site.events))
    first.stop()
    assert eventually(lambda: len(site.online()) == 3)


def test_restarted_edge_goes_on_where_it_was_or_sets_a_damaged_state_aside(site: Site) -> None:
    edge = site.edge
    assert eventually(lambda: edge.newest is not None and len(edge.newest.people.track_ids) > 0)
    edge.stop()
    assert edge.newest is not None
    last, ids = edge.newest, set(edge.newest.people.track_ids.tolist())
    again = site.make_edge()
    assert again.state.slot == edge.state.slot > last.slot
    np.testing.assert_allclose(again.state.deficit, edge.state.deficit)
    again.start()
    assert eventually(lambda: again.counts.slots > 5)
    assert again.times == edge.times  # the same slots in the same time
    assert again.newest is not None and again.newest.slot > last.slot
    assert again.state.memory.belief.next_id >= edge.state.memory.belief.next_id
    assert ids <= set(range(again.state.memory.belief.next_id))
    assert eventually(lambda: len(site.online()) == 3)
    assert any(event.kind == "resumed" for event in site.events)
    again.stop()
    (site.folder / "state.npz").write_bytes(b"no state")
    anew = site.start_edge()
    assert (site.folder / "state.npz.unusable").read_bytes() == b"no state"
    assert eventually(lambda: anew.counts.slots > 5)


@pytest.mark.timed
def test_slow_and_lossy_air_makes_orders_go_out_earlier(site: Site) -> None:
    rng, edge = random.Random(2), site.edge
    before, slots, lost = edge.lead.slots, edge.counts.slots, edge.counts.lost
    site.hub.delay_s = lambda topic: rng.uniform(0.08, 0.13)
    site.hub.fault = lambda topic, payload: None if rng.random() < 0.05 else payload
    assert eventually(lambda: edge.lead.slots > before)
    assert edge.counts.slots > slots and edge.counts.lost == lost
    site.hub.delay_s = lambda topic: 0.0
    site.hub.fault = lambda topic, payload: payload
    assert eventually(lambda: len(site.online()) == 3)
    views = edge.counts.views
    assert eventually(lambda: edge.counts.views > views + 10)


@pytest.mark.timed
def test_orders_of_a_longer_lead_say_from_which_slot_they_are(site: Site) -> None:
    """Otherwise a lead that grows would seem to make orders late, and grow again."""
    orders: list[Order] = []
    listener, edge = site.hub.join(), site.edge
    listener.subscribe(
        topics.of_order("lab", "cam0"),
        lambda topic, payload: orders.append(decode(payload, Order, "edge")),
    )
    assert edge.times is not None
    before = edge.lead.slots
    site.hub.delay_s = lambda topic: 0.7 if "/order/" in topic else 0.0
    assert eventually(lambda: edge.lead.slots >= before + 8)
    needed = edge.lead.slots
    done = edge.counts.slots + 30
    assert eventually(lambda: edge.counts.slots >= done)
    sent_s = [
        (order.sent_edge_ns - edge.times.middle_ns(order.slot - order.lead)) / 1e9
        for order in orders
    ]
    assert max(sent_s) < 0.4  # views are waited for 0.15 s
    assert edge.lead.slots <= needed + 2


def test_state_that_cannot_be_kept_is_reported_once_and_stops_nobody(site: Site) -> None:
    edge = site.edge
    good = edge.state_file.path
    (site.folder / "file").write_text("in the way")
    edge.state_file.path = site.folder / "file" / "state.npz"
    slots = edge.counts.slots
    assert eventually(lambda: bool(edge.state_file.problem))
    assert eventually(lambda: edge.counts.slots > slots + 50)
    edge.state_file.path = good
    assert eventually(lambda: not edge.state_file.problem)
    reported = [event.message for event in site.events if event.kind == "checkpoint"]
    assert sum("cannot save the state" in line for line in reported) == 1
    assert "saving the state again" in reported[-1]


@pytest.mark.parametrize("hours", [-1, 1])
def test_edge_whose_clock_was_set_goes_on_with_the_next_slot(site: Site, hours: int) -> None:
    edge = site.edge
    assert eventually(lambda: edge.newest is not None and len(edge.newest.people.track_ids) > 0)
    edge.stop()
    slot = edge.state.slot
    # Sessions of a clock that went back are older than those of before.
    site.clock = QuickClock(site.clock.origin_ns + hours * 3600 * 10**9)
    again = site.start_edge()
    assert eventually(lambda: again.counts.views > 10)
    assert slot < again.state.slot < slot + 400
    said = [event.message for event in site.events if event.kind == "clock"][-1]
    ahead = "60 min since the last slot, by this machine's clock: slot numbers continue"
    assert ahead in said if hours > 0 else said
    assert eventually(lambda: len(site.online()) == 3)


@dataclass(eq=False)
class WaitingSink:
    """Waits in each slot until its poses and its order have come to others.

    Attributes:
        site: whose.
        orders: slots for which a camera was given orders.
        came: whether they did.
    """

    site: Site
    orders: list[int] = field(default_factory=list)
    came: list[bool] = field(default_factory=list)

    def append(self, record: SlotRecord, **_: object) -> bool:
        lead = self.site.edge.pipeline.lead_slots

        def there() -> bool:
            poses = any(one.slot == record.slot for one in self.site.poses[-3:])
            return poses and max(self.orders, default=0) >= record.slot + lead

        self.came.append(eventually(there, 2.0))
        return True

    def event(self, event: Event) -> bool:
        return True

    def status(self) -> WriterStatus:
        return WriterStatus(-1, 0, 0, 0, None)


def test_what_follows_people_runs_after_the_orders_and_poses_of_a_slot_have_gone(
    site: Site,
) -> None:
    sink, edge = WaitingSink(site), site.edge
    site.hub.join().subscribe(
        topics.of_order("lab", "cam0"),
        lambda topic, payload: sink.orders.append(decode(payload, Order, "edge").slot),
    )
    edge.consumers = Consumers(sink=sink)
    assert eventually(lambda: len(sink.came) > 20)
    assert all(sink.came[1:])


class Rest:
    """Select no camera."""

    def select(self, situation: Situation) -> Selection:
        """See `Policy.select`."""
        return np.zeros(len(situation.online), dtype=bool)


def counted(site: Site, cause: str) -> int:
    return site.edge.status().blind.get(cause, 0)


def test_lost_views_and_late_orders_make_slots_blind_and_a_policy_that_rests_none(
    site: Site,
) -> None:
    edge = site.edge
    before = counted(site, "views-missing")
    site.hub.fault = lambda topic, payload: None if topic.endswith("/view") else payload
    assert eventually(lambda: counted(site, "views-missing") >= before + 10)
    site.hub.fault = lambda topic, payload: payload
    assert eventually(lambda: bool(site.poses[-1].arrived))
    status = edge.status()
    assert 0 < status.blind_share < 1 and status.slots > sum(status.blind.values())
    assert all(not poses.blind for poses in site.poses if poses.arrived)
    # Duty is that of the other slots: three cameras in the warm-up, then two.
    assert 2 <= sum(camera.duty for camera in status.cameras) <= 3
    site.hub.delay_s = lambda topic: 0.5 if "/order/" in topic else 0.0
    assert eventually(lambda: counted(site, "orders-late") >= 3)
    site.hub.delay_s = lambda topic: 0.0
    edge.owner.pipeline = replace(edge.pipeline, policy=Rest())
    here = edge.counts.slots
    assert eventually(lambda: edge.counts.slots > here + 60)
    assert all(not poses.blind and not poses.selected for poses in site.poses[-15:])


def test_site_without_cameras_is_blind_and_its_slots_are_no_rest(site: Site) -> None:
    for node in site.nodes.values():
        node.stop()
    assert eventually(lambda: counted(site, "cameras-offline") >= 10)
    assert site.poses[-1].blind == "cameras-offline"
    for camera_id in site.recording.rig.camera_ids:
        site.start_camera(camera_id)
    assert eventually(lambda: bool(site.poses[-1].arrived))


def test_slot_waits_for_ordered_cameras_while_they_are_there_and_no_longer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = ManualClock(10**18)
    edge = started(tmp_path, clock=clock).make_edge()  # its threads are not
    inbox, times = edge.inbox, SlotTimes(clock.now_ns() + edge.interval_ns, edge.interval_ns)
    edge.orders.give(times, edge.state.slot, np.ones(3, dtype=bool), 1)
    clock.advance(1.5 * edge.interval_ns / 1e9)
    for camera in edge.pipeline.rig.cameras:
        name, joints = camera.camera_id, edge.settings.skeleton.joints
        hello = Hello(name, 1, joints, camera.image_size, 20.0)
        beat = Heartbeat(name, 1, clock.now_ns(), "active")
        inbox._hello(topics.of_camera("lab", name, "hello"), encode(hello))
        inbox._heartbeat(topics.of_camera("lab", name, "heartbeat"), encode(beat))
    naps: list[set[int]] = []

    def one_leaves(gather: Gather, clock: object, until_ns: int, awaited: Sequence[int]) -> None:
        naps.append(set(awaited))
        gone = edge.pipeline.rig.camera_ids[-len(naps)]  # no fourth nap
        inbox._presence(topics.of_camera("lab", gone, "alive"), False)

    monkeypatch.setattr(Gather, "sleep", one_leaves)
    assert edge._wait_for_views(times, edge.state.slot)
    assert naps == [{0, 1, 2}, {0, 1}, {0}]


def test_camera_that_ends_is_said_to_have_ended_and_comes_back(site: Site) -> None:
    site.nodes["cam1"].stop()
    assert eventually(lambda: site.camera("cam1").why == "stopped")
    assert not site.camera("cam1").online
    assert eventually(lambda: site.reported("camera-lost", "cam1"))
    words = [event.message for event in site.events if event.camera_id == "cam1"]
    assert words[-1] == "cam1: stopped"
    site.start_camera("cam1")
    assert eventually(lambda: site.camera("cam1").online)


def test_edge_says_that_it_compiles_and_orders_nobody_before_it_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiling, done = threading.Event(), threading.Event()

    def waits(*_: object) -> None:
        compiling.set()
        assert done.wait(WAIT_S)

    monkeypatch.setattr(server, "warm_up", waits)
    orders: list[str] = []
    made = started(tmp_path)
    made.hub.join().subscribe(topics.of_order("lab", "*"), lambda topic, _: orders.append(topic))
    edge = made.make_edge()
    starting = threading.Thread(target=edge.start)
    starting.start()
    try:
        assert compiling.wait(WAIT_S)
        for camera_id in made.recording.rig.camera_ids:
            made.start_camera(camera_id)
        assert eventually(lambda: len(made.online()) == 3)  # all are connected, and wait
        assert settled(lambda: len(orders) + edge.counts.slots) == 0
        assert edge.status().compiling_s is not None
        done.set()
        assert eventually(lambda: bool(orders) and edge.counts.slots > 5)
        assert edge.status().compiling_s is None
    finally:
        done.set()
        starting.join()
        for node in made.nodes.values():
            node.stop()
        edge.stop()


def test_poses_are_interpreted_while_a_process_compiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done, left = threading.Event(), threading.Event()
    beside = SimpleNamespace(ended=done.is_set, left_s=lambda: 30.0, leave=left.set)
    monkeypatch.setattr(Beside, "start", lambda *_: beside)
    interpreted: list[bool] = []

    def noted(*given: Any) -> Any:
        interpreted.append(INTERPRETING.on)
        return step(*given)

    monkeypatch.setattr(server, "step", noted)
    with site_at_work(tmp_path) as made:
        edge = made.edge
        assert not edge.ready
        assert eventually(lambda: bool(made.poses) and len(unpack(made.poses[-1].track_ids)) > 0)
        assert edge.status().compiling_s == 30.0
        assert all(interpreted) and not edge.status().overload
        done.set()
        slot = edge.state.slot
        assert eventually(lambda: edge.ready and edge.state.slot > slot + 20)
        assert edge.status().compiling_s is None and left.is_set()
        assert not interpreted[-1] and edge.threads.failure is None


class Displaced:
    """In place of what watches cameras: the third was turned."""

    found, world = SimpleNamespace(camera=2, degrees=3.0), None

    def observe(self, *_: object) -> None: ...
    def events(self) -> list[tuple[str, str, str]]:
        return []


def test_edge_tells_who_was_turned_and_looks_as_consumers_ask(site: Site) -> None:
    edge, more = site.edge, LookRequest(cameras=3.0, tracks=(1,))
    assert site.camera("cam2").turned_deg is None
    edge.consumers = Consumers(watch=Displaced(), asks=lambda: more)  # type: ignore[arg-type]
    assert eventually(lambda: edge.pipeline.request == more)
    assert site.camera("cam2").turned_deg == 3.0
    assert site.camera("cam1").turned_deg is None
