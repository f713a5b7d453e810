"""A reproduction run: its pieces of work, cached results, and the report."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import e3pose
from e3pose.base.installing import not_installed
from e3pose_lab.reproduce.items import ITEMS, Item, Scale
from e3pose_lab.reproduce.page import Part, write_page
from e3pose_lab.reproduce.records import Headline
from e3pose_lab.reproduce.sources import WHERE, Sources
from e3pose_lab.reproduce.work import (
    AnyPiece,
    Made,
    Results,
    code_stamp,
    failure_of,
    lacking,
    run,
)
from e3pose_lab.workers import Workers

LIBRARIES = ("numpy", "scipy", "numba", "onnxruntime", "joblib", "distributed", "matplotlib")
KEPT = "results"

Track = Callable[
    [Iterable[tuple[AnyPiece, Any]], Sequence[AnyPiece]], Iterable[tuple[AnyPiece, Any]]
]


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a run: its report, and items skipped or failed.

    Attributes:
        page: the report.
        skipped: titles of items that lack data or a library, or failed, with the reason.
        failed: whether one failed, or data could not be read.
        headlines: all of them.
    """

    page: Path
    skipped: tuple[tuple[str, str], ...]
    failed: bool
    headlines: tuple[Headline, ...]

    @property
    def wrong(self) -> list[Headline]:
        """The headline figures outside their margin."""
        return [headline for headline in self.headlines if not headline.holds]


def reproduce(
    folder: Path,
    sources: Sources,
    workers: Workers,
    *,
    quick: bool = False,
    most_seeds: int | None = None,
    items: Sequence[Item] = ITEMS,
    track: Track = lambda results, pieces: results,
) -> Outcome:
    """Compute the items and write the report, whatever fails.

    Args:
        folder: for the report; what earlier runs kept in it is used.
        sources: data sets that there are.
        workers: who computes.
        quick: few seeds and slots.
        most_seeds: of any item; as many as it asks for by default.
        items: which.
        track: wraps the results of the pieces that are not kept as they come in, for a bar.
    """
    scale = Scale(quick, sources.names, most_seeds, sources.detectors)
    lacks = {item.key: _lacks(item, scale, sources) for item in items}
    ready = [item for item in items if not lacks[item.key]]
    results = Results(folder / KEPT, sources)
    made = Made(results)
    todo = lacking(made, [piece for item in ready for piece in item.pieces(scale)])
    for piece, result in track(run(results, todo, workers), todo):
        made.add(piece, result)
    parts = [
        Part(item, None, reason) if (reason := lacks[item.key]) else _part(item, scale, made)
        for item in items
    ]
    page = write_page(folder, parts, about(sources, workers, scale), quick)
    return Outcome(
        page,
        tuple((part.item.title, part.skipped) for part in parts if part.section is None),
        any(name in sources.broken for item in items for name in item.needs)
        or any(part.section is None for part in parts if part.item in ready),
        tuple(h for part in parts if part.section is not None for h in part.section.headlines),
    )


def _part(item: Item, scale: Scale, made: Made) -> Part:
    """Return an item with its section, or with what failed."""
    if reason := made.failure(item.pieces(scale)):
        return Part(item, None, reason)
    try:
        return Part(item, item.section(scale, made))
    except Exception as error:  # the page is worth more than one item
        return Part(item, None, failure_of(item.key, error).reason)


def about(sources: Sources, workers: Workers, scale: Scale) -> dict[str, str]:
    """Return the versions, the machine and the settings of a run."""
    return {
        "e3pose": f"{e3pose.__version__}, code {code_stamp()}{_commit()}",
        "Python": sys.version.split()[0],
        **{name: found for name in LIBRARIES if (found := _version(name))},
        "machine": f"{_processor()}, {os.cpu_count()} cores, {platform.platform(terse=True)}",
        "workers": workers.dask or ("all cores" if workers.jobs == -1 else f"{workers.jobs}"),
        "data": f"{', '.join(scale.data) or 'none'} {sources.stamp}".strip(),
        "seeds": "repetition i has seed and phase i; simulated scenes have seed 1000 + i",
        "scale": ("quick" if scale.quick else "full")
        + ("" if scale.most_seeds is None else f", at most {scale.most_seeds} seeds an item"),
    }


def _lacks(item: Item, scale: Scale, sources: Sources) -> str:
    """Return the data that an item lacks, in words; empty if it has everything."""
    broken = [sources.broken[name] for name in item.needs if name in sources.broken]
    if broken:
        return broken[0]
    missing = [WHERE[name] for name in item.needs if name not in scale.data]
    if missing:
        return f"no data; expected {' and '.join(missing)}"
    absent = [name for name in item.imports if find_spec(name) is None]
    if absent:
        return not_installed(absent[0], "lab")
    return ""


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _commit() -> str:
    """Return the commit of a checkout; nothing for an installed package."""
    here = Path(e3pose.__file__).parent
    try:
        asked = ["git", "-C", str(here), "describe", "--always", "--dirty", "--abbrev=12"]
        found = subprocess.run(asked, capture_output=True, text=True, timeout=10, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return f", commit {found.stdout.strip()}" if found.returncode == 0 and found.stdout else ""


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
