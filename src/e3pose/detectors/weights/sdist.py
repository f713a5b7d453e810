"""Extract one known file from a source distribution without running it."""

from __future__ import annotations

import tarfile
import zlib
from functools import partial
from pathlib import Path

from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError
from e3pose.detectors.weights.fetch import CHUNK_BYTES, save_verified

MAX_MEMBERS = 10_000


def extract_member(archive: Path, member: str, size_bytes: int, sha256: str, dest: Path) -> Path:
    """Write one regular file of a `.tar.gz` to `dest`.

    The name inside the archive is only compared, never used as a path, and no more than
    `size_bytes` are read from it.

    Args:
        archive: the source distribution.
        member: path below the archive's one top folder.
        size_bytes: exact size expected.
        sha256: of the member, in hexadecimal.
        dest: where to write it.

    Raises:
        InputError: when the archive is damaged or lacks that very file; nothing is left at `dest`.
    """
    where = f"{archive.name}: {member}"
    try:
        with tarfile.open(archive, "r:gz") as tar:
            for count, entry in enumerate(tar):
                if count >= MAX_MEMBERS:
                    raise InputError(f"{archive.name}: found more than {MAX_MEMBERS} files")
                if entry.name.partition("/")[2] != member:
                    continue
                if not entry.isreg() or entry.size != size_bytes:
                    raise InputError(
                        f"{where}: found {entry.size} bytes, expected a file of {size_bytes}"
                    )
                source = tar.extractfile(entry)
                assert source is not None  # it is a regular file
                with atomic_file(dest) as temporary, temporary.open("wb") as file:
                    chunks = iter(partial(source.read, CHUNK_BYTES), b"")
                    save_verified(chunks, file, where, sha256, size_bytes)
                return dest
    except (tarfile.TarError, EOFError, zlib.error, OSError) as error:
        raise InputError(f"{archive.name}: not a readable .tar.gz: {error}") from None
    raise InputError(f"{archive.name}: found no {member}")
