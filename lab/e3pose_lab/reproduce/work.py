"""Pieces of work with results cached on disk, so that a run resumes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Generic, TypeVar, get_type_hints

import msgspec

import e3pose
import e3pose_lab
from e3pose.base.atomic import write_file
from e3pose_lab.reproduce.sources import Sources
from e3pose_lab.workers import Workers

FORMAT = "e3pose-reproduced"
VERSION = 1
# What no result depends on: what only shows it.
SHOWING = ("cli", "output", "site", "store")
SHOWING_HERE = ("__init__.py", "draw.py", "job.py", "page.py", "records.py", "time_left.py")
MOST_SAID = 300  # characters of why a piece failed
CODE = (".py", ".toml", ".onnx")

Asked = TypeVar("Asked")
Found = TypeVar("Found")


@dataclass(frozen=True, slots=True)
class Failed:
    """A piece of work that could not be done.

    Attributes:
        reason: in one line.
    """

    reason: str


@dataclass(frozen=True, slots=True)
class Piece(Generic[Asked, Found]):
    """One piece of work: a function of the sources and of settings, with nothing else in it.

    Attributes:
        function: of a module of this room, whose annotated result is a record or a plain value.
        settings: a record; what a result is kept under.
        times: whether it measures time or memory, and so runs on this machine with nothing beside.
    """

    function: Callable[[Sources, Asked], Found]
    settings: Asked
    times: bool = False

    @property
    def name(self) -> str:
        """The function, as a file can be called."""
        return f"{self.function.__module__.rpartition('.')[2]}-{self.function.__name__}"


class _Kept(msgspec.Struct):
    format: str
    version: int
    function: str
    settings: msgspec.Raw
    stamp: str
    sha256: str
    result: msgspec.Raw


AnyPiece = Piece[Any, Any]


class Results:
    """Results in a folder, one file each.

    Args:
        folder: made if need be.
        sources: what the results are of.
    """

    def __init__(self, folder: Path, sources: Sources) -> None:
        self.folder = folder
        self.sources = sources

    def path(self, piece: AnyPiece) -> Path:
        """Return where the result of a piece is kept: by its function, settings, code and data."""
        asked = msgspec.json.encode(piece.settings, order="deterministic")
        digest = hashlib.sha256(asked)
        digest.update(self._stamp(piece).encode())
        return self.folder / f"{piece.name}-{digest.hexdigest()[:16]}.json"

    def load(self, piece: AnyPiece) -> Any:
        """Return a result that was kept; raise `LookupError` if there is none or it is broken."""
        try:
            kept = msgspec.json.decode(self.path(piece).read_bytes(), type=_Kept)
            whole = hashlib.sha256(kept.result).hexdigest() == kept.sha256
            if (kept.format, kept.version, whole) == (FORMAT, VERSION, True):
                return msgspec.json.decode(kept.result, type=_result_type(piece))
        except (OSError, msgspec.DecodeError):
            pass
        raise LookupError(piece.name)

    def keep(self, piece: AnyPiece, result: Any) -> Any:
        """Keep a result, and return it as a later run will read it."""
        encoded = msgspec.json.encode(result)
        kept = _Kept(
            format=FORMAT,
            version=VERSION,
            function=f"{piece.function.__module__}.{piece.function.__name__}",
            settings=msgspec.Raw(msgspec.json.encode(piece.settings)),
            stamp=self._stamp(piece),
            sha256=hashlib.sha256(encoded).hexdigest(),
            result=msgspec.Raw(encoded),
        )
        write_file(self.path(piece), msgspec.json.encode(kept))
        return msgspec.json.decode(encoded, type=_result_type(piece))

    def _stamp(self, piece: AnyPiece) -> str:
        module = piece.function.__module__
        return f"{code_stamp()}-{module}.{piece.function.__name__}-{self.sources.stamp}"


class Made:
    """The results that were made or found, by piece.

    Args:
        results: where they are kept.
    """

    def __init__(self, results: Results) -> None:
        self.results = results
        self._found: dict[Path, Any] = {}

    def add(self, piece: AnyPiece, result: Any) -> None:
        """Take in the result of a piece, or its failure."""
        self._found[self.results.path(piece)] = result

    def failure(self, pieces: Sequence[AnyPiece]) -> str:
        """Return why the first of some pieces that failed did; empty where none has."""
        found = (self._found[self.results.path(piece)] for piece in pieces)
        return next((each.reason for each in found if isinstance(each, Failed)), "")

    def __call__(self, piece: Piece[Asked, Found]) -> Found:
        """Return the result of a piece."""
        result: Found = self._found[self.results.path(piece)]
        return result


def lacking(made: Made, pieces: Sequence[AnyPiece]) -> list[AnyPiece]:
    """Take in the results that are kept; return the other pieces, each once."""
    lacks = []
    for piece in {made.results.path(piece): piece for piece in pieces}.values():
        try:
            made.add(piece, made.results.load(piece))
        except LookupError:
            lacks.append(piece)
    return lacks


def run(
    results: Results, pieces: Sequence[AnyPiece], workers: Workers
) -> Iterator[tuple[AnyPiece, Any]]:
    """Yield every piece with its result, or `Failed`, as soon as it is there, and keep it.

    Args:
        results: where results are kept.
        pieces: those that are not kept yet, each once.
        workers: who does the work; pieces that measure time run here, after the others.
    """
    shared = [piece for piece in pieces if not piece.times]
    for place, result in workers.as_ready(_work, results.sources, shared):
        yield shared[place], _kept(results, shared[place], result)
    for piece in pieces:
        if piece.times:
            yield piece, _kept(results, piece, _work(results.sources, piece))


def _kept(results: Results, piece: AnyPiece, result: Any) -> Any:
    return result if isinstance(result, Failed) else results.keep(piece, result)


def _work(sources: Sources, piece: AnyPiece) -> Any:
    try:
        return piece.function(sources, piece.settings)
    except Exception as error:  # one item must not cost the others, which took minutes
        return failure_of(piece.name, error)


def failure_of(name: str, error: Exception) -> Failed:
    """Return a failure with its name and cause, in one line."""
    said = " ".join(str(error).split())
    return Failed(f"{name}: {type(error).__name__}: {said}"[:MOST_SAID])


def _result_type(piece: AnyPiece) -> Any:
    return get_type_hints(piece.function)["return"]


@cache
def code_stamp() -> str:
    """Return a digest of all code that a result may depend on."""
    digest = hashlib.sha256()
    for package in (e3pose, e3pose_lab):
        folder = Path(package.__path__[0])
        for path in sorted(folder.rglob("*")):
            if path.suffix in CODE and _counts(path.relative_to(folder.parent).parts):
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _counts(parts: tuple[str, ...]) -> bool:
    """Return whether results depend on a file of the packages; items only choose and show."""
    package, room, *below = parts
    if package == "e3pose_lab" and room == "reproduce":
        return below[0] not in ("items", *SHOWING_HERE)
    return room not in SHOWING
