"""Pair videos, folders and files of detections with cameras by name."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.model.camera_fields import check_camera_id, safe_id
from e3pose.recording.videos import chapters_of


def name_videos(videos: Sequence[Path | str]) -> dict[str, Path]:
    """Name cameras after their videos, for want of a rig: `CAMERA=path`, or the file's stem.

    `CAMERA=path` again is the next chapter of that camera's film.

    Returns:
        Camera id to file or folder, in the order given; characters that no camera id may have
        become `_`.

    Raises:
        InputError: when two of them get one name, or a name is none.
    """
    named: dict[str, Path] = {}
    for video in videos:
        camera_id, equals, path = str(video).partition("=")
        if not equals or Path(video).exists():
            stem = chapters_of(Path(video))[0].stem
            camera_id, path = safe_id(stem), str(video)
        check_camera_id(camera_id)
        if camera_id in named and not equals:
            raise InputError(
                f"videos: {named[camera_id]} and {path} both name camera {camera_id!r}; say "
                "CAMERA=PATH"
            )
        named[camera_id] = _with_chapter(named.get(camera_id), path)
    if not named:
        raise InputError("videos: found none, expected at least one")
    return named


def pair_videos(videos: Sequence[Path | str], rig: Rig) -> dict[str, Path]:
    """Pair videos with the cameras of a rig.

    `CAMERA=path` says it outright; of one camera said again, it is the next chapter of its film.
    The other files are paired by the first of three rules that
    gives each of them one camera of its own: the file's stem is the camera id; the stem holds the
    id as a word of its own, or the id the stem; the last numbers in stem and id are equal.

    Returns:
        Camera id to file, in rig order. Cameras without a video are left out.

    Raises:
        InputError: listing both sides, when no rule fits.
    """
    if not videos:
        raise InputError(f"videos: found none, expected files for {', '.join(rig.camera_ids)}")
    paired: dict[str, Path] = {}
    rest: list[Path] = []
    for video in videos:
        camera_id, equals, path = str(video).partition("=")
        if not equals or Path(video).exists():
            rest.append(Path(video))
            continue
        camera_id = rig.camera_ids[rig.index(safe_id(camera_id))]
        paired[camera_id] = _with_chapter(paired.get(camera_id), path)
    free = [camera_id for camera_id in rig.camera_ids if camera_id not in paired]
    pairs = _by_name({path: chapters_of(path)[0].stem for path in rest}, free)
    if len(pairs) == len(rest):
        paired |= pairs
        return {name: paired[name] for name in rig.camera_ids if name in paired}
    raise InputError(
        f"videos: cannot tell which camera each belongs to: found files "
        f"{', '.join(path.name for path in rest)}, cameras {', '.join(free) or '(none left)'}; "
        "rename the files after the cameras or pass them as CAMERA=FILE"
    )


def pair_names(
    source: Path, names: Sequence[str], camera_ids: Sequence[str], given: Mapping[str, str]
) -> tuple[dict[str, str], list[str]]:
    """Pair the folders or files below a folder with cameras, by the rules of `pair_videos`.

    Args:
        source: the folder, for errors.
        names: in it.
        camera_ids: of the rig.
        given: camera id to name, which goes before any rule.

    Returns:
        Camera id to name, and the names that belong to no camera.

    Raises:
        InputError: listing both sides, when names and cameras are left over.
    """
    given = {name if name in camera_ids else safe_id(name): made for name, made in given.items()}
    for camera_id, name in given.items():
        if camera_id not in camera_ids:
            raise InputError(
                f"--folder: camera {camera_id[:64]!r} is not one of {_list(camera_ids)}"
            )
        if name not in names:
            raise InputError(
                f"--folder: {name[:120]!r} holds no detections in {source}, which has "
                f"{_list(names)}"
            )
    if len(set(given.values())) != len(given):
        raise InputError("--folder: found one folder for two cameras, expected one each")
    left = {name: Path(name).stem for name in names if name not in given.values()}
    free = [camera_id for camera_id in camera_ids if camera_id not in given]
    paired = {**given, **_by_name(left, free)}
    unpaired = [name for name in names if name not in paired.values()]
    lonely = [camera_id for camera_id in camera_ids if camera_id not in paired]
    if not paired or (unpaired and lonely):
        raise InputError(
            f"{source}: cameras without a folder: {_list(lonely)}; of no camera: "
            f"{_list(unpaired)}; expected one per camera, or --folder CAMERA=FOLDER"
        )
    return paired, unpaired


def _list(names: Sequence[str]) -> str:
    return ", ".join(name[:64] for name in names[:40]) or "none"


def _with_chapter(before: Path | None, path: str) -> Path:
    """Return a film with one more chapter, as `open_video` reads it."""
    return Path(path if before is None else f"{before}+{Path(path).resolve()}")


Named = TypeVar("Named", Path, str)


def _by_name(stems: Mapping[Named, str], camera_ids: Sequence[str]) -> dict[str, Named]:
    """Return the pairs of cameras and things that the first rules settle without doubt."""
    pairs: dict[str, Named] = {}
    for rule in (_same, _contained, _same_number):
        left = [(thing, stem) for thing, stem in stems.items() if thing not in pairs.values()]
        free = [name for name in camera_ids if name not in pairs]
        fitting = [
            (thing, c)
            for thing, stem in left
            for c in free
            if rule(safe_id(stem).lower(), c.lower())
        ]
        for thing, camera_id in fitting:
            if (
                [c for _, c in fitting].count(camera_id)
                == [t for t, _ in fitting].count(thing)
                == 1
            ):
                pairs[camera_id] = thing
        if rule is _contained and (pairs or fitting):
            break  # some names do hold an id: numbers must not settle what they leave in doubt
    return pairs


def _same(stem: str, camera_id: str) -> bool:
    return stem == camera_id


def _contained(stem: str, camera_id: str) -> bool:
    return has_word(stem, camera_id) or has_word(camera_id, stem)


def has_word(text: str, word: str) -> bool:
    """Return whether a text has a word of its own; both in lower case."""
    return re.search(rf"(?<![a-z0-9]){re.escape(word)}(?![a-z0-9])", text) is not None


def _same_number(stem: str, camera_id: str) -> bool:
    ours, theirs = re.findall(r"\d+", stem), re.findall(r"\d+", camera_id)
    return bool(ours and theirs) and int(ours[-1][-9:]) == int(theirs[-1][-9:])
