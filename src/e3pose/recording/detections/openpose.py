"""OpenPose JSON: `<camera>/<frame>_keypoints.json`, one file per camera and frame."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.bounded import decode_json, read_bytes
from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import BODY25, COCO17, COCO18, Skeleton
from e3pose.recording import Recording
from e3pose.recording.calibration import load_rig
from e3pose.recording.detections.views import check_fps, poses_from_triples, series_from_frames

DECORATION = re.compile(r"[_.-](json|keypoints|openpose|pose|hd)$", re.IGNORECASE)

Matcher = Callable[[str, str], bool]


def match_folders(
    source: Path, camera_ids: Sequence[str], given: Mapping[str, str]
) -> dict[str, Path]:
    """Find the folder of each camera below `source`.

    A folder belongs to the camera whose id is its name, or else its name without a decoration such
    as `_json`, or else the only one of the rest of which one begins or ends with the other.

    Args:
        source: the folder that holds a folder per camera.
        camera_ids: cameras of the rig.
        given: camera id to folder name, which goes before any guess.

    Raises:
        InputError: listing cameras and folders, when a camera or a folder with JSON files is left
            over or two folders fit.
    """
    if not source.is_dir():
        what = "a file" if source.exists() else "nothing"
        raise InputError(f"{source}: found {what}, expected a folder with a folder per camera")
    names = sorted(
        entry.name for entry in source.iterdir() if entry.is_dir() and any(entry.glob("*.json"))
    )
    matched = _check_given(source, names, camera_ids, given)
    for same in (_exactly, _undecorated, _one_begins_or_ends_with_the_other):
        matched |= _unique_pairs(
            [name for name in names if name not in matched.values()],
            [camera_id for camera_id in camera_ids if camera_id not in matched],
            same,
        )
    left = [name for name in names if name not in matched.values()]
    lonely = [camera_id for camera_id in camera_ids if camera_id not in matched]
    if left or lonely:
        raise InputError(
            f"{source}: cameras without a folder: {_list(lonely)}; folders without a camera: "
            f"{_list(left)}; expected one folder per camera, or --folder CAMERA=FOLDER"
        )
    return {camera_id: source / matched[camera_id] for camera_id in camera_ids}


def _check_given(
    source: Path, names: Sequence[str], camera_ids: Sequence[str], given: Mapping[str, str]
) -> dict[str, str]:
    for camera_id, name in given.items():
        if camera_id not in camera_ids:
            raise InputError(
                f"--folder: camera {camera_id[:64]!r} is not one of {_list(camera_ids)}"
            )
        if name not in names:
            raise InputError(
                f"--folder: {name[:120]!r} is not a folder of JSON files in {source}, "
                f"which has {_list(names)}"
            )
    if len(set(given.values())) != len(given):
        raise InputError("--folder: found one folder for two cameras, expected one each")
    return dict(given)


def _unique_pairs(names: Sequence[str], camera_ids: Sequence[str], same: Matcher) -> dict[str, str]:
    pairs = [
        (camera_id, name) for camera_id in camera_ids for name in names if same(name, camera_id)
    ]
    return {
        camera_id: name
        for camera_id, name in pairs
        if [c for c, _ in pairs].count(camera_id) == 1 and [n for _, n in pairs].count(name) == 1
    }


def _exactly(name: str, camera_id: str) -> bool:
    return name == camera_id


def _undecorated(name: str, camera_id: str) -> bool:
    return DECORATION.sub("", name).lower() == DECORATION.sub("", camera_id).lower()


def _one_begins_or_ends_with_the_other(name: str, camera_id: str) -> bool:
    short, long = sorted((DECORATION.sub("", name).lower(), camera_id.lower()), key=len)
    # `cam1` must not claim `cam10`: what follows or precedes may not go on with the same number.
    begins = long.startswith(short) and not (short[-1:] + long[len(short) :][:1]).isdigit()
    ends = long.endswith(short) and not (long[: -len(short)][-1:] + short[:1]).isdigit()
    return bool(short) and (begins or ends)


def _list(names: Sequence[str]) -> str:
    return ", ".join(name[:64] for name in names[:40]) or "none"


MAX_FILE_BYTES = 64 * 2**20
SKELETONS_BY_COUNT = {3 * len(s): s for s in (BODY25, COCO18, COCO17)}
FRAME_NUMBER = re.compile(r"(\d{1,18})(?!.*\d)")

Progress = Callable[[Sequence[Path]], Iterable[Path]]


class _Person(msgspec.Struct):
    pose_keypoints_2d: list[float]


class _File(msgspec.Struct):
    people: list[_Person]


def import_openpose(
    source: Path,
    calibration: Path,
    fps: float,
    folders: Mapping[str, str] | None = None,
    progress: Progress = iter,
) -> Recording:
    """Read a folder of OpenPose JSON files.

    Args:
        source: a folder with one folder per camera, which holds `<frame>_keypoints.json` files.
        calibration: the rig, in any format that `e3pose.recording.calibration` reads.
        fps: frames per second of the cameras.
        folders: camera id to folder name, where names alone do not tell.
        progress: wraps the list of files that is read.

    Returns:
        A recording whose slot 0 is the lowest frame number of any camera.

    Raises:
        InputError: naming the file and field that is wrong.
    """
    check_fps(fps)
    rig = load_rig(calibration)
    skeleton, frames = read_detections(source, rig, folders or {}, progress)
    num_slots, views = series_from_frames(frames, fps, len(skeleton), str(source))
    name = "".join(char for char in source.resolve().name if char.isprintable())
    return Recording(
        name=name[:200] or "openpose",
        rig=rig,
        fps=fps,
        num_slots=num_slots,
        skeleton=skeleton,
        views=views,
        detector="openpose",
        source=f"OpenPose JSON, {skeleton.name}",
    )


def read_detections(
    source: Path, rig: Rig, folders: Mapping[str, str], progress: Progress = iter
) -> tuple[Skeleton, list[dict[int, Poses2D]]]:
    """Return the skeleton and, per camera of `rig`, frame number to view.

    Raises:
        InputError: for files without people, of mixed skeletons, or two of one frame.
    """
    matched = match_folders(source, rig.camera_ids, folders)
    files = {
        path: camera
        for camera, camera_id in enumerate(rig.camera_ids)
        for path in sorted(matched[camera_id].glob("*.json"))
    }
    people: dict[Path, Floats] = {}
    count = 0
    example: Path | None = None
    for path in progress(list(files)):
        people[path] = read_people(path)
        if len(people[path]) == 0:
            continue
        numbers = people[path].shape[1]
        if count and numbers != count:
            raise InputError(
                f"{path}: pose_keypoints_2d: found {numbers} numbers, expected {count} "
                f"as in {example}"
            )
        count, example = numbers, path
    if not count:
        raise InputError(f"{source}: found nobody in {len(files)} files, expected a person")
    skeleton = SKELETONS_BY_COUNT[count]
    frames: list[dict[int, Poses2D]] = [{} for _ in rig.camera_ids]
    for path, camera in files.items():
        number = frame_number(path.name)
        if number in frames[camera]:
            raise InputError(f"{path}: frame number {number} appears twice in this folder")
        triples = people[path].reshape(-1, len(skeleton), 3)
        frames[camera][number] = poses_from_triples(triples, str(path))
    return skeleton, frames


def read_people(path: Path) -> Floats:
    """Return `(num_persons, numbers)` x, y, score, x, ... of the people of a file with a body.

    Raises:
        InputError: for a file that is no OpenPose JSON, or mixes skeletons.
    """
    people = decode_json(_File, read_bytes(path, MAX_FILE_BYTES), path, "OpenPose JSON").people
    for index, person in enumerate(people):
        count = len(person.pose_keypoints_2d)
        if count not in SKELETONS_BY_COUNT and count != 0:
            raise InputError(
                f"{path}: people[{index}].pose_keypoints_2d: found {count} numbers, "
                "expected 75 (BODY_25), 54 (COCO-18) or 51 (COCO-17)"
            )
    bodies = [person.pose_keypoints_2d for person in people if person.pose_keypoints_2d]
    if len({len(body) for body in bodies}) > 1:
        raise InputError(f"{path}: pose_keypoints_2d: found people with different skeletons")
    return np.array(bodies, dtype=np.float64)


def frame_number(file_name: str) -> int:
    """Return the last number in a file name such as `walk_000000000012_keypoints.json`.

    Raises:
        InputError: for a name without a number.
    """
    # The length is checked first: the search takes time with its square.
    match = FRAME_NUMBER.search(file_name.rsplit(".", 1)[0]) if len(file_name) < 300 else None
    if match is None:
        raise InputError(f"{file_name[:120]!r}: found no frame number in the file name")
    return int(match[1])
