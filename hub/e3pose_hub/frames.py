"""Data of a hub as data frames."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from e3pose.store.query import Time
from e3pose.store.schema import SUMMARY_JSON
from e3pose_hub.database import HOUR_JSON, read_rows
from e3pose_hub.settings import load_hub

if TYPE_CHECKING:
    import pandas


def query(
    hub: str | Path, table: str, site: str | None = None, start: Time = None, end: Time = None
) -> pandas.DataFrame:
    """Return a table of a hub, as `e3pose hub query` does.

    Args:
        hub: its file, or the folder that has it as hub.toml.
        table: `summaries`, `hours` or `sites`.
        site: its name; None for all sites.
        start: of the time wanted, as text, a `datetime` or nanoseconds since 1970.
        end: likewise; it is not included.

    Returns:
        A row for each of the table, a column for each name, and `time`, UTC, where there is one.

    Raises:
        InputError: for no hub, a time that is none, or more than 200 000 rows.
    """
    import pandas

    names, rows = read_rows(load_hub(Path(hub)).database, table, site, start, end)
    found = pandas.DataFrame.from_records([tuple(row) for row in rows], columns=names)
    for name in {"summaries": SUMMARY_JSON, "hours": HOUR_JSON}.get(table, ()):
        found[name] = found[name].map(json.loads)
    if "time_ns" in names:
        found["time"] = pandas.to_datetime(found.time_ns, utc=True)
    return found
