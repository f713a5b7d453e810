"""MQTT: poses and zone events as JSON, counts of zones as retained numbers.

e3pose/SITE/poses            a slot
e3pose/SITE/zone/NAME        an event
e3pose/SITE/zone/NAME/count  people in it, retained
e3pose/SITE/event/KIND       an event of a person

The user and the password of a broker come from the environment or a file: on a command line every
user of the machine could read them.
"""

from __future__ import annotations

import json
import os
import queue
import ssl
from collections.abc import Mapping, Sequence
from pathlib import Path

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.reasoncodes import ReasonCode

from e3pose.base.errors import InputError
from e3pose.base.private import read_secret
from e3pose.base.quantities import plural
from e3pose.events.watch import Watch
from e3pose.model.person_event import PersonEvent
from e3pose.model.zone_event import ZoneEvent
from e3pose.site.connect import LiveSlot
from e3pose.site.streams.as_json import event_words, slot_words, zone_words
from e3pose.site.streams.base import Source, Unavailable, host_port
from e3pose.wire.endpoint import is_loopback

PORT, SECURE_PORT = 1883, 8883
MAX_WAITING = 50
ANSWER_S = 10.0
USER, PASSWORD = "E3POSE_MQTT_USER", "E3POSE_MQTT_PASSWORD"


def open_stream(place: str, source: Source) -> MqttStream:
    """Return a stream to the broker at `HOST:PORT` in plain text; see `connected_client`."""
    return MqttStream(connected_client(place, PORT, None), source)


def open_secure_stream(place: str, source: Source) -> MqttStream:
    """Return a stream to the broker at `HOST:PORT` over TLS.

    Its certificate is checked against those that the system trusts, or those of `SSL_CERT_FILE`.
    """
    secure = ssl.create_default_context()
    return MqttStream(connected_client(place, SECURE_PORT, secure), source)


def connected_client(
    place: str, usual_port: int, secure: ssl.SSLContext | None, will: tuple[str, str] | None = None
) -> mqtt.Client:
    """Return a client that a broker has accepted.

    Args:
        place: `HOST[:PORT]`.
        usual_port: where none is named.
        secure: how the broker proves who it is; None for plain text.
        will: topic and retained message that the broker sends when we are gone.

    Raises:
        Unavailable: when there is no broker, it is not who it should be or refuses us.
        InputError: when a password would cross a network in plain text.
    """
    if "@" in place:
        raise InputError("target", "a user or password in it", f"them in {USER} and {PASSWORD}")
    host, port = host_port(place, usual_port)
    where, answered = f"{host}:{port}", queue.SimpleQueue[ReasonCode]()
    client = mqtt.Client(CallbackAPIVersion.VERSION2)
    client.max_queued_messages_set(MAX_WAITING)
    client.on_connect = lambda _client, _data, _flags, reason, _more: answered.put(reason)
    if will is not None:
        client.will_set(*will, qos=1, retain=True)
    user, password = login(os.environ)
    if user is not None:
        if secure is None and not is_loopback(host):
            raise InputError(
                "target", f"{where}, to which {PASSWORD} would go unencrypted", "mqtts://"
            )
        client.username_pw_set(user, password)
    if secure is not None:
        client.tls_set_context(secure)
    try:
        client.connect(host, port)
    except OSError as error:
        raise Unavailable("target", f"{where} ({error})", "a broker that runs") from None
    client.loop_start()  # which connects again
    try:
        reason = answered.get(timeout=ANSWER_S)
        refused = str(reason) if reason.is_failure else ""
    except queue.Empty:
        refused = "no answer"
    if refused:
        client.disconnect()
        client.loop_stop()
        wanted = f"a broker that accepts us; its user and password go into {USER} and {PASSWORD}"
        raise Unavailable("target", f"{where} ({refused})", wanted)
    return client


def tell(client: mqtt.Client, topic: str, text: str) -> bool:
    """Publish an event; return whether it is lost, as `MAX_WAITING` wait for the broker."""
    return bool(client.publish(topic, text, qos=1).rc == mqtt.MQTT_ERR_QUEUE_SIZE)


def broker_problem(client: mqtt.Client, lost: int) -> str:
    """Return that a broker is away and how many events are lost, in words; empty for neither."""
    problem = "" if client.is_connected() else " is away"
    problem += f": {plural(lost, 'event')} lost" * (lost > 0)
    return f"broker {client.host}:{client.port}{problem}" * bool(problem)


def login(environment: Mapping[str, str]) -> tuple[str | None, str | None]:
    """Return user and password of a broker, None where none is set.

    Raises:
        InputError: when others can read the file of the password, or nobody.
    """
    user, file = environment.get(USER), environment.get(f"{PASSWORD}_FILE")
    if file is None:
        return user, environment.get(PASSWORD)
    return user, read_secret(Path(file), f"{PASSWORD}_FILE")


class MqttStream:
    """See `Stream`.

    While the broker is away events of people wait, and nothing else: other messages would take
    their room.
    """

    def __init__(self, client: mqtt.Client, source: Source) -> None:
        """Publish with a client that is connected."""
        self._client, self._prefix, self._names = client, f"e3pose/{source.site}", source.names
        self._titles = source.titles
        self._counts, self._lost = dict[str, int](), 0
        client.on_connect = lambda *_: self._count()

    @property
    def problem(self) -> str:
        """See `stream_problems`."""
        return broker_problem(self._client, self._lost)

    def slot(self, slot: LiveSlot) -> None:
        """See `Stream.slot`."""
        self._client.publish(f"{self._prefix}/poses", json.dumps(slot_words(slot, self._titles)))

    def zone(self, event: ZoneEvent) -> None:
        """See `Stream.zone`."""
        self._counts[event.zone] = event.count
        if self._client.is_connected():
            topic = f"{self._prefix}/zone/{event.zone}"
            self._client.publish(topic, json.dumps(zone_words(event)), qos=1)
            self._count(event.zone)

    def _count(self, *zones: str) -> None:
        """Publish how many people are in zones, or in all when the broker is there again."""
        for zone, count in self._counts.copy().items():
            if zone in (zones or self._counts):
                topic = f"{self._prefix}/zone/{zone}/count"
                self._client.publish(topic, str(count), qos=1, retain=True)

    def people(self, watch: Watch, events: Sequence[PersonEvent]) -> None:
        """See `TellsPeople.people`."""
        for event in events:
            topic = f"{self._prefix}/event/{event.kind}"
            self._lost += tell(self._client, topic, json.dumps(event_words(event, self._names)))

    def close(self) -> None:
        """See `Stream.close`."""
        self._client.disconnect()
        self._client.loop_stop()
