"""Match folders of detections with cameras by name."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from e3pose.base.errors import InputError

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
