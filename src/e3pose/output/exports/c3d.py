"""C3D, binary marker files of motion capture: z up, everybody in one file.

Points are labelled `track7:left_wrist`, as programs that know subjects do. The residual says where
a point comes from, as the format has it: -1 for missing, 0 for one that no view of the frame
measured (predicted or filled), else what it may be off by, here its standard deviation in whole
millimetres from 1 to 127.

Header, parameters and frames are as the C3D User Guide describes them
(https://www.c3d.org/docs/C3D_User_Guide.pdf). Frames are written in pieces, so that memory stays
bounded.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
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
INTEL, PARAMETERS_AT = 84, 2  # the order of bytes; the block, counted from 1, after the header
MAX_GAP = 10  # frames that readers may interpolate
MAX_LENGTH = 255  # of a dimension, and of the blocks of parameters
TEXT, INTEGER, REAL = -1, 2, 4  # types of parameters
Value = int | float | str | list[str]


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
    scale = -RESIDUAL_M * PER_METRE[units]  # negative: places are floats, residuals its multiples
    head = _head(take, units, scale)
    with atomic_file(dest, private=True) as temporary, temporary.open("wb") as file:
        file.write(head)
        for begin in range(first, stop, CHUNK_FRAMES):
            end = min(begin + CHUNK_FRAMES, stop)
            file.write(_frames(take, begin, end, PER_METRE[units]).tobytes())
        file.write(bytes(-file.tell() % BLOCK_BYTES))
    return f"{units}, z up, {num_points} points"


def _head(take: Take, units: str, scale: float) -> bytes:
    """Return header and parameters, in whole blocks."""
    first, stop = take.span
    names = [person_name(motion.track_id) for motion in take.motions]
    labels = [f"{name}:{joint}" for name in names for joint in take.skeleton.joints]
    point: dict[str, Value] = {
        "USED": len(labels), "SCALE": scale, "RATE": float(take.fps), "DATA_START": 0,
        "FRAMES": stop - first, "UNITS": units, "LABELS": labels,
    }  # fmt: skip
    groups: dict[str, dict[str, Value]] = {
        "POINT": point,
        "ANALOG": {"USED": 0},
        "FORCE_PLATFORM": {"USED": 0},
        "SUBJECTS": {
            "USED": len(names), "USES_PREFIXES": 1,
            "NAMES": names, "LABEL_PREFIXES": [f"{name}:" for name in names],
        },
        "E3POSE": {"START_S": float(first * take.interval_s)},
    }  # fmt: skip
    blocks = -(-len(_parameters(groups, 0)) // BLOCK_BYTES)
    if blocks > MAX_LENGTH:
        raise InputError(
            f"C3D: found {len(names)} people, expected fewer: ask for some (--track), or less time"
        )
    point["DATA_START"] = PARAMETERS_AT + blocks
    header = struct.pack(
        "<BBHHHHHfHHf",
        *(PARAMETERS_AT, 0x50, len(labels), 0, 1, stop - first, MAX_GAP),
        *(scale, PARAMETERS_AT + blocks, 0, take.fps),
    )
    parameters = _parameters(groups, blocks)
    return header.ljust(BLOCK_BYTES, b"\0") + parameters.ljust(blocks * BLOCK_BYTES, b"\0")


def _parameters(groups: dict[str, dict[str, Value]], blocks: int) -> bytes:
    """Return the section of parameters, of so many blocks."""
    found = [bytes((1, 0x50, blocks % 256, INTEL))]
    for number, (group, values) in enumerate(groups.items(), start=1):
        found.append(_entry(group, -number, b""))
        for name, value in values.items():
            found += [_entry(key, number, data) for key, data in _encoded(name, value)]
    return b"".join(found) + b"\0"


def _entry(name: str, number: int, data: bytes) -> bytes:
    """Return a group, of a negative number, or a parameter; the description is empty."""
    head = struct.pack("<bb", len(name), number) + name.encode("ascii")
    return head + struct.pack("<H", 2 + len(data) + 1) + data + b"\0"


def _encoded(name: str, value: Value) -> Iterator[tuple[str, bytes]]:
    """Yield name, and type, dimensions and data of a value; a long list continues as `NAME2`."""
    if isinstance(value, list):
        texts = [text.encode("ascii") for text in value]
        width = max(map(len, texts), default=0)
        for start in range(0, max(1, len(texts)), MAX_LENGTH):
            part = texts[start : start + MAX_LENGTH]
            data = b"".join(text.ljust(width) for text in part)
            number = start // MAX_LENGTH + 1
            yield name + str(number) * (number > 1), _typed(TEXT, (width, len(part)), data)
    elif isinstance(value, str):
        yield name, _typed(TEXT, (len(value),), value.encode("ascii"))
    elif isinstance(value, float):
        yield name, _typed(REAL, (), struct.pack("<f", value))
    else:
        yield name, _typed(INTEGER, (), struct.pack("<H", value))


def _typed(kind: int, shape: Sequence[int], data: bytes) -> bytes:
    return struct.pack("<bB", kind, len(shape)) + bytes(shape) + data


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
