"""The files beside an ONNX file that hold its weights, and whether they may be read.

Not every version of ONNX Runtime refuses paths that leave the folder.
"""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from pathlib import Path, PurePosixPath, PureWindowsPath

from e3pose.base.errors import InputError
from e3pose.detectors.onnx_bytes import fields_of, mapped

# Fields that lead from a model to its tensors: numbers of `onnx.proto`, by the message they are in.
INTO = {
    "model": {7: "graph", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {13: "entry"},
    "entry": {1: "text", 2: "text"},
}
MAX_DEPTH = 100


def check_external_data(path: Path) -> None:
    """Raise `InputError` where weights are to be read from a file that is not in the folder."""
    with mapped(path) as content:
        try:
            named = sorted(set(_locations(content, 0, len(content), "model", 0)))
        except (IndexError, RecursionError):
            return  # no such file: ONNX Runtime says what is wrong with it
    for location in named:
        _check_location(path, location)


def _check_location(path: Path, location: str) -> None:
    name = repr(location[:80])
    parts = PurePosixPath(location).parts + PureWindowsPath(location).parts
    absolute = PurePosixPath(location).is_absolute() or PureWindowsPath(location).is_absolute()
    folder = path.parent.resolve()
    if absolute or ".." in parts or "\0" in location:
        inside = False
    else:
        inside = (folder / location).resolve().is_relative_to(folder)
    if not inside:
        raise InputError(f"{path}: weights: found the file {name}, expected one in its folder")
    if not (folder / location).is_file():
        raise InputError(f"{path}: weights: found no file {name} beside it, expected its weights")


def _locations(content: mmap.mmap, begin: int, end: int, kind: str, depth: int) -> Iterator[str]:
    """Yield the locations of the tensors in a message from byte `begin` to `end`."""
    if depth > MAX_DEPTH:
        raise RecursionError
    if kind == "entry":
        fields = {number: content[a:b] for number, a, b in fields_of(content, begin, end)}
        if fields.get(1) == b"location":
            yield fields.get(2, b"").decode(errors="replace")
        return
    for number, first, stop in fields_of(content, begin, end):
        inner = INTO[kind].get(number)
        if inner is not None:
            yield from _locations(content, first, stop, inner, depth + 1)
