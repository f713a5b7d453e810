"""Check the disks and databases that an edge writes to."""

from __future__ import annotations

import glob
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.settings.site_file import SiteTable
from e3pose.site.check.finding import Finding

FREE_BYTES = 10**9
STORE_CHECK_S = 5.0  # at its database


def check_places(site: SiteTable) -> Iterator[Finding]:
    """Check the folders that the edge writes to."""
    store = None if site.store is None else site.store.place
    for what, file in (("state", site.state), ("store", store)):
        if not isinstance(file, Path):
            continue
        folder = file.resolve().parent
        if not folder.is_dir():
            yield Finding("problem", what, f"{folder} does not exist", f"mkdir -p {folder}")
            continue
        free = shutil.disk_usage(folder).free
        if free < FREE_BYTES:
            yield Finding(
                "warning",
                what,
                f"{free / 1e9:.1f} GB free in {folder}",
                "free disk space, or set keep and max_size in [store]",
            )
        else:
            yield Finding("ok", what, f"{free / 1e9:.0f} GB free in {folder}")
        yield from _readers(what, file)
    if store is None:
        yield Finding(
            "warning", "store", "no [store]: poses are not stored", "[store] path = 'poses.db'"
        )
    elif isinstance(store, Path):
        yield from check_store(store)
    else:
        yield check_server(store)


def _readers(what: str, file: Path) -> Iterator[Finding]:
    try:
        everybody = file.stat().st_mode & stat.S_IROTH
    except OSError:
        return
    if everybody:
        found = f"readable by every user of this machine: {file}"
        yield Finding("warning", what, found, f"chmod o-rwx {file}*")


def check_store(file: Path) -> Iterator[Finding]:
    """Check the integrity of the database for some seconds, and report damaged ones set aside."""
    from e3pose.store.integrity import problem_of

    if file.is_file() and (problem := problem_of(file, STORE_CHECK_S)):
        advice = "the edge moves it aside within minutes, or at its next start"
        yield Finding("problem", "store-corrupt", f"{file}: damaged ({problem})", advice)
    aside = [
        other
        for other in sorted(file.parent.glob(f"{glob.escape(file.name)}.corrupt-*"))
        if not other.name.endswith(("-wal", "-shm"))
    ]
    if aside:
        found = f"{plural(len(aside), 'damaged database')} moved aside, newest: {aside[-1]}"
        advice = f"recover with `sqlite3 {aside[-1]} .recover`, then delete it"
        yield Finding("warning", "store-corrupt", found, advice)


def check_server(url: str) -> Finding:
    """Check that a database server accepts connections and holds a store."""
    from e3pose.store.database import check_reachable

    try:
        return Finding("ok", "store", check_reachable(url))
    except InputError as error:
        advice = "start the server; while it is away, slots wait in the spool"
        return Finding("problem", "store", str(error), advice)
