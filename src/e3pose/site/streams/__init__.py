"""Streams: forward the poses of a running site to other programs.

    poses of a running site -> slots, zone events -> osc | vmc | vrchat | lsl | ...

Adding one is a file, a line in `STREAMS`, an extra, and the contract test.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module

from e3pose.base.errors import InputError
from e3pose.settings.site_file import SiteTable
from e3pose.site.connect import names_for
from e3pose.site.streams.base import Source as Source
from e3pose.site.streams.base import Stream as Stream

# Name to what it is; the module of the name has `open_stream(place, source)`.
STREAMS = {
    "osc": "osc://HOST:PORT, UDP: stage, sound and game engines",
    "vmc": "vmc://HOST:PORT, UDP: avatars, by the Virtual Motion Capture protocol",
    "vrchat": "vrchat://HOST:PORT, UDP: VRChat's OSC trackers",
    "lsl": "lsl:NAME, Lab Streaming Layer: recorded beside EEG, force plates, markers",
    "foxglove": "foxglove://HOST:PORT, a server that Foxglove connects to",
    "mcap": "mcap:FILE.mcap, a recording for Foxglove and ROS tools",
    "mqtt": "mqtt://HOST:PORT, a broker: home automation, dashboards",
    "mqtts": "mqtts://HOST:PORT, a broker over TLS",
    "homeassistant": "homeassistant://HOST:PORT, a broker that Home Assistant listens to: counts, "
    "states and events of people, no poses",
    "homeassistants": "homeassistants://HOST:PORT, the same over TLS",
    "webhook": "webhook:https://HOST/PATH, a signed notice of each event of people, no poses",
}
OVER_TLS = {"mqtts": "mqtt", "homeassistants": "homeassistant"}  # by `open_secure_stream` of these


def naming(source: Source, site: SiteTable, target: str) -> Source:
    """Return a source with the names that a stream may tell; a file keeps none."""
    kind = target.partition(":")[0]
    return replace(source, names=names_for(site, OVER_TLS.get(kind, kind)))


def open_stream(target: str, source: Source) -> Stream:
    """Open a stream.

    Args:
        target: as `STREAMS` says.
        source: what will be sent.

    Raises:
        InputError: for a target that is none, or that cannot be opened.
    """
    kind, colon, place = target.partition(":")
    if kind not in STREAMS or not colon:
        forms = "; ".join(about.partition(",")[0] for about in STREAMS.values())
        raise InputError("target", repr(target[:80]), forms)
    module = import_module(f"e3pose.site.streams.{OVER_TLS.get(kind, kind)}")
    opened: Callable[[str, Source], Stream] = (
        module.open_secure_stream if kind in OVER_TLS else module.open_stream
    )
    return opened(place.removeprefix("//"), source)
