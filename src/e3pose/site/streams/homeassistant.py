"""Home Assistant by MQTT discovery: counts, states and events of people. Poses never leave.

homeassistant/device/e3pose_SITE/config  what there is, retained: one device with its components
e3pose/SITE/home/online                  `online` or `offline`, retained; the broker says the latter
e3pose/SITE/home/state                   people, people by state and by zone, cameras: retained
e3pose/SITE/home/cameras                 what each camera does, and its `SENSORS`, retained
e3pose/SITE/home/alarm                   `on` for each kind of event that goes on, retained
e3pose/SITE/home/told                    the last event: its sentence, kind, zone, score; retained
                                         unless names are told, which no broker is to keep
e3pose/SITE/home/trigger/KIND            an event, for device triggers

The format of the first is Home Assistant's, of 2024.11 or later:
https://www.home-assistant.io/integrations/mqtt/#device-discovery-payload
"""

from __future__ import annotations

import json
import re
import ssl
import time
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import paho.mqtt.client as mqtt

from e3pose import __version__
from e3pose.events.people import heirs_in
from e3pose.events.states import STATES
from e3pose.events.watch import Watch
from e3pose.model.person_event import PersonEvent
from e3pose.model.zone_event import ZoneEvent
from e3pose.site.connect import LiveSlot, no_name
from e3pose.site.streams.as_json import event_words
from e3pose.site.streams.base import Source
from e3pose.site.streams.mqtt import PORT, SECURE_PORT, broker_problem, connected_client, tell
from e3pose.wire.messages import fields
from e3pose.wire.site_messages import CameraStatus, Status

EVERY_S = 1.0  # states are sent at most so often
SILENT_S = 30.0  # a camera that sends nothing for longer rests
HURRY_S = 2.0  # between two announcements that somebody asked for
BIRTH = "homeassistant/status"  # where Home Assistant says that it has started
PAGE = "https://github.com/e3pose/e3pose"
# What a kind of event is called, and its class of `binary_sensor` while it goes on.
ALARMS = {
    "fall": ("Fall", "safety"), "on-floor": ("On the floor", "safety"),
    "nobody": ("Nobody seen", None), "too-many": ("Too many people", "problem"),
}  # fmt: skip
DOES = ("awake", "asleep", "paused", "away")  # of a camera; away: it is not heard
# Of a camera's status: title before its name, and keys of discovery.
SENSORS = {field.name: field.uses.home for field in fields(CameraStatus) if field.uses.home}
FALL_ENDS = "got-up"  # a fall is told once; its alarm goes off with this


def open_stream(place: str, source: Source) -> HomeAssistantStream:
    """Return a stream to the broker at `HOST:PORT` in plain text."""
    return _opened(place, source, PORT, None)


def open_secure_stream(place: str, source: Source) -> HomeAssistantStream:
    """Return a stream to the broker at `HOST:PORT` over TLS; see `mqtt.open_secure_stream`."""
    return _opened(place, source, SECURE_PORT, ssl.create_default_context())


def _opened(
    place: str, source: Source, usual_port: int, secure: ssl.SSLContext | None
) -> HomeAssistantStream:
    """Return a stream to a connected broker; see `mqtt.connected_client`."""
    online = f"{prefix(source.site)}/online"
    client = connected_client(place, usual_port, secure, (online, "offline"))
    return HomeAssistantStream(client, source)


def prefix(site: str) -> str:
    """Return where all topics of a site begin, but that of its discovery."""
    return f"e3pose/{site}/home"


def identifier(text: str) -> str:
    """Return a text as Home Assistant takes it in an id."""
    return re.sub(r"[^a-zA-Z0-9_-]", "_", text)


def identifiers(names: Sequence[str]) -> dict[str, str]:
    """Return an id of its own for each name: `bed.1` beside `bed_1` ends in its checksum."""
    plain = {name: identifier(name) for name in names}
    taken = {*names}
    return {
        name: f"{key}_{zlib.crc32(name.encode()):08x}"
        if name != key and (key in taken or [*plain.values()].count(key) > 1)
        else key
        for name, key in plain.items()
    }


def does(camera: CameraStatus) -> str:
    """Return the activity of a camera, one of `DOES`."""
    if camera.paused:
        return "paused"
    if camera.asleep_s is not None:
        return "asleep"
    return "awake" if camera.online else "away"


def sensors(camera: CameraStatus) -> dict[str, float | None]:
    """Return a camera's value for each of `SENSORS`, in Home Assistant's unit."""
    values: dict[str, float | None] = {name: getattr(camera, name) for name in SENSORS}
    for name, (_, keys) in SENSORS.items():
        share = values[name]
        if share is not None and keys.get("unit_of_measurement") == "%":
            values[name] = round(100 * share)
    return values


def discovery(
    source: Source, told: frozenset[tuple[str, str]] = frozenset()
) -> tuple[str, dict[str, Any]]:
    """Return topic and message of Home Assistant's discovery of a site.

    Args:
        source: the site.
        told: camera and field of each of `SENSORS` that was known once.
    """
    node, base = f"e3pose_{identifier(source.site)}", prefix(source.site)
    parts: dict[str, dict[str, Any]] = {}

    def add(key: str, platform: str, name: str, value: str, **more: Any) -> None:
        parts[key] = {
            "platform": platform, "name": name, "unique_id": f"{node}_{key}",
            "state_topic": f"{base}/state", "value_template": f"{{{{ {value} }}}}",
            **{word: of for word, of in more.items() if of is not None},
        }  # fmt: skip

    counted = {"state_class": "measurement", "unit_of_measurement": "people"}
    add("people", "sensor", "People", "value_json.people", icon="mdi:account-group", **counted)
    for state in STATES:
        add(f"state_{state}", "sensor", f"People {state}", f"value_json.states.{state}", **counted)
    zone_ids, camera_ids = identifiers(source.zones), identifiers(source.cameras)
    for index, zone in enumerate(source.zones):
        value = f"value_json.zones[{index}]"
        add(f"zone_{zone_ids[zone]}", "sensor", f"People in {zone}", value, **counted)
        add(
            f"occupied_{zone_ids[zone]}", "binary_sensor", f"{zone} occupied",
            f"'ON' if {value} > 0 else 'OFF'", device_class="occupancy",
        )  # fmt: skip
    for index, camera in enumerate(source.cameras):
        value = f"'ON' if value_json.cameras[{index}] else 'OFF'"
        name = source.titles.get(camera, camera)
        add(
            f"camera_{camera_ids[camera]}", "binary_sensor", f"Camera {name}", value,
            device_class="running", entity_category="diagnostic",
        )  # fmt: skip
        add(
            f"does_{camera_ids[camera]}", "sensor", f"Camera {name} does",
            f"value_json[{index}].does", device_class="enum", options=list(DOES),
            entity_category="diagnostic", state_topic=f"{base}/cameras",
        )  # fmt: skip
        for field, (title, keys) in SENSORS.items():
            if (camera, field) in told:
                add(
                    f"{field}_{camera_ids[camera]}", "sensor", f"{title} {name}",
                    f"value_json[{index}].{field}", state_class="measurement",
                    entity_category="diagnostic", state_topic=f"{base}/cameras", **keys,
                )  # fmt: skip
    for kind in source.kinds:
        key = identifier(kind)
        if kind in ALARMS:
            name, device_class = ALARMS[kind]
            value = f"'ON' if value_json['{kind}'] else 'OFF'"
            add(f"alarm_{key}", "binary_sensor", name, value, device_class=device_class)
            parts[f"alarm_{key}"]["state_topic"] = f"{base}/alarm"
        parts[f"trigger_{key}"] = {
            "platform": "device_automation", "automation_type": "trigger", "type": "event",
            "subtype": kind, "topic": f"{base}/trigger/{key}",
        }  # fmt: skip
    add("told", "sensor", "Last event", "value_json.sentence[:255]", icon="mdi:bell")
    parts["told"] |= {"state_topic": f"{base}/told", "json_attributes_topic": f"{base}/told"}
    message = {
        "device": {
            "identifiers": [node], "name": f"e3pose {source.site}", "manufacturer": "e3pose",
            "model": "site of cameras", "sw_version": __version__,
        },
        "origin": {"name": "e3pose", "sw_version": __version__, "support_url": PAGE},
        "availability_topic": f"{base}/online",
        "components": parts,
    }  # fmt: skip
    return f"homeassistant/device/{node}/config", message


class HomeAssistantStream:
    """See `Stream`, `TellsPeople` and `TellsCameras`."""

    def __init__(self, client: mqtt.Client, source: Source) -> None:
        """Announce a site through a client that is connected."""
        self._client, self._source = client, source
        self._base = prefix(source.site)
        self._sent: dict[str, str] = {}
        self._last: PersonEvent | None = None
        self._sent_ns = -(10**18)
        self._zones = dict.fromkeys(source.zones, 0)
        self._arrived_ns = dict.fromkeys(source.cameras, 0)
        self._alarms = {kind: set[int]() for kind in source.kinds if kind in ALARMS}
        self._told = frozenset[tuple[str, str]]()
        self._announced_s = time.monotonic()
        client.on_message = lambda _client, _data, message: self._hear(bytes(message.payload))
        client.on_connect = lambda *_: self._announce()  # again: the broker knows nothing of us
        self._lost = 0
        self._announce()

    def _hear(self, said: bytes) -> None:
        """Announce again when Home Assistant starts, at a limited rate."""
        now_s = time.monotonic()
        if said == b"online" and now_s - self._announced_s >= HURRY_S:
            self._announced_s = now_s
            self._announce()

    def _announce(self) -> None:
        """Publish discovery and availability; again when Home Assistant or the broker starts."""
        self._client.subscribe(BIRTH, qos=1)
        topic, message = discovery(self._source, self._told)
        self._client.publish(topic, json.dumps(message), qos=1, retain=True)
        self._client.publish(f"{self._base}/online", "online", qos=1, retain=True)
        for topic, text in self._sent.copy().items():
            self._publish(topic, text)

    def _retain(self, topic: str, value: Mapping[str, Any] | Sequence[Any]) -> None:
        """Send a state that changed."""
        topic, text = f"{self._base}/{topic}", json.dumps(value)
        if self._sent.get(topic) != text:
            self._sent[topic] = text
            self._publish(topic, text)

    def _publish(self, topic: str, text: str) -> None:
        named = topic.endswith("/told") and self._source.names is not no_name
        # One that is lost is announced again: in the queue it would take the room of an event.
        self._client.publish(topic, text, qos=0, retain=not named)

    def _tell_last(self) -> dict[str, Any]:
        """Say the last event, with the name that the person has now; return its words."""
        words = {} if self._last is None else event_words(self._last, self._source.names)
        if words:
            self._retain("told", words)
        return words

    @property
    def problem(self) -> str:
        """See `stream_problems`."""
        return broker_problem(self._client, self._lost)

    def slot(self, slot: LiveSlot) -> None:
        """See `Stream.slot`."""
        for camera in slot.arrived:
            self._arrived_ns[camera] = slot.time_ns

    def zone(self, event: ZoneEvent) -> None:
        """See `Stream.zone`."""
        self._zones[event.zone] = event.count

    def cameras(self, status: Status) -> None:
        """See `TellsCameras.cameras`; a sensor that is known for the first time is announced."""
        known = {camera.camera_id: camera for camera in status.cameras}
        told = frozenset(
            (name, field) for name, one in known.items()
            for field, value in sensors(one).items() if value is not None
        )  # fmt: skip
        if not told <= self._told:
            self._told |= told
            self._announce()
        self._retain("cameras", [
            {"does": does(known[name]), **sensors(known[name])}
            if name in known else {"does": "away", **dict.fromkeys(SENSORS)}
            for name in self._source.cameras
        ])  # fmt: skip

    def people(self, watch: Watch, events: Sequence[PersonEvent]) -> None:
        """See `TellsPeople.people`."""
        for tracks in self._alarms.values():
            for track, before in heirs_in(watch.shown).items():
                if before in tracks:
                    tracks.symmetric_difference_update({before, track})
        for event in events:
            self._tell(event)
        now_ns = watch.time_ns
        if now_ns - self._sent_ns >= EVERY_S * 1e9 or events:
            self._sent_ns = now_ns
            does = Counter(STATES[int(p.states.argmax())] for p in watch.shown.values())
            self._retain("state", {
                "people": len(watch.shown),
                "states": {state: does[state] for state in STATES},
                "zones": [self._zones[zone] for zone in self._source.zones],
                "cameras": [
                    now_ns - self._arrived_ns[camera] < SILENT_S * 1e9
                    for camera in self._source.cameras
                ],
            })  # fmt: skip
            self._retain("alarm", {kind: bool(tracks) for kind, tracks in self._alarms.items()})
            self._tell_last()

    def _tell(self, event: PersonEvent) -> None:
        """Tell an event: as the last one, by its trigger, and by its alarm while it goes on."""
        if event.kind in self._alarms:
            change = set.add if event.phase == "begun" else set.discard
            change(self._alarms[event.kind], event.track)
        if event.kind == FALL_ENDS and "fall" in self._alarms:
            self._alarms["fall"].discard(event.track)
        self._last = event
        words = self._tell_last()
        if event.is_news:
            key = identifier(event.kind)
            self._lost += tell(self._client, f"{self._base}/trigger/{key}", json.dumps(words))

    def close(self) -> None:
        """See `Stream.close`."""
        self._client.publish(f"{self._base}/online", "offline", qos=1, retain=True)
        self._client.disconnect()
        self._client.loop_stop()
