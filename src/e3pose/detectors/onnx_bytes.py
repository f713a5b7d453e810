"""Read ONNX files as bytes (protobuf): cameras have no library for the format."""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
GRAPH, NODE = 7, 1  # of a model, of a graph
INPUT, OUTPUT, OPERATOR = 1, 2, 4  # of a node
GRAPH_INPUT, NAME = 11, 1
UNCHANGED = ("Cast", "Identity")  # operators that hand an image on as it is


@contextmanager
def mapped(path: Path) -> Iterator[mmap.mmap]:
    """Yield the bytes of a file without reading all of them."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        yield content


def first_operators(path: Path) -> frozenset[str]:
    """Return the operators that the image goes through first, such as `Conv`.

    Empty where the file is no such network, or does not look at its image.
    """
    with mapped(path) as content:
        try:
            return _first_operators(content)
        except IndexError:
            return frozenset()


def _first_operators(content: mmap.mmap) -> frozenset[str]:
    graph = next(span for number, *span in fields_of(content, 0, len(content)) if number == GRAPH)
    images: set[bytes] = set()
    nodes: list[tuple[set[bytes], set[bytes], str]] = []
    for number, begin, end in fields_of(content, *graph):
        if number == GRAPH_INPUT:
            images.update(content[a:b] for n, a, b in fields_of(content, begin, end) if n == NAME)
        elif number == NODE:
            parts = list(fields_of(content, begin, end))
            read = {content[a:b] for n, a, b in parts if n == INPUT}
            made = {content[a:b] for n, a, b in parts if n == OUTPUT}
            kind = next((content[a:b] for n, a, b in parts if n == OPERATOR), b"")
            nodes.append((read, made, kind.decode(errors="replace")))
    found = set()
    for read, made, operator in nodes:  # in the order in which they run
        if read & images:
            if operator in UNCHANGED:
                images |= made
            else:
                found.add(operator)
    return frozenset(found)


def fields_of(content: mmap.mmap, at: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield number, begin and end of each field of a message that holds bytes.

    Args:
        content: the file.
        at: where the message begins.
        end: where it ends.

    Raises:
        IndexError: where this is no such message.
    """
    while at < end:
        key, at = _varint(content, at)
        wire = key & 7
        if wire == VARINT:
            _, at = _varint(content, at)
        elif wire in (FIXED64, FIXED32):
            at += 8 if wire == FIXED64 else 4
        elif wire == BYTES:
            size, at = _varint(content, at)
            if at + size > end:
                raise IndexError
            yield key >> 3, at, at + size
            at += size
        else:
            raise IndexError


def _varint(content: mmap.mmap, at: int) -> tuple[int, int]:
    value = shift = 0
    while shift < 64:
        byte = content[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
    raise IndexError
