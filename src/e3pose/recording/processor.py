"""Measured processor time of the cameras of a recording: the file `processor.toml` beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import tomli_w

from e3pose.base.errors import InputError
from e3pose.base.table import read_file

FILE = "processor.toml"
FORMAT = "e3pose-processor"
MAX_BYTES = 2**20
MAX_S = 1e4


@dataclass(frozen=True, slots=True)
class ProcessorTime:
    """The processor time of a camera's program, all threads together.

    Attributes:
        look_s: processor seconds of a look, mean.
        frame_s: of a frame with all else that the program does, mean.
        looks: that were measured.
    """

    look_s: float
    frame_s: float
    looks: int


class _File(msgspec.Struct, forbid_unknown_fields=True):
    format: Literal["e3pose-processor"]
    version: Literal[1]
    cameras: dict[str, ProcessorTime]


def save_processor(folder: Path, cameras: Mapping[str, ProcessorTime]) -> None:
    """Write what the cameras of the recording in `folder` took; no file where nobody was measured.

    Args:
        folder: of the recording.
        cameras: by id; those that were not measured are left out.
    """
    if not cameras:
        return
    rows = {
        camera_id: {
            "look_s": round(time.look_s, 6),
            "frame_s": round(time.frame_s, 6),
            "looks": time.looks,
        }
        for camera_id, time in cameras.items()
    }
    table = {"format": FORMAT, "version": 1, "cameras": rows}
    (folder / FILE).write_bytes(tomli_w.dumps(table).encode())


def load_processor(folder: Path, camera_ids: tuple[str, ...]) -> dict[str, ProcessorTime]:
    """Return the processor time of cameras, by id; empty where no file has it.

    Args:
        folder: of the recording.
        camera_ids: of its rig.

    Raises:
        InputError: when the file is there but broken, or of another rig.
    """
    path = folder / FILE
    if not path.is_file():
        return {}
    found = read_file(_File, path, MAX_BYTES).cameras
    for camera_id, time in found.items():
        if camera_id not in camera_ids:
            known = ", ".join(camera_ids)
            what = f"found camera {camera_id[:64]!r}, expected one of {known}"
            raise InputError(f"{path}: cameras: {what}")
        if not (0 <= time.look_s <= MAX_S and 0 <= time.frame_s <= MAX_S and time.looks > 0):
            raise InputError(
                f"{path}: cameras.{camera_id}: found {time.look_s}, {time.frame_s} s and "
                f"{time.looks} looks, expected 0 to {MAX_S:g} s and 1 look or more"
            )
    return found
