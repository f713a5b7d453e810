"""`e3pose archive`: years of poses, in a folder or an object store, and how they are deleted."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cyclopts import App

from e3pose.base.errors import Exit, InputError
from e3pose.base.lock import hold
from e3pose.base.quantities import age_s, plural
from e3pose.cli.options import Flag, StorePlace, as_typed
from e3pose.cli.progress import track_progress
from e3pose.cli.querying import store_of
from e3pose.output.archive.manifest import check_archive
from e3pose.output.archive.places import place_of
from e3pose.store.times import iso_text

archive_app = App(name="archive")
OPTIONS = {"site": "--site", "day": "--day"}


@archive_app.default
def archive(
    store: StorePlace,
    dest: str,
    /,
    *,
    keep: str | None = None,
    site: str | None = None,
    new: Flag = False,
) -> None:
    """Archive finished hours of a store, skipping those already archived.

    Example: `e3pose archive site.toml /mnt/archive --keep 2y`

    Example: `e3pose archive site.toml s3://bucket/poses`

    Run it every hour, by cron or systemd; the site may run meanwhile. An hour is closed ten minutes
    after its end. It becomes one Parquet file in the folder of its site and day (UTC), beside a
    manifest with its hash. A command that was killed goes on the next time. What `e3pose archive
    delete` could not reach is deleted now.

    Parameters
    ----------
    dest
        Folder, made if it is missing, or the address of an object store that fsspec knows.
    keep
        Remove days older than this from the archive, such as 90d or 2y. Default: keep all.
    site
        Only this site of the store.
    new
        Begin anew where the archive that the store knows is gone for good.
    """
    from e3pose.output.archive.writing import archive_store

    with as_typed({"": "--keep"}):
        keep_s = None if keep is None else age_s(_years(keep))
    with as_typed(OPTIONS):
        named, of_site = store_of(store, site)
        place = place_of(dest)
        with _alone(named):
            done = archive_store(named, of_site, place, time.time_ns(), keep_s, print, new)
    more = "".join(
        f", {what}"
        for count, what in (
            (done.removed, f"{plural(done.removed, 'old day')} removed"),
            (done.deleted, f"{plural(done.deleted, 'row')} deleted as asked"),
        )
        if count
    )
    size = f"{done.bytes / 1e6:.1f} MB"
    print(f"Archived {plural(done.hours, 'hour')}: {plural(done.rows, 'row')}, {size}{more}")
    for line in done.problems:
        print(f"left out: {line}")
    if done.problems:
        sys.exit(1)


@archive_app.command
def verify(dest: str, /) -> None:
    """Read an archive and compare every file with its hash; exit with code 1 if one differs.

    Example: `e3pose archive verify /mnt/archive`

    Parameters
    ----------
    dest
        Folder or address, as given to `e3pose archive`.
    """
    found = check_archive(
        place_of(dest), lambda days: track_progress(days, len(days), "reading the archive")
    )
    for line in found.problems:
        print(line)
    for name in found.strays:
        print(f"{name}: in no manifest: the next e3pose archive writes it")
    days = plural(found.days, "day") + (f", {found.deleted} of them deleted" * bool(found.deleted))
    size = f"{found.bytes / 1e6:.1f} MB"
    print(f"{days}: {plural(found.files, 'good file')}, {plural(found.rows, 'row')}, {size}")
    if found.problems:
        print(f"{plural(len(found.problems), 'problem')}")
        sys.exit(Exit.NO)


@archive_app.command
def delete(
    store: StorePlace,
    /,
    *,
    day: str,
    site: str | None = None,
) -> None:
    """Delete a day from a store and from every archive that it went to.

    Example: `e3pose archive delete site.toml --day 2026-11-25`

    `e3pose people forget` deletes a person. The command shows what it deleted at each place, and
    what it finds there afterwards; it exits with code 1 where it found something, or could not
    look. An archive that cannot be reached now is cleared by the next `e3pose archive`. Copies by
    `e3pose store copy` and files by `e3pose export` are not known to the store: delete those
    yourself.

    Parameters
    ----------
    day
        A day that is over (UTC), such as 2026-11-25: everything that is stored of it.
    site
        Of which site of the store. Default: the only one.
    """
    from e3pose.output.archive.deleting import delete_everywhere
    from e3pose.store.forgetting import of_day

    with as_typed(OPTIONS):
        named, of_site = store_of(store, site)
        what = of_day(_only_site(named, of_site), day)
        if what.end_ns > time.time_ns():
            raise InputError("--day", day, "a day that is over (UTC)")
        found = delete_everywhere(named, what)
    for one in found:
        shown = one.problem or f"{plural(one.rows, 'row')} deleted, {one.left} left"
        print(f"{one.place}: {shown}")
    if all(one.rows == one.left == 0 for one in found):
        print("nothing of it was there: e3pose query --what runs lists what is")
    if any(one.left != 0 for one in found):
        print("not everywhere: run e3pose archive to the places that remain, then this again")
        sys.exit(Exit.NO)


@archive_app.command
def deleted(store: StorePlace, /, *, site: str | None = None) -> None:
    """List the deletions at a site, and which hubs know of them; exit code 1 if one does not.

    Example: `e3pose archive deleted site.toml`

    A hub hears of a deletion with the next summaries that it fetches, deletes what it has, and
    confirms it with its next question. Listed are hubs that have ever asked this site.

    Parameters
    ----------
    site
        Of which site of the store. Default: the only one.
    """
    from e3pose.store.acknowledgements import acknowledgements

    with as_typed(OPTIONS):
        named, of_site = store_of(store, site)
        found = acknowledgements(named, _only_site(named, of_site))
    for one in found:
        what = one.what
        person = (
            f"person {what.track_id} of the run that began {iso_text(what.run_started_ns or 0)}"
        )
        print(f"day {what.day}" if what.track_id is None else person, end=": ")
        said = [f"{hub} heard" for hub in one.informed] + [f"{hub} not yet" for hub in one.pending]
        print(", ".join(said) or "no hub has asked this site")
    if any(one.pending for one in found):
        sys.exit(Exit.NO)


def _only_site(store: str, site: str | None) -> str:
    """Return the named site, or the only one of a store."""
    from e3pose.store import Store

    sites = sorted({one.run.site for one in Store(store).runs()})
    if site is None and len(sites) != 1:
        raise InputError(f"--site: not found, expected one of {', '.join(sites)[:200]}")
    return site or sites[0]


@contextmanager
def _alone(store: str) -> Iterator[None]:
    """Be the only one that archives a store file."""
    from e3pose.store.database import database_path, database_url

    path = database_path(database_url(store))
    if path is None:
        yield
        return
    with hold(Path(path), "archive"):
        yield


def _years(text: str) -> str:
    """Return a time in years as days."""
    number, unit = text[:-1].strip(), text[-1:]
    days = number.replace(".", "", 1).isdigit() and unit == "y"
    return f"{365.25 * float(number):.0f}d" if days else text
