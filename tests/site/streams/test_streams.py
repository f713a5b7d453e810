"""Each stream is read back by the other side's own library, and says the same slot."""

from __future__ import annotations

import json
import queue
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from pythonosc.dispatcher import Dispatcher
from pythonosc.osc_server import ThreadingOSCUDPServer
from tests.cases import each_case
from tests.memory_transport import Hub
from tests.ports import free_port
from tests.site.streams.broker import broker, listening
from tests.site.test_channels import limit
from tests.waiting import eventually

from e3pose.base.errors import InputError
from e3pose.events.watch import begin_watch
from e3pose.model.people import People
from e3pose.model.person_event import PersonEvent
from e3pose.model.skeleton import COCO17
from e3pose.model.zone_event import ZoneEvent
from e3pose.settings.events_table import EventsTable
from e3pose.site.connect import Connection, LiveSlot
from e3pose.site.streams import Source, Stream, open_stream
from e3pose.site.streams.as_json import event_words
from e3pose.site.streams.base import TellsPeople
from e3pose.site.streams.send import Sender
from e3pose.site.zones import Zones
from e3pose.wire.arrays import packed_people
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import Poses

SOURCE = Source("lab", COCO17, 25.0, titles={"c0": "Küche"})
TIME_NS = 1_795_000_000_000_000_000
EVENT = ZoneEvent("enter", "door", 7, 2, 0.0, 3, TIME_NS)
FELL = PersonEvent("fall", "begun", 7, "bed", TIME_NS - 10**9, TIME_NS, 3, 0.9, "fell")
WATCH = begin_watch(EventsTable(), COCO17.joints)
OF_AN_EVENT = {*PersonEvent.__dataclass_fields__, "sentence"}
KNEE = COCO17.joints.index("left_knee")


def slot(*tracks: int, number: int = 3) -> LiveSlot:
    """People of whom joint j is at (track, j / 10, 1) m; the nose is missing."""
    joints_m = np.ones((len(tracks), 17, 3), dtype=np.float32)
    joints_m[..., 0] = np.array(tracks, dtype=np.float32)[:, None]
    joints_m[..., 1] = np.arange(17) / 10
    joints_m[:, 0] = np.nan
    sigma_m = np.full((len(tracks), 17), 0.02, dtype=np.float32)
    measured = np.ones(sigma_m.shape, dtype=bool)
    people = People(np.array(tracks), joints_m, measured=measured, sigma_m=sigma_m)
    return LiveSlot(number, TIME_NS, people, COCO17.joints, ("c0",), ("c0",), TIME_NS)


def tell(stream: Stream) -> None:
    """Tell a stream of a fall."""
    assert isinstance(stream, TellsPeople)
    stream.people(WATCH, [FELL])


def test_osc_is_read_by_python_osc() -> None:
    heard: queue.Queue[tuple[Any, ...]] = queue.Queue()
    dispatcher = Dispatcher()
    dispatcher.set_default_handler(lambda address, *values: heard.put((address, *values)))
    with ThreadingOSCUDPServer(("127.0.0.1", 0), dispatcher) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
        thread.start()
        named = replace(SOURCE, names=lambda track: "Ada")
        stream = open_stream(f"osc://127.0.0.1:{server.server_address[1]}", named)
        stream.slot(slot(7, 9))
        stream.zone(EVENT)
        tell(stream)
        found = [heard.get(timeout=20) for _ in range(1 + 2 * 16 + 2)]
        stream.close()
        server.shutdown()
    said = {address: values for address, *values in found}
    assert said["/e3pose/slot"] == [3, pytest.approx(TIME_NS / 1e9), 2]
    assert said["/e3pose/person/9/left_knee"] == pytest.approx([9, KNEE / 10, 1])
    assert "/e3pose/person/9/nose" not in said
    assert said["/e3pose/zone/door"] == ["enter", 7, 2, 0.0]
    assert said["/e3pose/event/fall"][:4] == ["begun", 7, "bed", pytest.approx(0.9)]
    assert said["/e3pose/event/fall"][4].startswith("Ada fell (bed) at ")


def test_lsl_is_read_by_pylsl() -> None:
    import pylsl

    name = f"e3pose-test-{free_port()}"
    stream = open_stream(f"lsl:{name}", SOURCE)
    inlets = []
    for one in (name, f"{name}-zones", f"{name}-events"):
        (info,) = pylsl.resolve_byprop("name", one, timeout=20)
        inlets.append(pylsl.StreamInlet(info))
        inlets[-1].open_stream(timeout=20)
    full = inlets[0].info()
    assert (full.type(), full.nominal_srate(), full.channel_count()) == ("MoCap", 25, 4 * 69)
    label = full.desc().child("channels").first_child().next_sibling()
    assert label.child_value("label") == "person0_nose_x"
    stream.slot(slot(7, 9))
    stream.slot(slot(9, 11))  # 9 keeps its place, 11 takes that of 7
    stream.zone(EVENT)
    tell(stream)
    samples = [np.array(inlets[0].pull_sample(timeout=20)[0]).reshape(4, 69) for _ in range(2)]
    assert samples[0][:2, 0].tolist() == [7, 9] and np.isnan(samples[0][2:]).all()
    assert samples[1][:2, 0].tolist() == [11, 9]
    knee = samples[0][1, 1:].reshape(17, 4)[KNEE]
    assert knee == pytest.approx([9, KNEE / 10, 1, 0.02])
    assert np.isnan(samples[0][0, 1:4]).all()
    assert inlets[1].pull_sample(timeout=20)[0] == ["enter door 7 2"]
    assert inlets[2].pull_sample(timeout=20)[0] == ["fall begun 7"]
    stream.close()


def test_mcap_on_a_full_disk_says_so_and_leaves_what_it_took(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The library says each message on standard error, and nothing to its caller."""
    path = tmp_path / "today.mcap"
    stream = open_stream(f"mcap:{path}", SOURCE)
    with limit(tmp_path), pytest.raises(OSError, match="File too large"):
        for number in range(20_000):
            stream.slot(slot(7, number=number))
    with pytest.raises(OSError, match="File too large"):
        stream.slot(slot(7))
    stream.close()
    assert capfd.readouterr() == ("", "")


def test_mcap_is_read_by_mcap(tmp_path: Path) -> None:
    path = tmp_path / "today.mcap"
    stream = open_stream(f"mcap:{path}", SOURCE)
    stream.slot(slot(7))
    stream.zone(EVENT)
    tell(stream)
    stream.close()
    assert path.stat().st_mode & 0o077 == 0
    with path.open("rb") as file:
        found = {c.topic: (s, m) for s, c, m in make_reader(file).iter_messages()}
    assert set(found) == {"/scene", "/poses", "/zones", "/events"}
    schema, scene = found["/scene"]
    assert schema is not None and schema.name == "foxglove.SceneUpdate"
    assert scene.log_time == TIME_NS and b"track 7" in scene.data
    said = json.loads(found["/poses"][1].data)
    assert said["selected"] == ["c0"] and said["titles"] == {"c0": "Küche"}
    person = said["people"][0]
    assert person["track"] == 7 and person["joints"]["left_knee"] == [7, KNEE / 10, 1]
    assert "nose" not in person["joints"]
    assert json.loads(found["/zones"][1].data)["event"] == "enter"
    told = json.loads(found["/events"][1].data)
    assert told == event_words(FELL) and told["kind"] == "fall" and told["start_ns"] < TIME_NS
    with pytest.raises(InputError, match="a file that is there"):
        open_stream(f"mcap:{path}", SOURCE)


def test_mqtt_is_read_by_paho() -> None:
    with broker() as port, listening(port) as (_, heard):
        named = replace(SOURCE, names=lambda track: "Ada")
        stream = open_stream(f"mqtt://127.0.0.1:{port}", named)
        stream.slot(slot(7))
        stream.zone(EVENT)
        tell(stream)
        found = dict(heard.get(timeout=20) for _ in range(4))
        stream.close()
    said = json.loads(found["e3pose/lab/poses"])
    assert said["people"][0]["track"] == 7 and said["titles"] == {"c0": "Küche"}
    assert json.loads(found["e3pose/lab/zone/door"])["event"] == "enter"
    assert found["e3pose/lab/zone/door/count"] == "2"
    said = json.loads(found["e3pose/lab/event/fall"])
    assert said == event_words(FELL, lambda track: "Ada") and said["name"] == "Ada"


@each_case(
    ("target", "reported"),
    [
        ("smoke://x", "target: found 'smoke://x', expected osc"),
        ("osc", "target: found 'osc'"),
        ("osc://127.0.0.1:port", "HOST:PORT, such as 127.0.0.1:9000"),
        ("mcap:today.bag", r"mcap:FILE\.mcap in a folder that exists"),
        ("mqtt://127.0.0.1:1", "a broker that runs"),
    ],
)
def test_target_that_is_none_is_refused(target: str, reported: str) -> None:
    with pytest.raises(InputError, match=reported):
        open_stream(target, SOURCE)


class Kept:
    """A stream into lists."""

    def __init__(self) -> None:
        self.slots: list[int] = []
        self.zones: list[str] = []
        self.fails = False

    def slot(self, slot: LiveSlot) -> None:
        if self.fails:
            raise RuntimeError("the other side is gone")
        self.slots.append(slot.slot)

    def zone(self, event: ZoneEvent) -> None:
        self.zones.append(event.kind)

    def close(self) -> None:
        pass


def _published(one: LiveSlot) -> bytes:
    return encode(Poses(one.slot, one.time_ns, one.joints, *packed_people(one.people)))


@pytest.fixture
def sending() -> Callable[[Kept], tuple[Hub, Sender]]:
    def start(kept: Kept) -> tuple[Hub, Sender]:
        from e3pose.settings.site_file import ZoneTable

        hub = Hub()
        zone = ZoneTable("door", ((6.0, 0.0), (8.0, 0.0), (8.0, 2.0), (6.0, 2.0)))
        connection = Connection("lab", hub.join(), wait_s=0.05)
        return hub, Sender(connection, [kept], Zones((zone,)))

    return start


def test_slots_and_zone_events_go_to_every_stream_also_after_a_silence(
    sending: Callable[[Kept], tuple[Hub, Sender]],
) -> None:
    kept = Kept()
    hub, sender = sending(kept)
    reported: list[str] = []
    sender.report = reported.append
    edge = hub.join()
    with sender:
        for number in (3, 4):
            edge.publish("e3pose/lab/poses", _published(slot(7, number=number)))
            assert eventually(lambda number=number: kept.slots[-1:] == [number])  # type: ignore[misc]
            assert eventually(lambda number=number: len(reported) == number - 2)  # type: ignore[misc]
    assert "no slot for 0.05 s" in reported[0]
    assert kept.zones == ["enter"] and sender.sent == 2 and not sender.running()


def test_stream_that_fails_ends_the_program(
    sending: Callable[[Kept], tuple[Hub, Sender]],
) -> None:
    kept = Kept()
    kept.fails = True
    hub, sender = sending(kept)
    with sender:
        hub.join().publish("e3pose/lab/poses", _published(slot(7)))
        assert eventually(lambda: not sender.running())
    assert isinstance(sender.failure, RuntimeError)
