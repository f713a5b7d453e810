"""MQTT over TLS, otherwise as `mqtt`."""

from __future__ import annotations

import ssl

from e3pose.site.streams.base import Source
from e3pose.site.streams.mqtt import MqttStream, connected

PORT = 8883


def open_stream(place: str, source: Source) -> MqttStream:
    """Return a stream to the broker at `HOST:PORT` over TLS.

    Its certificate is checked against those that the system trusts, or those of `SSL_CERT_FILE`.
    """
    return connected(place, source, PORT, ssl.create_default_context())
