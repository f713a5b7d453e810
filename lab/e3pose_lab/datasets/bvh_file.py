"""Read BVH, motion files of animation tools: a tree of joints, and numbers for each frame.

Written from the description of the format at
https://research.cs.wisc.edu/graphics/Courses/cs-838-1999/Jeff/BVH.html: a joint is its parent's
place and turn, its offset, then its own rotations in the order of its channels. The root's place is
its offset and its position channels together; of other joints, position channels stand in place of
the offset, as tools write them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError

MAX_BYTES = 500_000_000
MAX_NODES = 1000
MAX_DEPTH = 100
AXES = {"X": 0, "Y": 1, "Z": 2}
CHANNELS = tuple(f"{axis}{what}" for what in ("position", "rotation") for axis in AXES)


@dataclass(frozen=True, slots=True)
class Node:
    """A joint: its name, parent (-1: none), offset, and channels; an end site has none."""

    name: str
    parent: int
    offset: tuple[float, float, float]
    channels: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Bvh:
    """Contents of a BVH file.

    Attributes:
        nodes: parents before their children.
        interval_s: seconds per frame.
        numbers: `(num_frames, num_channels)` in the order of the nodes; the file's unit, degrees.
    """

    nodes: tuple[Node, ...]
    interval_s: float
    numbers: Floats


@dataclass(slots=True, eq=False)
class _Words:
    """The words of the header with the lines that they stand in."""

    path: Path
    words: Iterator[tuple[int, str]]
    line: int = 0
    nodes: list[Node] = field(default_factory=list)

    def next(self, expected: str) -> str:
        self.line, word = next(self.words, (self.line, ""))
        if not word:
            raise self.error("the end of the header", expected)
        return word

    def error(self, found: str, expected: str) -> InputError:
        return InputError(f"{self.path}: line {self.line}: found {found}, expected {expected}")

    def must(self, expected: str) -> None:
        word = self.next(expected)
        if word.upper() != expected:
            raise self.error(repr(word[:40]), expected)

    def number(self) -> float:
        word = self.next("a number")
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.error(repr(word[:40]), "a number")
        return value


def read_bvh(path: Path) -> Bvh:
    """Read a file.

    Raises:
        InputError: naming the line that is wrong.
    """
    try:
        text = read_bytes(path, MAX_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: found no text, expected a BVH file") from None
    lines = text.splitlines()
    begin = next((i for i, line in enumerate(lines) if line.strip().upper() == "MOTION"), None)
    if begin is None:
        raise InputError(f"{path}: found no line MOTION, expected a BVH file")
    header = ((i + 1, word) for i, line in enumerate(lines[:begin]) for word in line.split())
    words = _Words(path, header)
    words.must("HIERARCHY")
    words.must("ROOT")
    _read_node(words, -1, 0)
    extra = next(words.words, None)
    if extra is not None:
        words.line = extra[0]
        raise words.error(repr(extra[1][:40]), "one ROOT, then MOTION: one person per file")
    return _with_motion(words, lines, begin)


def _read_node(words: _Words, parent: int, depth: int) -> None:
    name = words.next("the name of a joint")
    words.must("{")
    words.must("OFFSET")
    offset = words.number(), words.number(), words.number()
    words.must("CHANNELS")
    count = words.number()
    if count not in range(7):
        raise words.error(f"{count:g} channels", "0 to 6")
    channels = tuple(words.next("a channel").capitalize() for _ in range(int(count)))
    for channel in channels:
        if channel not in CHANNELS:
            raise words.error(repr(channel[:40]), f"one of {', '.join(CHANNELS)}")
    if len(set(channels)) < len(channels):
        raise words.error("a channel twice", "each once")
    index = _add(words, Node(name, parent, offset, channels), depth)
    while (word := words.next("}").upper()) != "}":
        if word == "JOINT":
            _read_node(words, index, depth + 1)
        elif word == "END":
            words.must("SITE")
            words.must("{")
            words.must("OFFSET")
            offset = words.number(), words.number(), words.number()
            _add(words, Node(f"{name} end", index, offset), depth + 1)
            words.must("}")
        else:
            raise words.error(repr(word[:40]), "JOINT, End Site or }")


def _add(words: _Words, node: Node, depth: int) -> int:
    if len(words.nodes) >= MAX_NODES or depth > MAX_DEPTH:
        raise words.error("more joints", f"at most {MAX_NODES}, {MAX_DEPTH} deep")
    words.nodes.append(node)
    return len(words.nodes) - 1


def _with_motion(words: _Words, lines: list[str], begin: int) -> Bvh:
    """Read the numbers after the line MOTION."""
    values = dict.fromkeys(("Frames:", "Frame Time:"), math.nan)
    for index, key in enumerate(values):
        words.line = begin + 2 + index
        line = lines[begin + 1 + index].strip() if begin + 1 + index < len(lines) else ""
        head, _, value = line.partition(":")
        if f"{head}:".upper() != key.upper():
            raise words.error(repr(line[:40]), key)
        try:
            values[key] = float(value)
        except ValueError:
            raise words.error(repr(value.strip()[:40]), "a number") from None
    frames, interval_s = values.values()
    if not 0 < interval_s <= 10:
        raise words.error(f"{interval_s:g} s per frame", "more than 0 and at most 10 s")
    width = sum(len(node.channels) for node in words.nodes)
    rows = [(i + 1, line) for i, line in enumerate(lines) if i > begin + 2 and line.strip()]
    if frames != len(rows) or not rows:
        words.line = begin + 2
        raise words.error(f"{frames:g} frames, and {len(rows)} lines of numbers", "as many")
    numbers = np.empty((len(rows), width))
    for row, (words.line, line) in enumerate(rows):
        try:
            numbers[row] = np.array(line.split(), dtype=np.float64)
        except ValueError:
            found = f"{len(line.split())} words"
            raise words.error(found, f"{width} numbers, as many as there are channels") from None
        if not np.isfinite(numbers[row]).all():
            raise words.error("a number that is not finite", "numbers")
    return Bvh(tuple(words.nodes), interval_s, numbers)


def places_of(bvh: Bvh) -> Floats:
    """Return `(num_frames, num_nodes, 3)` places of joints, in the unit and axes of the file."""
    frames = len(bvh.numbers)
    places = np.zeros((frames, len(bvh.nodes), 3))
    turns = np.zeros((frames, len(bvh.nodes), 3, 3))
    column = 0
    for index, node in enumerate(bvh.nodes):
        own = np.broadcast_to(np.eye(3), (frames, 3, 3))
        local = np.tile(np.array(node.offset), (frames, 1))
        for channel in node.channels:
            axis, value = AXES[channel[0]], bvh.numbers[:, column]
            column += 1
            if channel.endswith("rotation"):
                own = own @ _about(axis, np.radians(value))
            elif node.parent < 0:
                local[:, axis] += value
            else:
                local[:, axis] = value
        if node.parent < 0:
            places[:, index], turns[:, index] = local, own
        else:
            before = turns[:, node.parent]
            places[:, index] = places[:, node.parent] + np.einsum("fij,fj->fi", before, local)
            turns[:, index] = before @ own
    return places


def _about(axis: int, angle: Floats) -> Floats:
    """Return `(num_frames, 3, 3)` rotations about an axis."""
    turn = np.tile(np.eye(3), (len(angle), 1, 1))
    second, third = (axis + 1) % 3, (axis + 2) % 3
    turn[:, second, second] = turn[:, third, third] = np.cos(angle)
    turn[:, third, second] = np.sin(angle)
    turn[:, second, third] = -np.sin(angle)
    return turn
