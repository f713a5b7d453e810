"""Foxglove over WebSocket: skeletons as a 3D scene, poses and events as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from urllib.parse import parse_qsl

import numpy as np
from foxglove.messages import (
    Color,
    Duration,
    LinePrimitive,
    LinePrimitiveLineType,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    TextPrimitive,
    Timestamp,
    Vector3,
)  # fmt: skip
from numpy.typing import NDArray

from e3pose.base.errors import InputError, reason_of
from e3pose.base.listener import Bounds, open_socket
from e3pose.events.watch import Watch
from e3pose.model.person_event import PersonEvent
from e3pose.model.zone_event import ZoneEvent
from e3pose.output.report.scene import NUM_COLOURS
from e3pose.site.connect import LiveSlot
from e3pose.site.serving import Serving
from e3pose.site.streams.as_json import event_words, slot_words, zone_words
from e3pose.site.streams.base import Source, Unavailable, host_port
from e3pose.site.streams.foxglove_server import (
    CLIENTS,
    CLIENTS_OF_ADDRESS,
    Channel,
    FoxgloveServer,
)

PORT = 8765
_SCHEMA = SceneUpdate.get_schema()
CHANNELS = (
    Channel("/scene", "protobuf", _SCHEMA.name, _SCHEMA.data),
    Channel("/poses", "json"),
    Channel("/zones", "json"),
    Channel("/events", "json"),
)
LIFETIME_NS = 500_000_000  # of who is not shown any more
# As the live page draws them.
COLOURS = ("0072b2", "d55e00", "009e73", "cc79a7", "56b4e9", "b38600", "4d4d4d", "8a4b16")


def open_stream(place: str, source: Source) -> FoxgloveStream:
    """Return a stream that Foxglove connects to at `ws://HOST:PORT`, without authentication.

    `?origin=https://...`, any number of times, names web pages beyond this machine that may.
    """
    where, _, query = place.partition("?")
    host, port = host_port(where or f"127.0.0.1:{PORT}", PORT)
    origins = _origins(query)
    try:
        listening = open_socket(host, port)
    except OSError as error:
        raise Unavailable("target", f"{host}:{port} ({reason_of(error)})", "a free port") from None
    server = FoxgloveServer(f"e3pose {source.site}", CHANNELS, origins, source.report)
    serving = Serving(server, listening, Bounds(CLIENTS, CLIENTS_OF_ADDRESS), None)
    return FoxgloveStream(source, server.log, serving.close)


def _origins(query: str) -> frozenset[str]:
    """Return the origins that a target names."""
    named = parse_qsl(query, keep_blank_values=True)
    for key, value in named:
        if key != "origin" or "://" not in value or value.endswith("/"):
            wanted = "origin=https://HOST, as the warning shows"
            raise InputError("target", f"{key}={value}"[:80], wanted)
    return frozenset(value for _, value in named)


class FoxgloveStream:
    """See `Stream`."""

    def __init__(
        self,
        source: Source,
        log: Callable[[str, bytes, int], object],
        close: Callable[[], object],
    ) -> None:
        """Make a stream.

        Args:
            source: what is sent.
            log: takes topic, message and time of `CHANNELS`.
            close: ends it.
        """
        self._limbs, self._log, self._close = source.skeleton.limbs, log, close
        self._names, self._titles = source.names, source.titles

    def slot(self, slot: LiveSlot) -> None:
        """See `Stream.slot`."""
        entities = [
            self._entity(slot.time_ns, int(track), joints_m.astype(np.float64))
            for track, joints_m in zip(slot.people.track_ids, slot.people.joints_m, strict=True)
        ]
        self._log("/scene", SceneUpdate(entities=entities).encode(), slot.time_ns)
        words = slot_words(slot, self._titles)
        self._log("/poses", json.dumps(words).encode(), slot.time_ns)

    def zone(self, event: ZoneEvent) -> None:
        """See `Stream.zone`."""
        self._log("/zones", json.dumps(zone_words(event)).encode(), event.time_ns)

    def people(self, watch: Watch, events: Sequence[PersonEvent]) -> None:
        """See `TellsPeople.people`."""
        for event in events:
            self._log(
                "/events", json.dumps(event_words(event, self._names)).encode(), event.time_ns
            )

    def close(self) -> None:
        """See `Stream.close`."""
        self._close()

    def _entity(self, time_ns: int, track: int, joints_m: NDArray[np.float64]) -> SceneEntity:
        known: NDArray[np.bool_] = np.asarray(np.isfinite(joints_m).all(axis=-1))
        ends = [end for limb in self._limbs if known[list(limb)].all() for end in limb]
        red, green, blue = bytes.fromhex(COLOURS[track % NUM_COLOURS])
        colour = Color(r=red / 255, g=green / 255, b=blue / 255, a=1.0)
        top = joints_m[known][joints_m[known][:, 2].argmax()] if known.any() else np.zeros(3)
        return SceneEntity(
            timestamp=Timestamp(sec=time_ns // 10**9, nsec=time_ns % 10**9),
            frame_id="world",
            id=f"track {track}",
            lifetime=Duration(sec=0, nsec=LIFETIME_NS),
            lines=[
                LinePrimitive(
                    type=LinePrimitiveLineType.LineList,
                    thickness=0.03,
                    color=colour,
                    points=[Point3(x=x, y=y, z=z) for x, y, z in joints_m[ends].tolist()],
                )
            ],
            texts=[
                TextPrimitive(
                    pose=Pose(
                        position=Vector3(x=top[0], y=top[1], z=top[2] + 0.15),
                        orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
                    ),
                    billboard=True,
                    font_size=0.15,
                    color=colour,
                    text=self._names(track) or str(track),
                )
            ],
        )
