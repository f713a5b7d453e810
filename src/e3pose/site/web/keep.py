"""The part of the API for clips, files made of the store, and recordings."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, HTTPException, Query, Request
from fastapi.responses import FileResponse
from pydantic import Field

from e3pose.base.errors import InputError, reason_of
from e3pose.base.quantities import plural
from e3pose.output.archive.deleting import delete_everywhere
from e3pose.site.keep.jobs import KEPT_S, Jobs
from e3pose.site.keep.recordings import kept_recordings, remove_recording
from e3pose.site.keep.request import FORMS, MOST_TRACKS, ExportRequest
from e3pose.site.web.api import LARGEST, REFUSALS, asked
from e3pose.site.web.control import REFUSALS as CONTROL_REFUSALS
from e3pose.site.web.control import Changes, Done
from e3pose.store.clips import (
    LAST_NS,
    MAX_NAME,
    MAX_NOTE,
    Clip,
    change_clip,
    clips_of,
    keep_clip,
    remove_clip,
)
from e3pose.store.forgetting import Forgotten

Nanoseconds = Annotated[int, Field(ge=0, le=LAST_NS)]
Name = Annotated[str, Field(min_length=1, max_length=MAX_NAME)]
Note = Annotated[str, Field(max_length=MAX_NOTE)]


class NewClip(Changes):
    """A stretch to be kept in mind."""

    name: Name
    start_ns: Nanoseconds
    end_ns: Nanoseconds
    note: Note = ""


class ClipChanges(Changes):
    """Another name or note; None stays."""

    name: Name | None = None
    note: Note | None = None


class NewJob(Changes):
    """Files to be made of a stretch."""

    form: Annotated[str, Field(max_length=20, description=", ".join(FORMS))]
    name: Name
    start_ns: Nanoseconds
    end_ns: Nanoseconds
    tracks: Annotated[
        list[Annotated[int, Field(ge=0, le=LARGEST)]], Field(max_length=MOST_TRACKS)
    ] = []  # noqa: RUF012
    run: Annotated[int | None, Field(ge=0, le=LARGEST)] = None
    smooth: bool = False


@dataclass(frozen=True, slots=True)
class Keeping:
    """Store, jobs and recordings of the routes.

    Attributes:
        place: the store; None where nothing is stored.
        site: whose clips.
        jobs: that make files; None where they cannot.
        recordings: folder of the site's recordings.
        log: called with a line about what operators did.
    """

    place: str | Path | None
    site: str
    jobs: Jobs | None = None
    recordings: Path | None = None
    log: Callable[[str], object] = lambda line: None


def make_keep(keep: Keeping) -> APIRouter:
    """Return the routes."""
    api = APIRouter(prefix="/api")
    if keep.place is not None:
        _add_clips(api, keep, keep.place)
        if keep.jobs is not None:
            _add_jobs(api, keep, keep.jobs)
    if keep.recordings is not None:
        _add_recordings(api, keep, keep.recordings)
    return api


def _add_clips(api: APIRouter, keep: Keeping, place: str | Path) -> None:
    @api.get("/clips", summary="Marked stretches of the store", responses=REFUSALS)
    def clips() -> list[dict[str, Any]]:
        found = asked(lambda: clips_of(place, keep.site))
        return [{**asdict(clip), "stored": stored} for clip, stored in found]

    @api.post("/control/clips", summary="Mark a stretch", responses=CONTROL_REFUSALS)
    def new(request: Request, asks: NewClip) -> dict[str, Any]:
        def make() -> Clip:
            clip = Clip(asks.name, asks.start_ns, asks.end_ns, asks.note, made_ns=time.time_ns())
            return keep_clip(place, keep.site, clip)

        made = asked(make)
        _log(keep, request, f"marked clip {made.number}")
        return asdict(made)

    @api.post("/control/clips/{number}", summary="Name or note a clip", responses=CONTROL_REFUSALS)
    def change(request: Request, number: int, changes: ClipChanges) -> dict[str, Any]:
        _check_number(number)
        given = changes.model_dump(exclude_none=True)
        changed = asked(lambda: change_clip(place, keep.site, number, given))
        _log(keep, request, f"changed clip {number}")
        return asdict(changed)

    @api.delete("/control/clips/{number}", summary="Remove a clip", responses=CONTROL_REFUSALS)
    def remove(
        request: Request,
        number: int,
        stored: Annotated[bool, Query(description="also what is stored of its time")] = False,
    ) -> Done:
        _check_number(number)
        if not stored:
            asked(lambda: remove_clip(place, keep.site, number))
            _log(keep, request, f"removed clip {number}")
            return Done(said="Removed.")
        rows = asked(lambda: _delete_stored(place, keep.site, number))
        _log(keep, request, f"deleted what was stored of clip {number}: {plural(rows, 'row')}")
        return Done(said=f"Removed, and {plural(rows, 'row')} of its time deleted.")


def _delete_stored(place: str | Path, site: str, number: int) -> int:
    clip = next((one for one, _ in clips_of(place, site) if one.number == number), None)
    if clip is None:
        raise InputError("clip", number, "one of the site")
    found = delete_everywhere(place, Forgotten(site, clip.start_ns, clip.end_ns + 1))
    remove_clip(place, site, number)
    return sum(one.rows for one in found)


def _add_jobs(api: APIRouter, keep: Keeping, jobs: Jobs) -> None:
    @api.get("/jobs", summary="Files that are made of the store", responses=REFUSALS)
    def all_jobs() -> dict[str, Any]:
        forms = [{"form": key, **form._asdict()} for key, form in FORMS.items()]
        found = [job.body() for job in jobs.all()]
        return {"jobs": found, "forms": forms, "kept_s": KEPT_S, "why": jobs.why}

    @api.get("/jobs/{number}/{name}", summary="A file", response_class=FileResponse)
    def file(number: str, name: str) -> FileResponse:
        try:
            path = jobs.file(number, name)
        except InputError as error:
            raise HTTPException(404, str(error)) from None
        if not path.is_file():
            raise HTTPException(404, f"{name[:80]}: removed meanwhile")
        # Never shown in place: a report has scripts of its own.
        return FileResponse(path, media_type="application/octet-stream", filename=name)

    @api.post("/control/jobs", summary="Make files of a stretch", responses=CONTROL_REFUSALS)
    def new(request: Request, asks: NewJob) -> dict[str, Any]:
        def add() -> dict[str, Any]:
            given = asks.model_dump()
            return jobs.add(ExportRequest(**{**given, "tracks": tuple(asks.tracks)})).body()

        made = asked(add)
        _log(keep, request, f"asked for {made['request']['form']} of {made['number']}")
        return made

    @api.delete("/control/jobs/{number}", summary="End a job, and remove its files",
                responses=CONTROL_REFUSALS)  # fmt: skip
    def remove(request: Request, number: str) -> Done:
        asked(lambda: jobs.remove(number))
        _log(keep, request, f"removed the files of {number}")
        return Done(said="Removed.")


def _add_recordings(api: APIRouter, keep: Keeping, folder: Path) -> None:
    @api.get("/recordings", summary="Recordings of the site", responses=REFUSALS)
    def recordings() -> list[dict[str, Any]]:
        return [asdict(one) for one in kept_recordings(folder)]

    @api.delete("/control/recordings/{name}", summary="Delete a recording",
                responses=CONTROL_REFUSALS)  # fmt: skip
    def remove(request: Request, name: str) -> Done:
        try:
            asked(lambda: remove_recording(folder, name))
        except OSError as error:
            raise HTTPException(409, f"cannot be deleted: {reason_of(error)}") from None
        _log(keep, request, f"deleted recording {name}")
        return Done(said="Deleted.")


def _check_number(number: int) -> None:
    if not 0 <= number <= LARGEST:
        raise HTTPException(422, "number: found one that no clip has")


def _log(keep: Keeping, request: Request, line: str) -> None:
    keep.log(f"page: {getattr(request.state, 'client', '')} {line}")
