"""Delete a day or a person from an archive, or from a store and every archive that it went to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path

from sqlalchemy import select

from e3pose.base.errors import InputError, reason_of
from e3pose.output.archive.manifest import (
    NAME,
    Manifest,
    check_there,
    days_of,
    digest,
    read_manifest,
    write_manifest,
)
from e3pose.output.archive.places import Place, place_of
from e3pose.output.exports.wide import without_person
from e3pose.store import schema
from e3pose.store.database import database_url, shown
from e3pose.store.forgetting import Forgotten, changing, forget, left


@dataclass(frozen=True, slots=True)
class Deleted:
    """The result of a request at one place.

    Attributes:
        place: the store, or an archive.
        rows: deleted now.
        left: found afterwards; None where nobody could look.
        problem: why it could not be deleted there; empty if it could.
    """

    place: str
    rows: int
    left: int | None
    problem: str = ""


def delete_everywhere(store: str | Path, what: Forgotten) -> list[Deleted]:
    """Delete from a store and from each archive of it; then count the remains.

    The next `archive_store` deletes there once more: where an archive cannot be reached now, and
    what one that is being written meanwhile has read before.

    Raises:
        InputError: when the store cannot be used, or has archives and a part of a day is asked for.
    """
    if not what.whole_day and (places := archives_of(store, what.site)):
        wanted = "a whole day, as archives have them: e3pose archive delete SITE --day DAY"
        raise InputError("time", f"a part of one, with archives ({', '.join(places)})", wanted)
    what, rows = forget(store, what)
    found = [Deleted(shown(database_url(store)), rows, left(store, what))]
    for name in archives_of(store, what.site):
        try:
            place = place_of(name)
            rows, problems = delete_there(place, what)
            if problems:
                found.append(Deleted(name, rows, None, "; ".join(problems)))
            else:
                found.append(Deleted(name, rows, left_there(place, what)))
        except (ValueError, OSError) as error:  # that of a damaged file is one of pyarrow
            found.append(Deleted(name, 0, None, str(error)))
    return found


def delete_there(place: Place, what: Forgotten) -> tuple[int, list[str]]:
    """Delete from an archive, and once more nothing more.

    Returns:
        How many rows were deleted, and the problems of days that were left out, a line each.

    Raises:
        InputError: when the archive cannot be read or written.
    """
    check_there(place)
    if not what.whole_day:  # asked for before there was an archive: it never had those rows
        return 0, []
    one_day = what.track_id is None
    rows, problems = 0, list[str]()
    for day in [what.day] if one_day else [day for _, day in days_of(place, what.site)]:
        try:
            rows += _delete_day(place, what) if one_day else _delete_person(place, day, what)
        except ValueError as error:
            problems.append(f"{Manifest(what.site, day).folder}: {reason_of(error)[:300]}")
    return rows, problems


def left_there(place: Place, what: Forgotten) -> int:
    """Return the number of forgotten rows that an archive still has, by its files."""

    from pyarrow import parquet

    rows = 0
    for site, day in days_of(place, what.site):
        manifest = Manifest(site, day)
        if what.track_id is None and day != what.day:
            continue
        for name in place.names(manifest.folder):
            of_run = name.endswith(f"-{what.run_started_ns}.parquet")
            if not name.endswith(".parquet") or not (what.track_id is None or of_run):
                continue
            content = place.read(name)
            if content is not None:
                file = parquet.ParquetFile(BytesIO(content))
                for batch in file.iter_batches(columns=["track"]):
                    of_person = batch.column("track").to_numpy(False) == what.track_id
                    rows += len(batch) if what.track_id is None else int(of_person.sum())
    return rows


def archives_of(store: str | Path, site: str) -> list[str]:
    """Return the archives that poses of a site went to."""
    table = schema.archives
    asked = select(table.c.place).where(table.c.site == site).order_by(table.c.place)
    with changing(store) as engine, engine.connect() as connection:
        return list(connection.execute(asked).scalars())


def _delete_day(place: Place, what: Forgotten) -> int:
    before = read_manifest(place, what.site, what.day)
    manifest = before or Manifest(what.site, what.day)
    names = [n for n in place.names(manifest.folder) if not n.endswith(f"/{NAME}")]
    if before is None and not names:
        return 0
    for name in names:  # those that no manifest names, too
        place.remove(name)
    rows = sum(entry.rows for entry in manifest.files.values())
    write_manifest(place, Manifest(what.site, what.day, deleted=True))
    return rows


def _delete_person(place: Place, day: str, what: Forgotten) -> int:
    manifest, deleted = read_manifest(place, what.site, day) or Manifest(what.site, day), 0
    for name, entry in manifest.files.items():
        if entry.started_ns != what.run_started_ns or what.track_id not in entry.tracks:
            continue
        path = f"{manifest.folder}/{name}"
        content = place.read(path)
        if content is not None and what.track_id is not None:
            content, rows = without_person(content, what.track_id)
            tracks = tuple(track for track in entry.tracks if track != what.track_id)
            if rows:
                place.write(path, content)
                size, sha256 = len(content), digest(content)
            else:
                place.remove(path)
                size, sha256 = 0, ""
            deleted += entry.rows - rows
            entry = replace(entry, rows=rows, tracks=tracks, bytes=size, sha256=sha256)
            manifest = manifest.with_file(name, entry)
            write_manifest(place, manifest)
    return deleted
