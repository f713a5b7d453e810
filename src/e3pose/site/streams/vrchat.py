"""VRChat's OSC trackers: one person's hips, chest, feet, knees and elbows; OSC over UDP.

/tracking/trackers/N/position   x, y, z in metres in the axes of Unity; N as in `TRACKERS`
/tracking/trackers/N/rotation   Euler angles x, y, z in degrees, applied z, x, y
/tracking/trackers/head/...     likewise, by which VRChat aligns its space with ours

Written from the specification, https://docs.vrchat.com/docs/osc-trackers. What a slot does not show
is not sent in it.
"""

from __future__ import annotations

from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder

from e3pose.site.connect import LiveSlot
from e3pose.site.streams.base import Source
from e3pose.site.streams.humanoid import AvatarStream, euler_deg
from e3pose.site.streams.osc import message

PORT = 9000
TRACKERS = {
    "1": "mid_hip", "2": "neck", "3": "left_ankle", "4": "right_ankle", "5": "left_knee",
    "6": "right_knee", "7": "left_elbow", "8": "right_elbow", "head": "mid_ear",
}  # fmt: skip


def open_stream(place: str, source: Source) -> VrchatStream:
    """Return a stream to `HOST:PORT`, received or not; `?track=7` names the person to send."""
    return VrchatStream(place, source, PORT)


class VrchatStream(AvatarStream):
    """See `Stream`."""

    def slot(self, slot: LiveSlot) -> None:
        """See `Stream.slot`; a bundle, where the person is shown."""
        avatar = self._humanoid.of(slot)
        if avatar is None:
            return
        bundle = OscBundleBuilder(IMMEDIATELY)
        for tracker, node in TRACKERS.items():
            if node in avatar.names:
                row = avatar.names.index(node)
                for what, values in (
                    ("position", avatar.places_m[row].tolist()),
                    ("rotation", euler_deg(avatar.world[row])),
                ):
                    address = f"/tracking/trackers/{tracker}/{what}"
                    bundle.add_content(message(address, *((value, "f") for value in values)))
        self._client.send(bundle.build())
