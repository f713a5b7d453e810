"""The origin of a recording's detections: the file `detection.toml` beside it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec
import tomli_w

from e3pose.base.bounded import read_toml
from e3pose.base.errors import InputError
from e3pose.settings.limits import Rotation

FILE = "detection.toml"
MAX_BYTES = 2**20


class Provenance(msgspec.Struct, frozen=True):
    """The origin of a recording's detections.

    Attributes:
        settings: what decided its content, by name.
        video_starts_s: for each camera, which time in its video is the recording's zero.
        rotations: for each camera that is turned, by how many degrees clockwise its images were
            turned for the detector.
        as_stored: whether the turn that videos ask players for was ignored.
    """

    settings: dict[str, str] = {}
    video_starts_s: dict[str, float] = {}
    rotations: dict[str, Rotation] = {}
    as_stored: bool = False


def save_provenance(
    folder: Path,
    settings: Mapping[str, str],
    video_starts_s: Mapping[str, float],
    rotations: Mapping[str, int] | None = None,
    as_stored: bool = False,
) -> None:
    """Write how the recording in `folder` was detected, see `Provenance`."""
    table: dict[str, object] = {"settings": dict(settings), "video_starts_s": dict(video_starts_s)}
    if rotations:
        table["rotations"] = dict(rotations)
    if as_stored:
        table["as_stored"] = True
    (folder / FILE).write_bytes(tomli_w.dumps(table).encode())


def load_provenance(folder: Path) -> Provenance:
    """Return how the recording in `folder` was detected; empty if unknown.

    Raises:
        InputError: when the file is there but broken.
    """
    path = folder / FILE
    if not path.is_file():
        return Provenance()
    try:
        found = msgspec.convert(read_toml(path, MAX_BYTES), Provenance)
    except msgspec.ValidationError as error:
        raise InputError(f"{path}: {str(error)[:200]}") from None
    for camera_id, start_s in found.video_starts_s.items():
        if not abs(start_s) <= 1e8:
            raise InputError(
                f"{path}: video_starts_s: {camera_id}: found {start_s}, expected seconds"
            )
    return found
