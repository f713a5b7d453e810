"""Pair videos with cameras by name."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.model.camera_fields import check_camera_id
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
            camera_id, path = re.sub(r"[^A-Za-z0-9_.-]", "_", stem)[:64], str(video)
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
        rig.index(camera_id)
        paired[camera_id] = _with_chapter(paired.get(camera_id), path)
    free = [camera_id for camera_id in rig.camera_ids if camera_id not in paired]
    for rule in (_same, _contained, _same_number):
        pairs = _by_rule(rest, free, rule)
        if pairs is not None:
            paired |= pairs
            return {name: paired[name] for name in rig.camera_ids if name in paired}
        if rule is _contained and any(rule(p.stem.lower(), c.lower()) for p in rest for c in free):
            break  # some names do hold an id: numbers must not settle what they leave in doubt
    raise InputError(
        f"videos: cannot tell which camera each belongs to: found files "
        f"{', '.join(path.name for path in rest)}, cameras {', '.join(free) or '(none left)'}; "
        "rename the files after the cameras or pass them as CAMERA=FILE"
    )


def _with_chapter(before: Path | None, path: str) -> Path:
    """Return a film with one more chapter, as `open_video` reads it."""
    return Path(path if before is None else f"{before}+{Path(path).resolve()}")


def _by_rule(
    videos: Sequence[Path], camera_ids: Sequence[str], fits: Callable[[str, str], bool]
) -> dict[str, Path] | None:
    pairs: dict[str, Path] = {}
    for path in videos:
        candidates = [name for name in camera_ids if fits(path.stem.lower(), name.lower())]
        if len(candidates) != 1 or candidates[0] in pairs:
            return None
        pairs[candidates[0]] = path
    return pairs


def _same(stem: str, camera_id: str) -> bool:
    return stem == camera_id


def _contained(stem: str, camera_id: str) -> bool:
    return _has_word(stem, camera_id) or _has_word(camera_id, stem)


def _has_word(text: str, word: str) -> bool:
    return re.search(rf"(?<![a-z0-9]){re.escape(word)}(?![a-z0-9])", text) is not None


def _same_number(stem: str, camera_id: str) -> bool:
    ours, theirs = re.findall(r"\d+", stem), re.findall(r"\d+", camera_id)
    return bool(ours and theirs) and int(ours[-1][-9:]) == int(theirs[-1][-9:])
