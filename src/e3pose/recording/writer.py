"""Write a recording while it happens, and repair one that was cut off.

The work stands in `NAME.partial`, a growing file of lines for each camera, and gets its name when
it is finished.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

from e3pose.base.bounded import read_toml
from e3pose.base.errors import InputError
from e3pose.base.private import append_to, make_folder
from e3pose.base.system import reserve
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton
from e3pose.recording.calibration import load_rig, save_rig
from e3pose.recording.folder import (
    FORMAT,
    HEADER,
    MAX_HEADER_BYTES,
    RIG,
    VERSIONS,
    put_header,
    save_skeleton,
)
from e3pose.recording.json_lines import cut_torn, encode_view
from e3pose.recording.processor import ProcessorTime, save_processor

PARTIAL = ".partial"
# Room that is given back at the end, so that a recording on a full disk can still be finished.
ROOM, ROOM_BYTES = ".room", 2**16


@dataclass(slots=True, eq=False)
class RecordingWriter:
    """A recording that is being written. Use as a context manager, or `finish` it.

    Attributes:
        dest: the folder that it becomes.
        rig: the cameras.
        fps: slots per second.
        skeleton: of the keypoints.
        detector: what finds the keypoints, as in `Recording`.
        source: where it comes from, in words.
        num_slots: up to the newest view.
        num_bytes: written so far.
        counts: views by camera.
        processor: what cameras took, of those that were measured; set before the end.

    Raises:
        InputError: when unfinished work stands in its place.
    """

    dest: Path
    rig: Rig
    fps: float
    skeleton: Skeleton
    detector: str = ""
    source: str = ""
    num_slots: int = 0
    num_bytes: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    processor: Mapping[str, ProcessorTime] = field(default_factory=dict)
    _files: dict[str, IO[bytes]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        folder = self.folder
        if folder.exists():
            raise InputError(f"{folder}: found unfinished work of another program; move it away")
        try:
            make_folder(folder / "keypoints")
            save_rig(self.rig, folder / RIG)
            save_skeleton(folder, self.skeleton)
            self._write_header(None)
            with (folder / ROOM).open("wb") as room:
                reserve(room.fileno(), ROOM_BYTES)
            for camera_id in self.rig.camera_ids:
                self._files[camera_id] = append_to(_lines_of(folder, camera_id))
                self.counts[camera_id] = 0
        except (OSError, InputError):  # a full disk: another try must find the name free
            self.close()
            shutil.rmtree(folder, ignore_errors=True)
            raise

    @property
    def folder(self) -> Path:
        """Where the work stands until it is finished."""
        return self.dest.with_name(self.dest.name + PARTIAL)

    def add(self, camera_id: str, slot: int, time_s: float, poses: Poses2D) -> None:
        """Write what a camera saw in a slot, later than its last one.

        Args:
            camera_id: which camera.
            slot: since the recording began.
            time_s: when the frame was taken, seconds since the recording began.
            poses: the people, in the recording's skeleton.
        """
        line = encode_view(slot, time_s, poses)
        self._files[camera_id].write(line)
        self.num_bytes += len(line)
        self.counts[camera_id] += 1
        self.num_slots = max(self.num_slots, slot + 1)

    def flush(self) -> None:
        """Hand the written data to the system."""
        for file in self._files.values():
            file.flush()

    def close(self) -> None:
        """Close the files, as the end of a program does; the work stays unfinished.

        Raises:
            OSError: when the disk does not take the rest; all are closed all the same.
        """
        refused = None
        for file in self._files.values():
            try:
                file.close()
            except OSError as error:
                refused = error
        if refused is not None:
            raise refused

    def finish(self) -> Path | None:
        """End the recording and give it its name; return its folder, None if it has no view.

        On a full disk it has the views that the disk took.
        """
        try:
            self.close()
        except OSError:
            for camera_id in self.counts:
                self.counts[camera_id], _ = cut_torn(_lines_of(self.folder, camera_id))
        (self.folder / ROOM).unlink(missing_ok=True)
        if not any(self.counts.values()):
            shutil.rmtree(self.folder)
            return None
        with suppress(OSError):  # a full disk: the views are what matters
            save_processor(self.folder, self.processor)
        self._write_header(self.counts)
        os.replace(self.folder, self.dest)
        return self.dest

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, *_: object) -> None:
        if self.folder.exists():
            self.finish()

    def _write_header(self, frames: dict[str, int] | None) -> None:
        table: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSIONS[-1] if self.detector else VERSIONS[0],
            "name": self.dest.name,
            "fps": float(self.fps),
            "num_slots": self.num_slots,
            "skeleton": self.skeleton.name,
            "source": self.source,
        }
        if self.detector:
            table["detector"] = self.detector
        if frames is not None:
            table["frames"] = frames
        put_header(self.folder, table)


def finish_interrupted(folder: Path) -> list[Path]:
    """Give recordings in a folder that a kill cut off their names; return them.

    A line that was cut off is dropped. What is no such recording is left alone.
    """
    found = []
    for partial in sorted(folder.glob(f"*{PARTIAL}")):
        dest = partial.with_name(partial.name.removesuffix(PARTIAL))
        if not partial.is_dir() or dest.exists():
            continue
        try:
            table = dict(read_toml(partial / HEADER, MAX_HEADER_BYTES))
            rig = load_rig(partial / RIG)
            last, frames = -1, {}
            for camera_id in rig.camera_ids:
                frames[camera_id], line = cut_torn(_lines_of(partial, camera_id))
                last = max(last, int(json.loads(line)["slot"]) if line else -1)
        except (InputError, OSError, ValueError, KeyError, TypeError):
            continue
        if last < 0:
            shutil.rmtree(partial)
            continue
        (partial / ROOM).unlink(missing_ok=True)
        table |= {"num_slots": last + 1, "frames": frames}
        put_header(partial, table)
        os.replace(partial, dest)
        found.append(dest)
    return found


@contextmanager
def as_far_as_written(partial: Path) -> Iterator[Path | None]:
    """Yield a copy of a recording that is still being written; None if it has no view yet."""
    with TemporaryDirectory(prefix="e3pose-") as place:
        shutil.copytree(partial, Path(place) / partial.name)
        found = finish_interrupted(Path(place))
        yield found[0] if found else None


def _lines_of(folder: Path, camera_id: str) -> Path:
    return folder / "keypoints" / f"{camera_id}.jsonl"
