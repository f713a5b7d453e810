"""Home Assistant over a broker with TLS, otherwise as `homeassistant`."""

from __future__ import annotations

import ssl

from e3pose.site.streams.base import Source
from e3pose.site.streams.homeassistant import HomeAssistantStream, opened
from e3pose.site.streams.mqtts import PORT


def open_stream(place: str, source: Source) -> HomeAssistantStream:
    """Return a stream to the broker at `HOST:PORT` over TLS; see `mqtts`."""
    return opened(place, source, PORT, ssl.create_default_context())
