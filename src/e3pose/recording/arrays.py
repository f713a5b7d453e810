"""Read arrays of an untrusted .npz: declared names and shapes, no pickles, bounded memory."""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from e3pose.base.bounded import open_regular
from e3pose.base.errors import InputError, reason_of

MAX_FILE_BYTES = 2 * 2**30
MAX_ARRAY_BYTES = 2 * 2**30
MAX_RATIO, FREE_BYTES = 200, 2**26  # bytes of an array for one of its file; smaller ones are free
MAX_DIRECTORY_BYTES = 10**6  # of the names in an archive: each entry takes Python ten times as much
DIRECTORY, LARGE_DIRECTORY = b"PK\5\6", b"PK\6\7"
TAIL_BYTES = 2**16 + 42

Shape = tuple[int | str, ...]

# What unpacking a zip member and parsing the text header of an .npy raise on broken bytes.
BROKEN = (
    ValueError,
    TypeError,
    KeyError,
    OSError,
    EOFError,
    RuntimeError,
    SyntaxError,
    OverflowError,
    MemoryError,
    NotImplementedError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


@contextmanager
def open_archive(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an .npz of at most `MAX_FILE_BYTES`; raise `InputError` for any other file."""
    with open_regular(path, MAX_FILE_BYTES) as file:
        file.seek(max(0, file.seek(0, 2) - TAIL_BYTES))
        tail = file.read()
        at = tail.rfind(DIRECTORY)
        size = int.from_bytes(tail[at + 12 : at + 16], "little")
        if at >= 0 and (size > MAX_DIRECTORY_BYTES or tail[at - 20 : at - 16] == LARGE_DIRECTORY):
            raise InputError(f"{path}: found too many arrays, expected some hundred at most")
        try:
            archive = zipfile.ZipFile(file)
        except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError):
            raise InputError(f"{path}: found no .npz archive, or a truncated one") from None
        yield archive


def load_arrays(path: Path, shapes: Mapping[str, Shape]) -> dict[str, NDArray[np.generic]]:
    """Load named arrays of an .npz and check that their shapes fit together.

    Args:
        path: the file.
        shapes: the arrays wanted; an axis is a length, or a name that must mean the same length
            everywhere. A name that ends in `?` marks an array that may be absent.

    Raises:
        InputError: naming the file and the array that is missing, broken, of another shape, or not
            made of numbers or text.
    """
    arrays: dict[str, NDArray[np.generic]] = {}
    lengths: dict[str, int] = {}
    with open_archive(path) as archive:
        members = {entry.filename: entry for entry in archive.infolist()}
        for key, shape in shapes.items():
            name = key.removesuffix("?")
            entry = members.get(f"{name}.npy")
            if entry is None:
                if key.endswith("?"):
                    continue
                found = ", ".join(sorted(m.removesuffix(".npy") for m in members)[:20])
                raise InputError(f"{path}: array {name!r} is missing, found {found[:300]!r}")
            try:
                most = max(FREE_BYTES, MAX_RATIO * entry.compress_size)
                if entry.file_size > most:
                    raise ValueError(
                        f"found {entry.file_size} bytes packed into {entry.compress_size}"
                    )
                with archive.open(entry) as member:
                    array = read_array(member, entry.file_size)
            except BROKEN as error:
                reason = reason_of(error)[:200]
                raise InputError(f"{path}: array {name!r}: {reason}") from None
            fits = len(array.shape) == len(shape)
            for length, axis in zip(array.shape, shape, strict=False):
                fits &= length == (
                    lengths.setdefault(axis, length) if isinstance(axis, str) else axis
                )
            if not fits:
                wanted = ", ".join(
                    str(lengths.get(a, a) if isinstance(a, str) else a) for a in shape
                )
                raise InputError(
                    f"{path}: array {name!r}: found shape {array.shape}, expected ({wanted})"
                )
            arrays[name] = array
    return arrays


def floats(path: Path, name: str, array: NDArray[np.generic], finite: bool) -> NDArray[np.float64]:
    """Return a number array as float64; raise `InputError` on text, or if `finite` on NaN."""
    if array.dtype.kind not in "fiu":
        raise InputError(f"{path}: array {name!r}: found {array.dtype}, expected numbers")
    values = array.astype(np.float64)
    if np.isinf(values).any() or (finite and np.isnan(values).any()):
        raise InputError(f"{path}: array {name!r}: found a value that is not finite")
    return values


def integers(path: Path, name: str, array: NDArray[np.generic], below: int) -> NDArray[np.int64]:
    """Return an array of whole numbers in [0, below) as int64; raise `InputError` if it is none."""
    if array.dtype.kind not in "iu":
        raise InputError(f"{path}: array {name!r}: found {array.dtype}, expected whole numbers")
    values = array.astype(np.int64)
    wrong = values[(values < 0) | (values >= below)]
    if len(wrong):
        raise InputError(f"{path}: array {name!r}: found {wrong[0]}, expected 0 to {below - 1}")
    return values


def read_array(member: IO[bytes], size: int, kinds: str = "fiuU") -> NDArray[np.generic]:
    """Read one .npy whose header may lie about its size.

    Args:
        member: where it begins.
        size: bytes that it may have.
        kinds: of its values, as numpy writes them: numbers and text by default.

    Raises:
        ValueError: or another of `BROKEN`, where it is none.
    """
    version = npy.read_magic(member)
    if version == (1, 0):
        shape, fortran, dtype = npy.read_array_header_1_0(member)
    elif version == (2, 0):
        shape, fortran, dtype = npy.read_array_header_2_0(member)
    else:
        raise ValueError(f"found .npy version {version}, expected 1.0 or 2.0")
    if dtype.hasobject or dtype.kind not in kinds:
        raise ValueError(f"found {dtype}, expected numbers{' or text' if 'U' in kinds else ''}")
    count = 1
    for length in shape:
        count *= length
    num_bytes = count * dtype.itemsize
    if not 0 <= num_bytes <= min(size, MAX_ARRAY_BYTES):
        raise ValueError(f"header promises {num_bytes} bytes, the file holds {size}")
    content = member.read(num_bytes)
    if len(content) != num_bytes:
        raise ValueError(f"found {len(content)} bytes, expected {num_bytes}")
    array = np.frombuffer(content, dtype=dtype) if count else np.zeros(0, dtype=dtype)
    return array.reshape(shape, order="F" if fortran else "C")
