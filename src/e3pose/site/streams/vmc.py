"""VMC, the Virtual Motion Capture protocol: one person moves an avatar; OSC over UDP.

/VMC/Ext/OK         1 while a person is sent, else 0
/VMC/Ext/T          seconds of the slot since the first that was sent
/VMC/Ext/Root/Pos   `root`: the origin of the world
/VMC/Ext/Bone/Pos   name of a bone of Unity's humanoid; place beside its parent x, y, z, metres;
                    rotation beside its parent x, y, z, w

Written from the specification, https://protocol.vmc.info/english. The hips are the only bone whose
place a receiver needs; the others have the lengths of the person.
"""

from __future__ import annotations

from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message import OscMessage

from e3pose.output.exports.bone_names import BONE_NAMES, bone_names
from e3pose.site.connect import LiveSlot
from e3pose.site.streams.base import Source
from e3pose.site.streams.humanoid import AvatarStream, quaternion
from e3pose.site.streams.osc import message

PORT = 39539
NO_TURN = (0.0, 0.0, 0.0, 1.0)
KNOWN = frozenset(BONE_NAMES["vrm"].values())


def open_stream(place: str, source: Source) -> VmcStream:
    """Return a stream to `HOST:PORT`, received or not; `?track=7` names the person to send."""
    return VmcStream(place, source)


class VmcStream(AvatarStream):
    """See `Stream`."""

    def __init__(self, place: str, source: Source) -> None:
        """See `AvatarStream`."""
        super().__init__(place, source, PORT)
        self._begun_ns: int | None = None

    def slot(self, slot: LiveSlot) -> None:
        """See `Stream.slot`; a bundle."""
        self._begun_ns = slot.time_ns if self._begun_ns is None else self._begun_ns
        avatar = self._humanoid.of(slot)
        bundle = OscBundleBuilder(IMMEDIATELY)
        bundle.add_content(message("/VMC/Ext/OK", (int(avatar is not None), "i")))
        bundle.add_content(message("/VMC/Ext/T", ((slot.time_ns - self._begun_ns) / 1e9, "f")))
        if avatar is not None:
            bundle.add_content(_place("/VMC/Ext/Root/Pos", "root", (0.0, 0.0, 0.0), NO_TURN))
            for node, name in enumerate(bone_names(avatar.names, "vrm")):
                if name in KNOWN:
                    unity = name[0].upper() + name[1:]
                    turn = quaternion(avatar.local[node])
                    bundle.add_content(
                        _place("/VMC/Ext/Bone/Pos", unity, avatar.offsets_m[node].tolist(), turn)
                    )
        self._client.send(bundle.build())


def _place(
    address: str, name: str, place_m: list[float] | tuple[float, ...], turn: object
) -> OscMessage:
    values = [*place_m, *turn]  # type: ignore[misc]
    return message(address, (name, "s"), *((float(value), "f") for value in values))
