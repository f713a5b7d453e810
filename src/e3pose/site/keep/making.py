"""Make the files of one request: those of `e3pose export`; MCAP as `e3pose stream` writes it."""

from __future__ import annotations

import heapq
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.base.errors import InputError
from e3pose.base.installing import not_installed
from e3pose.base.quantities import plural
from e3pose.estimate.smooth import SmoothSettings, smoothed
from e3pose.events.watch import begin_watch
from e3pose.model.person_event import PersonEvent
from e3pose.model.zone_event import ZoneEvent
from e3pose.output.exports import ExportSettings, export
from e3pose.output.exports.source import Asked, take_from_store
from e3pose.output.report.stored import write_stretch
from e3pose.settings.events_table import EventsTable
from e3pose.settings.resolved import ResolvedSite, resolve_site
from e3pose.site.connect import LiveSlot
from e3pose.site.keep.request import ExportRequest
from e3pose.site.stored import stored_slots
from e3pose.site.streams import Source
from e3pose.store import Store

Say = Callable[[str, float | None], None]

SENTENCE = re.compile(r"(?:Person \d+ )?(.+?)(?: \(.*\))? at \d\d:\d\d")


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


def write_mcap(
    request: ExportRequest, site: ResolvedSite, dest: Path, say: Callable[[str, float | None], None]
) -> str:
    """Write a stretch of a store; return a note about it.

    Args:
        request: the time, run and people.
        site: whose store it is.
        dest: the file to make.
        say: see `making.make`.

    Raises:
        InputError: when nobody was stored in that time, or the library is not installed.
    """
    try:
        from e3pose.site.streams.mcap import open_stream
    except ModuleNotFoundError as error:
        raise InputError(f"MCAP: {not_installed(error.name, 'foxglove')}") from None
    assert site.file.store is not None
    store = Store(site.file.store.place)
    bounds: dict[str, Any] = {
        "start": request.start_ns,
        "end": request.end_ns,
        "site": site.file.name,
        "run": request.run,
    }
    chunks = store.read(**bounds)
    slots = (
        (s.time_ns, 0, s) for _, one in stored_slots(chunks) if len(s := _chosen(one, request))
    )
    told = heapq.merge(
        (
            (row["time_ns"], 1, _zone_event(row))
            for row in _of(store.rows("zones", **bounds), request)
        ),
        ((e.time_ns, 2, e) for e in _person_events(store.rows("events", **bounds), request)),
        key=lambda timed: timed[:2],
    )
    source = Source(site.file.name, site.skeleton, site.file.fps, cameras=site.rig.camera_ids)
    watch = begin_watch(EventsTable(), site.skeleton.joints)
    stream, count = open_stream(str(dest), source), 0
    try:
        for time_ns, _, what in heapq.merge(slots, told, key=lambda timed: timed[:2]):
            if isinstance(what, LiveSlot):
                stream.slot(what)
                count += 1
                say("writing", (time_ns - request.start_ns) / (request.end_ns - request.start_ns))
            elif isinstance(what, ZoneEvent):
                stream.zone(what)
            elif isinstance(what, PersonEvent):
                stream.people(watch, [what])
    finally:
        stream.close()
    if not count:
        dest.unlink(missing_ok=True)
        raise InputError(f"{store.where}: found no poses that fit")
    return f"{plural(count, 'slot')}, metres, z up"


def _chosen(slot: LiveSlot, request: ExportRequest) -> LiveSlot:
    """Return a slot with the people who are wanted."""
    if not request.tracks:
        return slot
    return replace(slot, people=slot.people[np.isin(slot.people.track_ids, request.tracks)])


def _of(rows: list[dict[str, Any]], request: ExportRequest) -> Iterator[dict[str, Any]]:
    return (row for row in rows if not request.tracks or row["track_id"] in request.tracks)


def _zone_event(row: dict[str, Any]) -> ZoneEvent:
    return ZoneEvent(
        row["kind"], row["zone"], row["track_id"], row["count"], row["stayed_s"], row["slot"],
        row["time_ns"],
    )  # fmt: skip


def _person_events(rows: list[dict[str, Any]], request: ExportRequest) -> Iterator[PersonEvent]:
    for row in _of([row for row in rows if row["phase"] is not None], request):
        yield PersonEvent(
            row["kind"], row["phase"], row["track_id"], row["zone"] or "", row["start_ns"],
            row["time_ns"], -1, row["score"] or 0.0, _says(row["message"]),
        )  # fmt: skip


def _says(message: str) -> str:
    """Return a stored sentence without person, place and time."""
    found = SENTENCE.fullmatch(message)
    return found[1] if found else message
