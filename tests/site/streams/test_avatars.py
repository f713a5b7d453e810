"""VMC and VRChat's trackers: real packets, read as the protocols' specifications have them."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.cases import each_case
from tests.output.exports.takes import FPS, NUM_FRAMES, walking
from tests.site.streams.osc_reader import read_osc

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.model.zone_event import ZoneEvent
from e3pose.site.connect import LiveSlot
from e3pose.site.streams import Source, Stream, open_stream

SOURCE = Source("lab", COCO17, FPS)
STARTED_NS = 1_795_000_000_000_000_000
# Bones of Unity's humanoid, each with its parent, as the specification names them, and our joint.
BONES = {
    "Hips": ("", None), "Spine": ("Hips", None), "Chest": ("Spine", None), "Neck": ("Chest", None),
    "Head": ("Neck", None),
    **{f"{side}{bone}": (f"{side}{parent}" if parent[0] != "!" else parent[1:],
                         f"{side.lower()}_{joint}")
       for side in ("Left", "Right")
       for bone, parent, joint in (
           ("UpperLeg", "!Hips", "hip"), ("LowerLeg", "UpperLeg", "knee"),
           ("Foot", "LowerLeg", "ankle"), ("UpperArm", "!Chest", "shoulder"),
           ("LowerArm", "UpperArm", "elbow"), ("Hand", "LowerArm", "wrist"))},
}  # fmt: skip


@contextmanager
def receiver(kind: str, query: str = "") -> Iterator[tuple[Stream, socket.socket]]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
        listening.bind(("127.0.0.1", 0))
        listening.settimeout(10)
        stream = open_stream(f"{kind}://127.0.0.1:{listening.getsockname()[1]}{query}", SOURCE)
        yield stream, listening
        stream.close()


def slot(frame: int, *tracks: int) -> LiveSlot:
    """People who walk, each a metre from the one before."""
    places = walking()[frame]
    joints_m = np.array([places + [0, track, 0] for track in tracks]).reshape(-1, 17, 3)
    sigma_m = np.full(joints_m.shape[:2], 0.01)
    people = People(np.array(tracks), joints_m.astype(np.float32), sigma_m=sigma_m)
    time_ns = STARTED_NS + round(frame * 1e9 / FPS)
    return LiveSlot(frame, time_ns, people, COCO17.joints, (), (), 0)


def unity(place: Floats) -> Floats:
    """Return a place of the world, z up, right-handed, as x right, y up, z ahead, left-handed."""
    return np.array([-place[0], place[2], -place[1]])


def test_an_avatar_in_unity_stands_as_the_person_does() -> None:
    with receiver("vmc") as (stream, listening):
        for frame in range(NUM_FRAMES):
            stream.slot(slot(frame, 4))
            said = read_osc(listening.recv(65_536))
            assert said[0] == ("/VMC/Ext/OK", [1])
            assert said[1] == ("/VMC/Ext/T", [pytest.approx(frame / FPS, abs=1e-6)])
            assert said[2] == ("/VMC/Ext/Root/Pos", ["root", 0, 0, 0, 0, 0, 0, 1])
            bones = {values[0]: values[1:] for address, values in said[3:]}
            assert all(address == "/VMC/Ext/Bone/Pos" for address, _ in said[3:])
            assert set(bones) == set(BONES) and len(said) == 3 + len(BONES)
            places: dict[str, Floats] = {"": np.zeros(3)}
            facing: dict[str, Floats] = {"": np.eye(3)}
            for bone, (parent, joint) in BONES.items():
                px, py, pz, *quaternion = bones[bone]
                places[bone] = places[parent] + facing[parent] @ [px, py, pz]
                facing[bone] = facing[parent] @ Rotation.from_quat(quaternion).as_matrix()
                if joint is not None:
                    wanted = unity(slot(frame, 4).people.joints_m[0, COCO17.index(joint)])
                    assert np.linalg.norm(places[bone] - wanted) < 0.001, (frame, bone)


def test_one_person_is_sent_until_gone_and_nobody_is_not_ok() -> None:
    with receiver("vmc") as (stream, listening):
        stream.slot(slot(0))
        stream.zone(ZoneEvent("enter", "door", 7, 2, 0.0, 3, STARTED_NS))
        assert [m for m in read_osc(listening.recv(65_536))] == [
            ("/VMC/Ext/OK", [0]), ("/VMC/Ext/T", [0.0])
        ]  # fmt: skip
        listening.settimeout(0.2)
        with pytest.raises(TimeoutError):
            listening.recv(65_536)
        listening.settimeout(10)
        # One person is sent until gone.
        found = []
        shown = [(2, 5)] * 3 + [(5,)] * 10 + [(2, 5)] + [(5, 9)] * 26
        for frame, tracks in enumerate(shown[:NUM_FRAMES]):
            stream.slot(slot(frame, *tracks))
            place = hips_of(listening.recv(65_536))
            found.append(None if place is None else round(place))
    assert found[:3] == [2] * 3  # the first
    assert found[3:13] == [None] * 10  # away for less than a second: waited for
    assert found[13] == 2
    assert found[14:38] == [None] * 24 and found[39] == 5


def hips_of(packet: bytes) -> float | None:
    """Return which person a packet shows: metres along the world's y."""
    for address, values in read_osc(packet):
        if address == "/VMC/Ext/Bone/Pos" and values[0] == "Hips":
            return -float(values[3])
    return None


def test_a_named_track_is_sent() -> None:
    with receiver("vmc", "?track=5") as (stream, listening):
        for tracks, wanted in (((2,), None), ((2, 5), 5), ((5, 9), 5)):
            stream.slot(slot(3, *tracks))
            place = hips_of(listening.recv(65_536))
            assert (None if place is None else round(place)) == wanted


def test_trackers_of_vrchat_are_at_the_joints_and_turn_with_them() -> None:
    with receiver("vrchat") as (stream, listening):
        stream.slot(slot(0))  # nobody: nothing
        for frame in range(0, NUM_FRAMES, 5):
            shown = slot(frame, 4)
            stream.slot(shown)
            said = dict(read_osc(listening.recv(65_536)))
            assert len(said) == 2 * 9
            joints = shown.people.joints_m[0].astype(np.float64)
            for number, name in (("3", "left_ankle"), ("6", "right_knee"), ("7", "left_elbow")):
                place = said[f"/tracking/trackers/{number}/position"]
                wanted = unity(joints[COCO17.index(name)])
                np.testing.assert_allclose(place, wanted, atol=0.001)
            hips = joints[[COCO17.index("left_hip"), COCO17.index("right_hip")]]
            place = said["/tracking/trackers/1/position"]
            np.testing.assert_allclose(place, unity(hips.mean(axis=0)), atol=0.001)
            x, y, z = said["/tracking/trackers/1/rotation"]
            facing = Rotation.from_euler("YXZ", [y, x, z], degrees=True).as_matrix()  # z first
            across = unity(hips[1]) - unity(hips[0])  # from left to right: x of who faces z
            np.testing.assert_allclose(facing[:, 0], across / np.linalg.norm(across), atol=0.01)


@each_case("query", ["?track=x", "?person=1", "?track=1&track=2", "?track=-1"])
@each_case("kind", ["vmc", "vrchat"])
def test_a_target_names_a_track_or_nothing(kind: str, query: str) -> None:
    with pytest.raises(InputError, match="track=NUMBER"):
        open_stream(f"{kind}://127.0.0.1:9000{query}", SOURCE)
