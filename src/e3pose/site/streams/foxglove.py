"""Foxglove over WebSocket: skeletons as a 3D scene, poses and zone events as JSON."""

from __future__ import annotations

import json

import foxglove
import numpy as np
from foxglove.channels import SceneUpdateChannel
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

from e3pose.errors import InputError
from e3pose.model.zone_event import ZoneEvent
from e3pose.report.scene import NUM_COLOURS
from e3pose.site.connect import LiveSlot
from e3pose.site.streams.as_json import slot_words, zone_words
from e3pose.site.streams.base import Source, host_port

PORT = 8765
LIFETIME_NS = 500_000_000  # of who is not shown any more
# As the live page draws them.
COLOURS = ("0072b2", "d55e00", "009e73", "cc79a7", "56b4e9", "b38600", "4d4d4d", "8a4b16")


def open_stream(place: str, source: Source) -> FoxgloveStream:
    """Return a stream that Foxglove connects to at `ws://HOST:PORT`, without authentication."""
    host, port = host_port(place or f"127.0.0.1:{PORT}", PORT)
    context = foxglove.Context()
    try:
        server = foxglove.start_server(
            name=f"e3pose {source.site}", host=host, port=port, context=context
        )
    except (RuntimeError, OSError) as error:
        raise InputError("target", f"{host}:{port} ({error})", "a free port") from None
    stream = FoxgloveStream(context, source)
    stream.close = server.stop  # type: ignore[method-assign]
    return stream


class FoxgloveStream:
    """See `Stream`; logs to whatever sinks the context has."""

    def __init__(self, context: foxglove.Context, source: Source) -> None:
        """Make the channels `/scene`, `/poses` and `/zones`."""
        self._context = context  # its channels close with it
        self._limbs = source.skeleton.limbs
        self._scene = SceneUpdateChannel("/scene", context=context)
        self._poses = foxglove.Channel("/poses", message_encoding="json", context=context)
        self._zones = foxglove.Channel("/zones", message_encoding="json", context=context)

    def slot(self, slot: LiveSlot) -> None:
        """See `Stream.slot`."""
        entities = [
            self._entity(slot.time_ns, int(track), joints_m.astype(np.float64))
            for track, joints_m in zip(slot.track_ids, slot.joints_m, strict=True)
        ]
        self._scene.log(SceneUpdate(entities=entities), log_time=slot.time_ns)
        self._poses.log(json.dumps(slot_words(slot)).encode(), log_time=slot.time_ns)

    def zone(self, event: ZoneEvent) -> None:
        """See `Stream.zone`."""
        self._zones.log(json.dumps(zone_words(event)).encode(), log_time=event.time_ns)

    def close(self) -> None:
        """See `Stream.close`."""

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
                    text=str(track),
                )
            ],
        )
