"""Home Assistant's discovery: what its documentation asks of each component, and nothing more."""

from __future__ import annotations

import json
import queue
from collections import Counter
from dataclasses import replace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from tests.events.bodies import doing, seen
from tests.site.streams.broker import broker, listening
from tests.site.streams.test_streams import EVENT, FELL, OF_AN_EVENT, TIME_NS, WATCH, slot

from e3pose.events.rules import RULES
from e3pose.events.watch import advance, begin_watch
from e3pose.model.skeleton import COCO17
from e3pose.settings.events_table import EventsTable
from e3pose.site.streams import Source, open_stream
from e3pose.site.streams.base import TellsCameras, TellsPeople
from e3pose.site.streams.homeassistant import (
    BIRTH,
    HURRY_S,
    HomeAssistantStream,
    discovery,
    identifiers,
)
from e3pose.wire.site_messages import CameraStatus, Status

SOURCE = Source("lab", COCO17, 12.5, cameras=("c0", "hall 2"), zones=("door",), kinds=tuple(RULES))
# https://www.home-assistant.io/integrations/mqtt/, sensor.mqtt/, binary_sensor.mqtt/ and
# device_trigger.mqtt/: required keys, and those that we use of the optional ones.
REQUIRED = {
    "sensor": {"platform", "unique_id", "state_topic"},
    "binary_sensor": {"platform", "unique_id", "state_topic"},
    "device_automation": {"platform", "automation_type", "topic", "type", "subtype"},
}
OPTIONAL = {
    "sensor": {
        "name", "value_template", "state_class", "unit_of_measurement", "icon",
        "json_attributes_topic", "device_class", "options", "entity_category",
    },
    "binary_sensor": {"name", "value_template", "device_class", "entity_category"},
    "device_automation": {"payload", "qos", "value_template"},
}  # fmt: skip
CLASSES = {
    "binary_sensor": {"occupancy", "running", "safety", "problem"},
    "sensor": {"battery", "enum"},
}


def test_every_component_is_as_documented() -> None:
    topic, message = discovery(
        replace(SOURCE, titles={"c0": "Küche"}), frozenset({("c0", "battery")})
    )
    assert topic == "homeassistant/device/e3pose_lab/config"
    assert set(message) == {"device", "origin", "availability_topic", "components"}
    assert message["device"]["identifiers"] and message["origin"]["name"]
    ids = [c["unique_id"] for c in message["components"].values() if "unique_id" in c]
    assert len(ids) == len(set(ids))
    for component in message["components"].values():
        kind = component["platform"]
        assert REQUIRED[kind] <= set(component) <= REQUIRED[kind] | OPTIONAL[kind]
        assert component.get("device_class") in {None, *CLASSES.get(kind, ())}
    names = {key: part.get("name") for key, part in message["components"].items()}
    assert (names["camera_c0"], names["battery_c0"]) == ("Camera Küche", "Battery of Küche")
    assert {"zone_door", "occupied_door", "camera_hall_2"} <= set(message["components"])


def test_names_that_differ_in_marks_alone_stay_two() -> None:
    source = replace(SOURCE, zones=("bed.1", "bed_1", "door 1"))
    zones = [key for key in discovery(source)[1]["components"] if key.startswith("zone_")]
    assert len(zones) == 3 and {"zone_bed_1", "zone_door_1"} < set(zones)
    assert len(set(identifiers(["a b", "a.b", "a/b"]).values())) == 3


@pytest.fixture
def client() -> MagicMock:
    return MagicMock()


def retained(client: MagicMock) -> dict[str, Any]:
    """Return the last message of each topic."""
    return {call.args[0]: call.args[1] for call in client.publish.call_args_list}


def starts(client: MagicMock, stream: HomeAssistantStream) -> None:
    """Let Home Assistant say that it has started, a while later."""
    stream._announced_s -= HURRY_S
    client.on_message(client, None, MagicMock(payload=b"online"))


def test_a_fall_goes_on_until_the_person_is_up(client: MagicMock) -> None:
    stream = HomeAssistantStream(client, SOURCE)
    assert isinstance(stream, TellsPeople)
    watch = begin_watch(EventsTable(), COCO17.joints)
    alarms, people = [], set[int]()
    for each in seen(doing("fall-forward", 0)):
        watch, events = advance(watch, each)
        stream.people(watch, events)
        said = retained(client)
        alarms.append(json.loads(said["e3pose/lab/home/alarm"])["fall"])
        people.add(json.loads(said["e3pose/lab/home/state"])["people"])
    assert people == {1}
    assert np.diff(np.array(alarms, dtype=int)).nonzero()[0].size == 2, "on, and off again"
    told = json.loads(retained(client)["e3pose/lab/home/trigger/fall"])
    assert told["kind"] == "fall" and "Person 1 fell" in told["sentence"]


def test_counts_of_zones_and_cameras_are_told(client: MagicMock) -> None:
    stream = HomeAssistantStream(client, SOURCE)
    watch = replace(begin_watch(EventsTable(), COCO17.joints), time_ns=TIME_NS)
    stream.slot(slot(7))
    stream.zone(EVENT)
    stream.people(watch, [])
    state = json.loads(retained(client)["e3pose/lab/home/state"])
    assert state["zones"] == [EVENT.count] and state["cameras"] == [True, False]


def test_cameras_sleep_and_a_battery_is_announced_once_it_is_known(client: MagicMock) -> None:
    stream = HomeAssistantStream(client, SOURCE)
    assert isinstance(stream, TellsCameras)
    config = "homeassistant/device/e3pose_lab/config"

    def told(*cameras: CameraStatus) -> list[dict[str, Any]]:
        stream.cameras(Status("lab", 1, 12.5, 1, 1, cameras))
        return list(json.loads(retained(client)["e3pose/lab/home/cameras"]))

    away = {"does": "away", "battery": None}
    assert told(CameraStatus("c0", True)) == [{"does": "awake", "battery": None}, away]
    assert "battery_c0" not in json.loads(retained(client)[config])["components"]
    asleep = CameraStatus("c0", False, asleep_s=3.0, battery=0.414)
    assert told(asleep, CameraStatus("hall 2", True, paused=True)) == [
        {"does": "asleep", "battery": 41},
        {"does": "paused", "battery": None},
    ]
    parts = json.loads(retained(client)[config])["components"]
    assert parts["battery_c0"]["unit_of_measurement"] == "%" and "battery_hall_2" not in parts
    assert set(parts["does_c0"]["options"]) >= {"awake", "asleep", "paused", "away"}


def test_it_says_again_what_there_is_when_home_assistant_starts(client: MagicMock) -> None:
    starts(client, HomeAssistantStream(client, SOURCE))
    assert client.publish.call_count == 2 * 2


def test_a_name_is_told_as_it_is_now_and_no_broker_keeps_it(client: MagicMock) -> None:
    known = {7: "Ada"}
    stream = HomeAssistantStream(client, replace(SOURCE, names=lambda track: known.get(track, "")))
    topic = "e3pose/lab/home/told"
    watch = replace(begin_watch(EventsTable(), COCO17.joints), time_ns=TIME_NS)
    stream.people(watch, [FELL])
    assert json.loads(retained(client)[topic])["sentence"].startswith("Ada fell")
    named = [call for call in client.publish.call_args_list if "Ada" in str(call)]
    assert len(named) == 2 and not any(call.kwargs.get("retain") for call in named)
    for name, said in (("Ada L.", "Ada L. fell"), ("", "Person 7 fell")):
        known[7] = name
        watch = replace(watch, time_ns=watch.time_ns + 2 * 10**9)
        stream.people(watch, [])
        assert json.loads(retained(client)[topic])["sentence"].startswith(said)
    client.publish.reset_mock()
    starts(client, stream)
    assert topic in retained(client)
    assert not any("Ada" in str(call) for call in client.publish.call_args_list)


def until(heard: queue.Queue[tuple[str, str]], topic: str) -> list[tuple[str, str]]:
    """Return what is heard up to a message of a topic."""
    found = list[tuple[str, str]]()
    while not found or found[-1][0] != topic:
        found.append(heard.get(timeout=20))
    return found


def test_a_client_of_the_broker_learns_no_pose_and_changes_nothing() -> None:
    with broker() as port, listening(port) as (client, heard):
        home = replace(SOURCE, cameras=("cam0",), kinds=("fall",))
        stream = open_stream(f"homeassistant://127.0.0.1:{port}", home)
        assert isinstance(stream, TellsPeople)
        stream.slot(slot(7))
        stream.zone(EVENT)
        stream.people(WATCH, [FELL])
        first = until(heard, "e3pose/lab/home/alarm")
        learnt = {topic.removeprefix("e3pose/lab/home/"): text for topic, text in first}
        told = {"online", "state", "alarm", "told", "trigger/fall"}  # and of no pose
        assert set(learnt) == told | {"homeassistant/device/e3pose_lab/config"}
        assert set(json.loads(learnt["told"])) == OF_AN_EVENT
        state = json.loads(learnt["state"])
        assert set(state) == {"people", "states", "zones", "cameras"}
        assert all(isinstance(count, int) for count in state["states"].values())
        for said in (b"online", b"\xff\x00" * 1000, b"offline", b"online"):
            for _ in range(50):
                client.publish(BIRTH, said, qos=1)
        for topic, _ in first:
            client.publish(topic, "forged", qos=1)
        client.publish("e3pose/lab/home/end", "", qos=1)
        late = Counter(topic for topic, _ in until(heard, "e3pose/lab/home/end"))
        assert late["homeassistant/device/e3pose_lab/config"] <= 1 + 1, "the forged one, and one"
        stream.people(replace(WATCH, time_ns=2 * 10**9), [replace(FELL, track=8)])
        again = dict(until(heard, "e3pose/lab/home/told"))
        assert json.loads(again["e3pose/lab/home/told"])["track"] == 8, "it goes on"
        stream.close()
