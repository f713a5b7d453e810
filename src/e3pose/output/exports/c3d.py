"""C3D, binary marker files of motion capture: z up, everybody in one file.

Points are labelled `track7:left_wrist`, as programs that know subjects do. The residual says where
a point comes from, as the format has it: -1 for missing, 0 for one that no view of the frame
measured (predicted or filled), else what it may be off by, here its standard deviation in whole
millimetres from 1 to 127.

ezc3d writes header and parameters, of one frame; all frames are appended in pieces as the C3D User
Guide describes them (https://www.c3d.org/docs/C3D_User_Guide.pdf), so that memory stays bounded.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError
from e3pose.model.take import MEASURED, MISSING, Take
from e3pose.output.exports.base import PER_METRE, ExportSettings, person_name

MAX_FRAMES = 65_535  # of the 16 bits of the format; what readers agree on ends there
MAX_RESIDUAL = 127  # of its 7 bits
RESIDUAL_M = 0.001  # of one of them
BLOCK_BYTES = 512
CHUNK_FRAMES = 500
LAST_FRAME, SCALE = 8, 12  # where the header has them


def write_c3d(take: Take, dest: Path, settings: ExportSettings) -> str:
    """Write all people of a take; frame 1 is the first of the take."""
    units = settings.units or "mm"
    first, stop = take.span
    if stop - first > MAX_FRAMES:
        raise InputError(
            f"{dest}: found {stop - first} frames, expected at most {MAX_FRAMES}: ask for a "
            "shorter time, or fewer frames per second (--fps)"
        )
    num_points = len(take.motions) * len(take.skeleton)
    with atomic_file(dest, private=True) as temporary:
        _write_head(take, units, temporary)
        head = _for_frames(temporary.read_bytes(), stop - first, num_points, units)
        with temporary.open("wb") as file:
            file.write(head)
            for begin in range(first, stop, CHUNK_FRAMES):
                end = min(begin + CHUNK_FRAMES, stop)
                file.write(_frames(take, begin, end, PER_METRE[units]).tobytes())
            file.write(bytes(-file.tell() % BLOCK_BYTES))
    return f"{units}, z up, {num_points} points"


def _write_head(take: Take, units: str, dest: Path) -> None:
    """Write a file of one frame, with all labels."""
    import ezc3d

    names = [person_name(motion.track_id) for motion in take.motions]
    labels = [f"{name}:{joint}" for name in names for joint in take.skeleton.joints]
    file = ezc3d.c3d()
    file["header"]["points"]["first_frame"] = 0  # counted from 0 here, from 1 in the file
    parameters = file["parameters"]
    parameters["POINT"]["RATE"]["value"] = [take.fps]
    parameters["POINT"]["UNITS"]["value"] = [units]
    parameters["POINT"]["LABELS"]["value"] = labels
    file.add_parameter("SUBJECTS", "USED", len(names))
    file.add_parameter("SUBJECTS", "USES_PREFIXES", 1)
    file.add_parameter("SUBJECTS", "NAMES", names)
    file.add_parameter("SUBJECTS", "LABEL_PREFIXES", [f"{name}:" for name in names])
    file.add_parameter("E3POSE", "START_S", [take.span[0] * take.interval_s])
    file["data"]["points"] = np.ones((4, len(labels), 1))
    file.write(str(dest))


def _for_frames(content: bytes, frames: int, points: int, units: str) -> bytes:
    """Return header and parameters of a file of one frame for so many of them."""
    places = _parameters(content)
    first_block = struct.unpack_from("<H", content, places["POINT", "DATA_START"])[0]
    data = (first_block - 1) * BLOCK_BYTES
    head = bytearray(content[:data])
    scale = -RESIDUAL_M * PER_METRE[units]  # negative: places are floats, residuals its multiples
    struct.pack_into("<H", head, LAST_FRAME, frames)
    struct.pack_into("<f", head, SCALE, scale)
    struct.pack_into("<H", head, places["POINT", "FRAMES"], frames)
    struct.pack_into("<f", head, places["POINT", "SCALE"], scale)
    if ("ROTATION", "DATA_START") in places:  # of data that is not there: behind the points
        blocks = -(-frames * points * 16 // BLOCK_BYTES)
        after = min(first_block + blocks, MAX_FRAMES)
        struct.pack_into("<H", head, places["ROTATION", "DATA_START"], after)
    return bytes(head)


def _parameters(content: bytes) -> dict[tuple[str, str], int]:
    """Return where the values of parameters begin, by group and name."""
    at = (content[0] - 1) * BLOCK_BYTES + 4
    groups: dict[int, str] = {}
    found: list[tuple[int, str, int]] = []
    while content[at]:
        length, group = struct.unpack_from("<bb", content, at)
        name = content[at + 2 : at + 2 + abs(length)].decode("ascii")
        at += 2 + abs(length)
        (to_next,) = struct.unpack_from("<H", content, at)
        if group < 0:
            groups[-group] = name
        else:
            found.append((group, name, at + 4 + content[at + 3]))  # behind type and dimensions
        at += to_next
    return {(groups[group], name): place for group, name, place in found}


def _frames(take: Take, begin: int, end: int, scale: float) -> NDArray[np.float32]:
    """Return `(num_frames, num_people, num_joints, 4)`: places in the file's units, residuals."""
    shape = end - begin, len(take.motions), len(take.skeleton), 4
    made = np.zeros(shape, dtype="<f4")
    made[..., 3] = -1.0
    for person, motion in enumerate(take.motions):
        first, stop = max(begin, motion.first), min(end, motion.first + len(motion))
        if first >= stop:
            continue
        rows = slice(first - motion.first, stop - motion.first)
        here = made[first - begin : stop - begin, person]
        origin = motion.origin[rows]
        here[..., :3] = np.where(origin[..., None] == MISSING, 0.0, scale * motion.joints_m[rows])
        steps = np.nan_to_num(motion.sigma_m[rows], nan=0.0) / RESIDUAL_M
        measured = np.clip(np.rint(steps), 1, MAX_RESIDUAL) * 256  # in the upper byte of the word
        here[..., 3] = np.select([origin == MISSING, origin == MEASURED], [-1.0, measured], 0.0)
    return made
