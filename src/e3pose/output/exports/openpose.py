"""OpenPose JSON: a folder with one file per frame, people as BODY_25, hands and face as they are.

Without cameras the files hold `pose_keypoints_3d`, world metres with z up and scores, as OpenPose
writes its own reconstructions. With cameras there is a folder a camera, whose files hold the
projections into its real images as `pose_keypoints_2d`, too; `e3pose import openpose` reads it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.atomic import atomic_folder
from e3pose.model.people import People
from e3pose.model.skeleton import BODY25, SKELETONS, unused
from e3pose.model.take import Take
from e3pose.output.exports.base import ExportSettings
from e3pose.output.exports.views import frames, keypoints

VERSION = 1.3  # of OpenPose's format
PARTS = {
    "pose": BODY25,
    "face": SKELETONS["face70"],
    "hand_left": SKELETONS["left_hand21"],
    "hand_right": SKELETONS["right_hand21"],
}
WHOLE = SKELETONS["openpose137"]


def write_openpose(take: Take, dest: Path, settings: ExportSettings) -> str:
    """Write all people of a take into a new folder; file numbers are slots."""
    found = frames(take, WHOLE)
    with atomic_folder(dest, private=True) as folder:
        cameras = () if settings.rig is None else settings.rig.cameras
        for camera in cameras:
            (folder / camera.camera_id).mkdir()
        for slot, people in settings.progress(found, len(found), "write"):
            name = f"{slot:012d}_keypoints.json"
            if not cameras:
                empty = np.zeros((len(people), 0, 3))
                (folder / name).write_bytes(_encoded(people, empty))
            for camera in cameras:
                seen = keypoints(people, camera)
                (folder / camera.camera_id / name).write_bytes(_encoded(people, seen))
    what = f"{len(cameras)} cameras" if cameras else "3D, metres, z up"
    left = unused(take.skeleton.joints, WHOLE.joints)
    return f"{len(found)} frames, {what}" + (f"; {left}" if left else "")


def _encoded(people: People, seen: Floats) -> bytes:
    places = np.concatenate([people.joints_m, people.scores[..., None]], axis=-1)
    places = np.where(people.scores[..., None] > 0, places, 0.0)
    rows = zip(people.track_ids.tolist(), seen, places, strict=True)
    return msgspec.json.encode({"version": VERSION, "people": [_person(*row) for row in rows]})


def _person(track_id: int, seen: Floats, places: Floats) -> dict[str, Any]:
    person: dict[str, Any] = {"person_id": [track_id]}
    for part, skeleton in PARTS.items():
        columns = [WHOLE.index(joint) for joint in skeleton.joints]
        for kind, values in (("2d", seen), ("3d", places)):
            there = part == "pose" or (len(places) and places[columns, -1].any())
            numbers = values[columns].round(5).ravel().tolist() if there and len(values) else []
            person[f"{part}_keypoints_{kind}"] = numbers
    return person
