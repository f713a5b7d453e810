"""MQTT: poses and zone events as JSON, counts of zones as retained numbers.

e3pose/SITE/poses            a slot
e3pose/SITE/zone/NAME        an event
e3pose/SITE/zone/NAME/count  people in it, retained
"""

from __future__ import annotations

import json

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from e3pose.errors import InputError
from e3pose.exports.streams.base import Source, host_port
from e3pose.exports.streams.words import slot_words, zone_words
from e3pose.model.zone_event import ZoneEvent
from e3pose.site.connect import LiveSlot

PORT = 1883
MAX_WAITING = 50


def open_stream(place: str, source: Source) -> MqttStream:
    """Return a stream to the broker at `HOST:PORT`, in plain text and without a password."""
    host, port = host_port(place, PORT)
    client = mqtt.Client(CallbackAPIVersion.VERSION2)
    client.max_queued_messages_set(MAX_WAITING)
    try:
        client.connect(host, port)
    except OSError as error:
        raise InputError("target", f"{host}:{port} ({error})", "a broker that runs") from None
    client.loop_start()  # which connects again
    return MqttStream(client, source.site)


class MqttStream:
    """See `Stream`."""

    def __init__(self, client: mqtt.Client, site: str) -> None:
        """Publish with a client that is connected."""
        self._client, self._prefix = client, f"e3pose/{site}"

    def slot(self, slot: LiveSlot) -> None:
        """See `Stream.slot`."""
        self._client.publish(f"{self._prefix}/poses", json.dumps(slot_words(slot)))

    def zone(self, event: ZoneEvent) -> None:
        """See `Stream.zone`."""
        topic = f"{self._prefix}/zone/{event.zone}"
        self._client.publish(topic, json.dumps(zone_words(event)), qos=1)
        self._client.publish(f"{topic}/count", str(event.count), qos=1, retain=True)

    def close(self) -> None:
        """See `Stream.close`."""
        self._client.disconnect()
        self._client.loop_stop()
