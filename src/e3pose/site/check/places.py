"""Problems of the disks and databases that an edge writes to."""

from __future__ import annotations

import glob
import shutil
import stat
from collections.abc import Iterator
from contextlib import suppress
from math import ceil
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.settings.site_file import SiteTable, StoreTable
from e3pose.site.check.finding import Finding, ok, problem, warning

FREE_BYTES = 10**9
COMMIT_MOST_S = 0.65  # from a slot to its commit, with the commit before it at work
STORE_CHECK_S = 5.0  # at its database


def place_problems(site: SiteTable) -> Iterator[Finding]:
    """Yield the problems of the folders and files that the edge writes to."""
    store = None if site.store is None else site.store.place
    for what, file in (("state", site.state), ("store", store)):
        if not isinstance(file, Path):
            continue
        folder = file.resolve().parent
        if not folder.is_dir():
            yield problem(what, f"{folder} does not exist", f"mkdir -p {folder}")
            continue
        free = shutil.disk_usage(folder).free
        if free < FREE_BYTES:
            advice = "free disk space, or set keep and max_size in [store]"
            yield warning(what, f"{free / 1e9:.1f} GB free in {folder}", advice)
        with suppress(OSError):
            if file.stat().st_mode & stat.S_IROTH:
                found = f"readable by every user of this machine: {file}"
                yield warning(what, found, f"chmod o-rwx {file}*")
    if site.store is not None:
        yield kill_cost(site.store, site.fps * site.pace)
    if store is None:
        yield warning("store", "no [store]: poses are not stored", "[store] path = 'poses.db'")


def kill_cost(store: StoreTable, slots_per_s: float) -> Finding:
    """Return how many published slots a kill of the edge may take from its store."""
    if store.publish == "stored":
        return ok("store", "poses are published once they are stored: a kill costs none")
    slots = ceil(slots_per_s * COMMIT_MOST_S)
    return ok(
        "store",
        f"after a kill or a power failure up to {plural(slots, 'published slot')} may be missing",
        'publish = "stored" under [store] publishes none before it is stored',
    )


def store_problems(site: SiteTable) -> Iterator[Finding]:
    """Yield the problems of the store: of its database, checked for seconds, or of its server."""
    place = None if site.store is None else site.store.place
    if isinstance(place, Path):
        yield from _file_problems(place)
    elif place is not None:
        yield server_problem(place)


def _file_problems(file: Path) -> Iterator[Finding]:
    from e3pose.store.integrity import problem_of

    if file.is_file() and (damage := problem_of(file, STORE_CHECK_S)):
        advice = "the edge moves it aside within minutes, or at its next start"
        yield problem("store-corrupt", f"{file}: damaged ({damage})", advice)
    aside = [
        other
        for other in sorted(file.parent.glob(f"{glob.escape(file.name)}.corrupt-*"))
        if not other.name.endswith(("-wal", "-shm"))
    ]
    if aside:
        found = f"{plural(len(aside), 'damaged database')} moved aside, newest: {aside[-1]}"
        advice = f"recover with `sqlite3 {aside[-1]} .recover`, then delete it"
        yield warning("store-corrupt", found, advice)


def server_problem(url: str) -> Finding:
    """Return whether a database server accepts connections and holds a store."""
    from e3pose.store.database import check_reachable

    try:
        return ok("store", check_reachable(url))
    except InputError as error:
        advice = "start the server; while it is away, slots wait in the spool"
        return problem("store", str(error), advice)
