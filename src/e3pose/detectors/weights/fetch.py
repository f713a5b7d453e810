"""Download a file with a known checksum, whole or not at all."""

from __future__ import annotations

import hashlib
import http.client
import urllib.error
import urllib.request
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any
from urllib.parse import urlsplit

from e3pose import __version__
from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError

# Called with the bytes done so far and the bytes in all, None where nobody has said.
Progress = Callable[[int, "int | None"], None]

CHUNK_BYTES = 1 << 16
TIMEOUT_S = 30.0
MAX_BYTES = 1 << 30  # of a file whose size is not known beforehand


def no_progress(done: int, total: int | None) -> None:
    """Report nothing."""


def fetch_file(
    url: str,
    sha256: str,
    dest: Path,
    progress: Progress = no_progress,
    size_bytes: int | None = None,
) -> Path:
    """Download `url` to `dest`.

    Args:
        url: http or https.
        sha256: of the file, in hexadecimal; empty if nobody knows it yet.
        dest: where to put it; folders above are made.
        progress: called with bytes done and bytes in all.
        size_bytes: exact size if known; more is never downloaded.

    Raises:
        InputError: when the server cannot be reached, stops early or sends another file; nothing is
            left at `dest` then but what was there before.
    """
    with _answer(url) as response:
        declared = response.headers.get("Content-Length", "")
        total = int(declared) if declared.isdecimal() else size_bytes
        with atomic_file(dest) as temporary, temporary.open("wb") as file:
            chunks = iter(lambda: response.read(CHUNK_BYTES), b"")
            save_verified(chunks, file, url, sha256, size_bytes, total, progress)
    return dest


def fetch_bytes(url: str, limit_bytes: int) -> bytes:
    """Return the bytes at `url`, at most `limit_bytes`; raise `InputError` as `fetch_file`."""
    with _answer(url) as response:
        content: bytes = response.read(limit_bytes + 1)
    if len(content) > limit_bytes:
        raise InputError(f"{url}: found more than the {limit_bytes} bytes expected")
    return content


@contextmanager
def _answer(url: str) -> Iterator[Any]:
    """Open `url`; whatever goes wrong until the end of the block is an `InputError`."""
    if urlsplit(url).scheme not in ("http", "https"):
        raise InputError(f"{url}: expected an http or https address")
    try:
        request = urllib.request.Request(url, headers={"User-Agent": f"e3pose/{__version__}"})
        with urllib.request.urlopen(request, timeout=TIMEOUT_S) as response:
            yield response
    except urllib.error.HTTPError as error:
        error.close()
        raise InputError(f"{url}: the server answered {error.code} {error.reason}") from None
    except (
        urllib.error.URLError,
        http.client.HTTPException,
        TimeoutError,
        ConnectionError,
    ) as error:
        reason = getattr(error, "reason", None) or error
        raise InputError(f"{url}: could not be reached or broke off ({reason})") from None


def save_verified(
    chunks: Iterable[bytes],
    file: IO[bytes],
    where: str,
    sha256: str,
    size_bytes: int | None = None,
    total: int | None = None,
    progress: Progress = no_progress,
) -> None:
    """Write chunks to `file`; raise `InputError` if they are not the file that `sha256` names.

    Args:
        chunks: the contents.
        file: open for writing bytes.
        where: they come from, for messages.
        sha256: expected, in hexadecimal; empty for any.
        size_bytes: expected, if known; reading stops where it is exceeded.
        total: what to tell `progress`.
        progress: called with bytes done and bytes in all.
    """
    digest, done = hashlib.sha256(), 0
    limit = MAX_BYTES if size_bytes is None else size_bytes
    for chunk in chunks:
        done += len(chunk)
        if done > limit:
            raise InputError(f"{where}: found more than the {limit} bytes expected")
        digest.update(chunk)
        file.write(chunk)
        progress(done, total)
    expected_bytes = total if size_bytes is None else size_bytes
    if expected_bytes is not None and done < expected_bytes:
        raise InputError(f"{where}: ended after {done} bytes, expected {expected_bytes}; try again")
    if sha256 and digest.hexdigest() != sha256:
        raise InputError(
            f"{where}: found sha256 {digest.hexdigest()}, expected {sha256}; the file was altered "
            "and has been thrown away"
        )


def file_sha256(path: Path) -> str:
    """Return the sha256 of a file in hexadecimal."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(CHUNK_BYTES):
            digest.update(chunk)
    return digest.hexdigest()
