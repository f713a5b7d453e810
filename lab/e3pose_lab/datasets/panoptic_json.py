"""3D bodies of Panoptic: one `body3DScene_<frame>.json` per frame."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from e3pose.base.bounded import decode_json, read_bytes
from e3pose.base.errors import InputError
from e3pose.recording.detections.openpose import Progress, frame_number
from e3pose.recording.record import MAX_PEOPLE

MAX_FILE_BYTES = 16 * 2**20
COORDINATE_LIMIT_CM = 1e5


class _Body(msgspec.Struct):
    id: int
    joints19: list[float]


class _File(msgspec.Struct):
    bodies: list[_Body]


def read_bodies(
    folder: Path, progress: Progress = iter
) -> dict[int, dict[int, NDArray[np.float64]]]:
    """Read the bodies of every frame.

    Args:
        folder: `hdPose3d_stage1_coco19` of a sequence.
        progress: wraps the list of files that is read.

    Returns:
        Frame number to person number to `(19, 4)` centimetres and confidence, -1 where unknown.

    Raises:
        InputError: for no file, a wrong file, too many people, or two files of one frame.
    """
    paths = sorted(folder.glob("body3DScene_*.json"))
    if not paths:
        raise InputError(f"{folder}: found no body3DScene_*.json, expected one a frame")
    frames: dict[int, dict[int, NDArray[np.float64]]] = {}
    for path in progress(paths):
        number = frame_number(path.name)
        if number in frames:
            raise InputError(f"{path}: frame number {number} appears twice in this folder")
        frames[number] = _read_file(path)
    people = {person for bodies in frames.values() for person in bodies}
    if len(people) > MAX_PEOPLE:
        raise InputError(f"{folder}: found {len(people)} people, expected at most {MAX_PEOPLE}")
    return frames


def _read_file(path: Path) -> dict[int, NDArray[np.float64]]:
    bodies = decode_json(_File, read_bytes(path, MAX_FILE_BYTES), path, "Panoptic bodies").bodies
    people: dict[int, NDArray[np.float64]] = {}
    for index, body in enumerate(bodies):
        where = f"{path}: bodies[{index}]"
        if len(body.joints19) != 19 * 4:
            raise InputError(f"{where}.joints19: found {len(body.joints19)} numbers, expected 76")
        if not 0 <= body.id < 2**31 or body.id in people:
            raise InputError(f"{where}.id: found {body.id}, expected unique numbers from 0")
        joints = np.array(body.joints19, dtype=np.float64).reshape(19, 4)
        if (np.abs(joints) > COORDINATE_LIMIT_CM).any():
            raise InputError(f"{where}.joints19: found a coordinate beyond 1 km, in centimetres")
        people[body.id] = joints
    return people
