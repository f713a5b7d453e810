"""Make the files of one request: those of `e3pose export`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.estimate.smooth import SmoothSettings, smoothed
from e3pose.output.exports import ExportSettings, export
from e3pose.output.exports.source import Asked, take_from_store
from e3pose.output.report.stored import write_stretch
from e3pose.settings.resolved import resolve_site
from e3pose.site.keep.mcap import write_mcap
from e3pose.site.keep.request import ExportRequest
from e3pose.store import Store

Say = Callable[[str, float | None], None]


def make(request: ExportRequest, site_file: Path, folder: Path, say: Say) -> tuple[list[str], str]:
    """Make the files of a request in a folder; return their names and a note.

    Args:
        request: what is wanted.
        site_file: of the site.
        folder: that the files are made in.
        say: called with what is being done, and how much of it is, [0, 1]; None if unknown.

    Raises:
        InputError: when nothing is stored, or the form cannot hold it.
        OSError: when the disk takes no more.
    """
    site = resolve_site(site_file)
    if site.file.store is None:
        raise InputError("the site stores nothing: add [store] to its site file")
    smoothing = SmoothSettings("rts" if request.smooth else None)
    dest = folder / request.file_name
    say("reading", None)
    if request.form == "report":
        store = Store(site.file.store.place)
        slots = write_stretch(site, store, dest, request.start_ns, request.end_ns, smoothing)
        return [dest.name], plural(slots, "slot")
    if request.form == "mcap":
        return [dest.name], write_mcap(request, site, dest, say)

    def progress(items: Iterable[Any], total: int, label: str) -> Iterator[Any]:
        for done, item in enumerate(items):
            say(label, done / max(total, 1))
            yield item

    asked = Asked(request.start_ns, request.end_ns, request.tracks, site.file.name, request.run)
    take = take_from_store(str(site.file.store.place), asked)
    if smoothing.method is not None:
        take = smoothed(take, smoothing, progress)
    settings = ExportSettings(layout="wide", progress=progress)
    made = list(export(take, dest, request.form, settings))
    notes = [note for _, note in made if note]
    return [path.name for path, _ in made], notes[0] if len(set(notes)) == 1 else ""
