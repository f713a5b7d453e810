"""`e3pose store`: copies and moves of a whole store."""

from __future__ import annotations

from cyclopts import App

from e3pose.base.quantities import plural
from e3pose.cli.options import StorePlace
from e3pose.cli.progress import stage_progress
from e3pose.cli.querying import store_of

store_app = App(name="store", help="Back up, restore and move a store.")


@store_app.command(name="copy")
def copy(source: StorePlace, dest: str, /) -> None:
    """Copy a store: a backup, its restoration, or a move to another database.

    Example: `e3pose store copy site.toml backup.db`

    Example: `e3pose store copy backup.db postgresql://e3pose@db.local/lab`

    It works while a site writes to the source, and copies what was stored when it began. The copy
    has the present schema.

    Parameters
    ----------
    dest
        File to create, or URL of a database without runs.
    """
    from e3pose.store.copying import copy_store
    from e3pose.store.database import database_url, shown

    with stage_progress() as progress:
        rows = copy_store(store_of(source, None)[0], dest, progress)
    counts = ", ".join(plural(rows[name], name[:-1]) for name in ("runs", "slots", "poses"))
    print(f"Wrote {shown(database_url(dest))}: {counts}")
