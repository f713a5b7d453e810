"""One person of a site as an avatar: bones that turn, in the axes of Unity.

Avatars are one person. It is the one who has been there longest, or a named track. Lengths of bones
are those of the last seconds, measured anew once a second; rotations are of the newest slot, and
where it does not tell one, the one before stays. Unity has x right, y up and z ahead, left-handed:
x is turned around.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from urllib.parse import parse_qsl

import numpy as np
from numpy.typing import NDArray
from pythonosc.udp_client import UDPClient

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.people import People
from e3pose.model.skeleton import Skeleton
from e3pose.model.take import Motion, motions_of
from e3pose.model.zone_event import ZoneEvent
from e3pose.output.exports.bones import posed, present, rest_of
from e3pose.site.connect import LiveSlot
from e3pose.site.streams.base import Source, host_port

KEPT_S, MEASURE_S = 4.0, 1.0  # whose lengths are measured, and how often
GONE_S = 1.0  # who is not shown for so long is gone, and another one is sent
MIRROR = np.diag([-1.0, 1.0, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Avatar:
    """A person in one slot, in the axes of Unity.

    Attributes:
        names: of the nodes, as `exports.bones` has them.
        offsets_m: `(num_nodes, 3)` of each node from its parent at rest; the root's is its place.
        local: `(num_nodes, 3, 3)` rotations beside the parents.
        places_m: `(num_nodes, 3)` in the world.
        world: `(num_nodes, 3, 3)` rotations in the world.
    """

    names: tuple[str, ...]
    offsets_m: Floats
    local: Floats
    places_m: Floats
    world: Floats


@dataclass
class Humanoid:
    """Follows one person.

    Attributes:
        skeleton: of the joints.
        fps: slots per second.
        track: whom to send; None for who has been there longest.
    """

    skeleton: Skeleton
    fps: float
    track: int | None = None
    _now: int | None = None
    _seen: int = 0  # the last slot that showed this person
    _recent: deque[Floats] = field(default_factory=deque)
    _rest: tuple[tuple[str, ...], NDArray[np.int64], Floats] | None = None
    _measured_at: int = 0
    _local: Floats = field(default_factory=lambda: np.zeros((0, 3, 3)))

    def of(self, slot: LiveSlot) -> Avatar | None:
        """Return the person in a slot; None without enough joints."""
        joints_m = self._joints_m(slot)
        if joints_m is None:
            return None
        self._recent.append(joints_m)
        while len(self._recent) > KEPT_S * self.fps:
            self._recent.popleft()
        if self._rest is None or slot.slot - self._measured_at >= MEASURE_S * self.fps:
            try:
                rest = rest_of(_motion(np.stack(self._recent)), self.skeleton)
            except InputError:  # no slot with both hips yet
                return None
            if self._rest is None or rest[0] != self._rest[0]:
                self._local = np.tile(np.eye(3), (len(rest[0]), 1, 1))
            self._rest, self._measured_at = rest, slot.slot
        names, parents, offsets = self._rest
        bones = posed(names, parents, offsets, _motion(joints_m[None]), self.skeleton)
        if not present(bones.root_m).all():
            return None
        told = bones.measured[0][:, None, None]
        self._local = np.where(told, bones.rotations[0], self._local)
        return _avatar(names, parents, offsets, bones.root_m[0], self._local)

    def _joints_m(self, slot: LiveSlot) -> Floats | None:
        there = slot.people.track_ids.tolist()
        if self._now not in there:
            gone = self._now is None or slot.slot - self._seen > GONE_S * self.fps
            wanted = self.track if self.track is not None else min(there, default=None)
            if not gone or wanted not in there:
                return None
            self._now, self._rest = (
                wanted,
                None,
            )  # track ids rise: the lowest has been there longest
            self._recent.clear()
        self._seen = slot.slot
        return np.asarray(slot.people.joints_m[there.index(self._now)], dtype=np.float64)


class AvatarStream:
    """Base of the streams that move one avatar; see `Stream`."""

    def __init__(self, place: str, source: Source, port: int) -> None:
        """Send to `HOST:PORT`, received or not; `?track=7` names the person to send."""
        where, _, query = place.partition("?")
        self._humanoid = Humanoid(source.skeleton, source.fps, person_of(query))
        self._client = UDPClient(*host_port(where, port))

    def zone(self, event: ZoneEvent) -> None:
        """See `Stream.zone`; avatars have none."""

    def close(self) -> None:
        """See `Stream.close`."""
        self._client._sock.close()


def person_of(query: str) -> int | None:
    """Return the track that `track=7` names; None where nothing is named.

    Raises:
        InputError: for anything else.
    """
    named = parse_qsl(query, keep_blank_values=True)
    if query and (len(named) != 1 or named[0][0] != "track" or not named[0][1].isdecimal()):
        raise InputError("target", repr(query[:80]), "track=NUMBER, such as ?track=7")
    return int(named[0][1]) if named else None


def quaternion(rotation: Floats) -> list[float]:
    """Return x, y, z, w of a rotation `(3, 3)`."""
    from scipy.spatial.transform import Rotation

    return [float(value) for value in Rotation.from_matrix(rotation).as_quat()]


def euler_deg(rotation: Floats) -> list[float]:
    """Return Unity's angles x, y, z of a rotation `(3, 3)`, applied about z, then x, then y."""
    from scipy.spatial.transform import Rotation

    y, x, z = Rotation.from_matrix(rotation).as_euler("YXZ", degrees=True)
    return [float(x), float(y), float(z)]


def _avatar(
    names: tuple[str, ...],
    parents: NDArray[np.int64],
    offsets: Floats,
    root_m: Floats,
    local: Floats,
) -> Avatar:
    """Return the nodes with x turned around."""
    local = MIRROR @ local @ MIRROR
    offsets_m = offsets @ MIRROR
    offsets_m[0] = root_m @ MIRROR
    places_m, world = offsets_m.copy(), local.copy()
    for node, parent in enumerate(parents.tolist()):
        if parent >= 0:
            places_m[node] = places_m[parent] + world[parent] @ offsets_m[node]
            world[node] = world[parent] @ local[node]
    return Avatar(names, offsets_m, local, places_m, world)


def _motion(joints_m: Floats) -> Motion:
    people = People(np.zeros(len(joints_m), dtype=np.int64), joints_m)
    (motion,) = motions_of(np.arange(len(joints_m)), people)
    return motion
