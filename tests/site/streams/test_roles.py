"""What a client of the broker learns, and that it changes nothing."""

from __future__ import annotations

import json
import queue
from collections import Counter
from dataclasses import replace

from tests.site.streams.broker import broker, listening
from tests.site.streams.test_streams import EVENT, FELL, OF_AN_EVENT, SOURCE, WATCH, slot

from e3pose.site.streams import open_stream
from e3pose.site.streams.base import TellsPeople
from e3pose.site.streams.homeassistant import BIRTH

HOME = replace(SOURCE, kinds=("fall",), zones=("door",), cameras=("cam0",))


def until(heard: queue.Queue[tuple[str, str]], topic: str) -> list[tuple[str, str]]:
    """Return what is heard up to a message of a topic."""
    found = list[tuple[str, str]]()
    while not found or found[-1][0] != topic:
        found.append(heard.get(timeout=20))
    return found


def test_a_client_of_the_broker_learns_states_and_events_and_no_pose() -> None:
    with broker() as port, listening(port) as (_, heard):
        stream = open_stream(f"homeassistant://127.0.0.1:{port}", HOME)
        assert isinstance(stream, TellsPeople)
        stream.slot(slot(7))
        stream.zone(EVENT)
        stream.people(WATCH, [FELL])
        said = dict(until(heard, "e3pose/lab/home/alarm"))
        stream.close()
    said.pop("homeassistant/device/e3pose_lab/config")
    assert set(said) == {
        f"e3pose/lab/home/{topic}" for topic in ("online", "state", "alarm", "told", "trigger/fall")
    }
    assert set(json.loads(said["e3pose/lab/home/told"])) == OF_AN_EVENT
    state = json.loads(said["e3pose/lab/home/state"])
    assert set(state) == {"people", "states", "zones", "cameras"}
    assert all(isinstance(count, int) for count in state["states"].values())


def test_a_client_of_the_broker_changes_nothing_and_cannot_hurry_it() -> None:
    with broker() as port, listening(port) as (client, heard):
        stream = open_stream(f"homeassistant://127.0.0.1:{port}", HOME)
        assert isinstance(stream, TellsPeople)
        stream.people(WATCH, [FELL])
        first = until(heard, "e3pose/lab/home/alarm")
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
