"""Videos of live cameras: names, times, and the recording they belong to; numbers of frames."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta, timezone
from pathlib import Path

from e3pose.base.bounded import read_toml
from e3pose.base.errors import InputError
from e3pose.base.private import make_folder
from e3pose.recording.folder import HEADER, MAX_HEADER_BYTES, put_header

VIDEOS = "videos"  # folder: in a recording, and beside recordings for those that belong to none yet
SUFFIX = ".mkv"
# Of what a live site keeps. Recordings and videos are cut at the same slots.
PART_S = 600.0
MAX_BYTES = 10**10
NAME = re.compile(r"(.+)-(\d{8}T\d{6}\.\d{6})Z")
NAME_TIME = "%Y%m%dT%H%M%S.%f"
NUMBER = re.compile(r"\d{1,18}")
MAX_NAME = 300
BEGAN_1970 = datetime(1970, 1, 1, tzinfo=timezone.utc)


def part_of(slot: int, fps: float, part_s: float) -> int:
    """Return the number of the part of a live session that a slot belongs to.

    Args:
        slot: number of the slot, by the edge.
        fps: slots per second of the scene.
        part_s: length of a part, in seconds of the scene.
    """
    return slot // max(1, round(part_s * fps))


def video_name(camera_id: str, begin_ns: int) -> str:
    """Return the name of a video: the camera, and when its first frame was taken (UTC, to 1 us)."""
    begin = BEGAN_1970 + timedelta(microseconds=begin_ns // 1000)
    return f"{camera_id}-{begin.strftime(NAME_TIME)}Z{SUFFIX}"


def begin_of(path: Path) -> int | None:
    """Return when the first frame of a video was taken, nanoseconds since 1970, by its name.

    None where the name does not say it.
    """
    found = NAME.fullmatch(path.stem)
    if found is None:
        return None
    try:
        begin = datetime.strptime(found[2], NAME_TIME).replace(tzinfo=timezone.utc)
    except ValueError:
        return None
    return (begin - BEGAN_1970) // timedelta(microseconds=1) * 1000


def videos_in(folder: Path) -> list[Path]:
    """Return the videos that a camera recorded in a folder, oldest first."""
    found = [(begin_of(path), path) for path in folder.glob(f"*{SUFFIX}")]
    return [path for begin_ns, path in sorted((b, p) for b, p in found if b is not None)]


def choose_video(videos: Sequence[Path], begin_ns: int, end_ns: int) -> Path | None:
    """Return the video that shows most of a stretch of time; None if none shows any.

    A video ends when it was last written to, and at the latest where the next one begins.

    Args:
        videos: of one camera, oldest first.
        begin_ns: begin of the stretch, since 1970.
        end_ns: its end.
    """
    best: tuple[int, Path] | None = None
    for index, path in enumerate(videos):
        begin = begin_of(path)
        following = begin_of(videos[index + 1]) if index + 1 < len(videos) else None
        if begin is None:
            continue
        last = path.stat().st_mtime_ns
        shown = min(end_ns, last if following is None else min(last, following))
        shown -= max(begin_ns, begin)
        if shown > 0 and (best is None or shown > best[0]):
            best = shown, path
    return None if best is None else best[1]


def chapters_of(path: Path) -> list[Path]:
    """Return the files of a video: itself, or those of A.MP4+B.MP4."""
    if "+" not in str(path) or Path(path).exists():
        return [Path(path)]
    first, *others = (Path(part) for part in str(path).split("+"))
    return [first, *(p if len(p.parts) > 1 else first.parent / p for p in others)]


def take_videos(recording: Path, videos: Mapping[str, Path]) -> None:
    """Move videos into a recording and name them in its header; those there already stay.

    A video that is still being written goes on growing at its new place.

    Args:
        recording: its folder.
        videos: by camera.

    Raises:
        OSError: when that cannot be done.
    """
    if not videos:
        return
    folder = recording / VIDEOS
    make_folder(folder)
    named: dict[str, str] = {}
    for camera_id, path in videos.items():
        named[camera_id] = f"{camera_id}{SUFFIX}"
        os.replace(path, folder / named[camera_id])
    table = dict(read_toml(recording / HEADER, MAX_HEADER_BYTES))
    table[VIDEOS] = {**table.get(VIDEOS, {}), **named}
    put_header(recording, table)


def frame_numbers(names: Sequence[str]) -> list[int]:
    """Return the frame number of each file name, such as 12 of `walk_000012_keypoints_2d.json`.

    It is the last number that differs in all of them; of a single file the longest.

    Raises:
        InputError: for a name without a number.
    """
    found = []
    for name in names:
        # The length is checked first: a search takes time with it.
        numbers = NUMBER.findall(name.rsplit(".", 1)[0]) if len(name) < MAX_NAME else []
        if not numbers:
            raise InputError(f"{name[:120]!r}: found no frame number in the file name")
        found.append(numbers)
    if len(found) == 1:
        return [int(max(reversed(found[0]), key=len))]
    for place in range(1, min(map(len, found), default=0) + 1):
        numbers = [int(of_name[-place]) for of_name in found]
        if len({*numbers}) == len(numbers):
            return numbers
    return [int(numbers[-1]) for numbers in found]


def frame_number(name: str) -> int:
    """Return the frame number of one file name, see `frame_numbers`; the last of equally long."""
    return frame_numbers([name])[0]
