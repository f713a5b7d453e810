"""Files of bounded size: read untrusted ones, with JSON and TOML in them, and count bytes."""

from __future__ import annotations

import os
import re
import stat
import sys
from collections.abc import Collection, Iterator
from contextlib import suppress
from importlib import resources
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import msgspec

from e3pose.base.errors import InputError, reason_of
from e3pose.base.system import NO_LINK

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

T = TypeVar("T")

# What msgspec raises for content that is not what was expected.
UNDECODABLE = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)
MAX_LINE_BYTES = 16 * 2**20
MAX_DOTS = 100  # of a line of TOML, outside strings
TOML_STRING = re.compile(r'"(?:[^"\\]|\\.)*"|\'[^\']*\'')


def bytes_of(path: Path) -> int:
    """Return the bytes of a file, or of all files in a folder; deleted ones count none."""
    total = 0
    for file in path.rglob("*") if path.is_dir() else (path,):
        with suppress(OSError):  # deleted meanwhile
            total += file.stat().st_size if file.is_file() else 0
    return total


def open_regular(path: Path, limit_bytes: int, links: bool = True) -> BinaryIO:
    """Open a regular file for reading bytes, with `links` also through a symbolic link.

    Raises:
        InputError: when `path` is missing, no regular file (a pipe would wait for ever, a device
            never ends), larger than `limit_bytes`, or not readable.
    """
    try:
        status = path.stat(follow_symlinks=links)
    except FileNotFoundError:
        raise InputError(f"{path}: file not found") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{str(path)[:300]!r}: cannot be read ({reason_of(error)})") from None
    if not stat.S_ISREG(status.st_mode):
        found = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe, socket or device"
        found = "a link" if stat.S_ISLNK(status.st_mode) else found
        raise InputError(f"{path}: found {found}, expected a file")
    if status.st_size > limit_bytes:
        raise InputError(f"{path}: found {status.st_size} bytes, expected at most {limit_bytes}")
    try:
        flags = 0 if links else NO_LINK
        return open(path, "rb", opener=lambda name, usual: os.open(name, usual | flags))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({reason_of(error)})") from None


def read_bytes(path: Path, limit_bytes: int, links: bool = True) -> bytes:
    """Return the whole content of a regular file of at most `limit_bytes`; see `open_regular`.

    Raises:
        InputError: for anything else, or a file that grows while it is read.
    """
    with open_regular(path, limit_bytes, links) as file:
        content = file.read(limit_bytes + 1)
    if len(content) > limit_bytes:
        raise InputError(f"{path}: grew while it was read, expected at most {limit_bytes} bytes")
    return content


def read_lines(path: Path, limit_bytes: int) -> Iterator[tuple[int, bytes]]:
    """Yield `(line number from 1, line without its newline)` of a regular file of bounded lines.

    Raises:
        InputError: for anything else, or a line beyond `MAX_LINE_BYTES`.
    """
    with open_regular(path, limit_bytes) as file:
        number = 0
        while line := file.readline(MAX_LINE_BYTES + 1):
            number += 1
            if len(line) > MAX_LINE_BYTES:
                raise InputError(
                    f"{path}:{number}: line is longer than {MAX_LINE_BYTES} bytes, "
                    "expected one frame a line"
                )
            yield number, line.rstrip(b"\r\n")


def decode_json(kind: type[T], content: bytes | msgspec.Raw, where: object, expected: str) -> T:
    """Return the content of a whole file of JSON.

    Args:
        kind: of what it holds.
        content: of the file.
        where: it is, for errors.
        expected: content, in words.

    Raises:
        InputError: for anything else.
    """
    try:
        return msgspec.json.decode(content, type=kind)
    except UNDECODABLE as error:
        found = reason_of(error)[:200] if bytes(content).strip() else "an empty file"
        raise InputError(f"{where}: {found}, expected {expected}") from None


def read_toml(path: Path, limit_bytes: int) -> dict[str, Any]:
    """Return the tables of a TOML file of at most `limit_bytes`; raise `InputError` if it is none.

    Raises:
        InputError: naming the file and what is wrong with it.
    """
    content = read_bytes(path, limit_bytes)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: found {error.reason} at byte {error.start}, expected TOML"
        ) from None
    return parse_toml(text, str(path))


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Return the tables of TOML text; raise `InputError`, which names `where`, if it is none."""
    # Dotted keys take the parser time with the square of their parts, or the cube.
    for number, line in enumerate(text.splitlines(), start=1):
        if line.count(".") > MAX_DOTS and TOML_STRING.sub("", line).count(".") > MAX_DOTS:
            raise InputError(f"{where}: line {number}: found more than {MAX_DOTS} dots")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        reason = reason_of(error)[:200]
        raise InputError(f"{where}: found text that is not TOML: {reason}") from None


def read_shipped(
    name_or_path: str | Path, package: str, names: Collection[str], what: str, limit_bytes: int
) -> tuple[dict[str, Any], str]:
    """Return the tables of a TOML file, and how to name it to a person.

    Args:
        name_or_path: one of `names`, or a path.
        package: that has the files of these names, `e3pose.energy.profiles`.
        names: of the files that come with the package, without `.toml`.
        what: they are, in words.
        limit_bytes: the most that is read of a file of the user.

    Raises:
        InputError: when there is no such file, or it is no TOML.
    """
    name = str(name_or_path)
    if name in names:
        text = resources.files(package).joinpath(f"{name}.toml").read_text(encoding="utf-8")
        where = f"{what} {name}"
        return parse_toml(text, where), where
    path = Path(name_or_path)
    if not path.is_file():
        raise InputError(
            f"{name[:200] or repr(name)}: {what}: no such file, "
            f"expected {', '.join(names)} or the path of a TOML file"
        )
    return read_toml(path, limit_bytes), str(path)
