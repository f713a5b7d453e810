"""Human3.6M in its common JSON layout: cameras and 3D joints of a subject."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.bounded import decode_json, read_bytes
from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording, Truth
from e3pose.recording.detections.importing import Progress
from e3pose.recording.detections.views import MAX_SLOTS
from e3pose.recording.json_lines import METRE_LIMIT
from e3pose_lab.datasets.detected import detected_views

FPS = 50.0
EXPECTED = "Human3.6M's JSON"
MAX_FILE_BYTES = 1 * 2**30
WHERE = (
    "http://vision.imar.ro/human3.6m, as JSON by https://github.com/mks0601/3DMPPE_POSENET_RELEASE"
)
SOURCE = "Human3.6M, Ionescu et al., TPAMI 2014; academic use only."
IMAGE_SIZES = {"1": (1000, 1002), "4": (1000, 1002)}
USUAL_SIZE = (1000, 1000)
FIRST_IMAGE = 1  # of frame 0
NUM_JOINTS = 17
# Where the joints of COCO-17 stand among those of Human3.6M, which have neither eyes nor ears.
COLUMNS = {
    "nose": 9, "left_shoulder": 11, "right_shoulder": 14, "left_elbow": 12, "right_elbow": 15,
    "left_wrist": 13, "right_wrist": 16, "left_hip": 4, "right_hip": 1, "left_knee": 5,
    "right_knee": 2, "left_ankle": 6, "right_ankle": 3,
}  # fmt: skip
SEEN_SHARE = 0.5  # of the joints, at least, that are inside the images of cameras placed aright


class _Camera(msgspec.Struct):
    R: list[list[float]]
    t: list[float]
    f: list[float]
    c: list[float]


Decoded = TypeVar("Decoded")


def import_human36m(
    source: Path,
    subject: int,
    action: int,
    subaction: int = 1,
    detections: Path | None = None,
    folders: Mapping[str, str] | None = None,
    progress: Progress = iter,
) -> Recording:
    """Read one sequence of Human3.6M.

    Args:
        source: a folder with `Human36M_subject<n>_camera.json` and `_joint_3d.json`, itself or in
            `annotations`.
        subject: number of the subject: 1, 5 to 9 or 11.
        action: number of the action, 2 to 16.
        subaction: 1 or 2.
        detections: a folder of OpenPose JSON with the numbers of the images, or a recording that
            `e3pose detect` made of all images. Without it the recording has the truth and no views.
        folders: camera id to folder name below `detections`.
        progress: wraps the list of files that is read.

    Returns:
        A recording at 50 fps with cameras `ca_01` to `ca_04`; slot 0 is frame 0, whose image has
        number 1. The truth has the twelve joints of the limbs and the nose; eyes and ears are NaN.

    Raises:
        InputError: naming what is missing with the place where it is published, or what is wrong.
    """
    joints_m = _joints(source, subject, action, subaction)
    rig = _rig(_file(source, subject, "camera"), joints_m)
    last = FIRST_IMAGE + len(joints_m) - 1
    found = detected_views(
        detections, rig, FPS, (FIRST_IMAGE, last), lambda: FIRST_IMAGE, folders or {}, progress
    )
    return Recording(
        name=f"Human3.6M S{subject} action {action}.{subaction}",
        rig=rig,
        fps=FPS,
        num_slots=len(joints_m),
        skeleton=found.skeleton,
        views=found.views,
        truth=Truth(COCO17, (f"S{subject}",), joints_m[:, None]),
        detector=found.detector,
        source=SOURCE + found.note,
    )


def _file(source: Path, subject: int, part: str) -> Path:
    name = f"Human36M_subject{subject}_{part}.json"
    for folder in (source, source / "annotations"):
        if (folder / name).is_file():
            return folder / name
    raise InputError(f"{source / name}: missing: {part} of the subject, published at {WHERE}")


def _joints(source: Path, subject: int, action: int, subaction: int) -> Floats:
    """Return `(num_slots, 17, 3)` metres in COCO-17, NaN where Human3.6M has no such joint."""
    path = _file(source, subject, "joint_3d")
    content = read_bytes(path, MAX_FILE_BYTES)
    actions = decode_json(dict[str, dict[str, msgspec.Raw]], content, path, EXPECTED)
    for option, wanted, known in (
        ("--action", str(action), actions),
        ("--subaction", str(subaction), actions.get(str(action), {})),
    ):
        if wanted not in known:
            raise InputError(option, wanted, f"one of {', '.join(known) or 'none'} in {path}")
    where = f"action {action}, subaction {subaction}"
    frames = decode_json(
        dict[str, list[list[float]]], actions[str(action)][str(subaction)], path, EXPECTED
    )
    numbers = [int(number) if number.isascii() and number.isdigit() else -1 for number in frames]
    if not numbers or min(numbers) < 0 or max(numbers) >= MAX_SLOTS:
        raise InputError(f"{path}: {where}: found {len(numbers)} frames, expected numbers from 0")
    joints_m = np.full((max(numbers) + 1, len(COCO17), 3), np.nan)
    columns = [COCO17.index(name) for name in COLUMNS]
    for number, joints in zip(numbers, frames.values(), strict=True):
        if len(joints) != NUM_JOINTS or any(len(joint) != 3 for joint in joints):
            raise InputError(
                f"{path}: {where}: frame {number}: found {len(joints)} joints, expected "
                f"{NUM_JOINTS} of three coordinates in mm"
            )
        joints_m[number, columns] = np.array(joints)[list(COLUMNS.values())] / 1000
    if np.nanmax(np.abs(joints_m)) > METRE_LIMIT:
        raise InputError(f"{path}: {where}: found a coordinate beyond {METRE_LIMIT:g} metres")
    return joints_m


def _rig(path: Path, joints_m: Floats) -> Rig:
    """Return the cameras that see the joints.

    Files in circulation mean two things by `t`: `x = R X + t`, or the place of the camera,
    `x = R (X - t)`. Only one of them puts the person into the images.
    """
    cameras = decode_json(dict[str, _Camera], read_bytes(path, MAX_FILE_BYTES), path, EXPECTED)
    if not 1 <= len(cameras) <= 16:
        raise InputError(f"{path}: found {len(cameras)} cameras, expected those of the subject")
    rigs = [
        Rig(tuple(_camera(path, *item, placed) for item in sorted(cameras.items())))
        for placed in (False, True)
    ]
    shares = [_seen_share(rig, joints_m) for rig in rigs]
    if max(shares) < SEEN_SHARE:
        raise InputError(
            f"{path}: found cameras that see {max(shares):.0%} of the joints, expected those of "
            "the subject, in mm"
        )
    return rigs[int(np.argmax(shares))]


def _camera(path: Path, name: str, found: _Camera, placed: bool) -> Camera:
    where = f"{path}: camera {name[:20]}"
    R, t = np.array(found.R), np.array(found.t)
    if R.shape != (3, 3) or t.shape != (3,) or len(found.f) != 2 or len(found.c) != 2:
        raise InputError(f"{where}: found other shapes, expected R 3 x 3, t 3, f 2 and c 2 numbers")
    K = np.array([[found.f[0], 0, found.c[0]], [0, found.f[1], found.c[1]], [0, 0, 1]])
    t_m = (-R @ t if placed else t) / 1000
    camera_id = f"ca_{int(name):02d}" if name.isascii() and name.isdigit() else name
    try:
        return Camera.from_world_to_camera(camera_id, IMAGE_SIZES.get(name, USUAL_SIZE), K, R, t_m)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _seen_share(rig: Rig, joints_m: Floats) -> float:
    known = joints_m[np.isfinite(joints_m).all(axis=-1)]
    return float(np.mean([camera.sees(known) for camera in rig.cameras]))
