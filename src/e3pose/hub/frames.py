"""Answers of a hub as data frames."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

from e3pose.hub.accesses import local_user
from e3pose.hub.archives import answer_of_archives
from e3pose.hub.question import LIMIT_S, MOST_ROWS, answer
from e3pose.hub.settings import load_hub

if TYPE_CHECKING:
    import pandas


def query(
    hub: str | Path,
    sql: str,
    archives: bool = False,
    groups: Collection[str] | None = None,
    limit_s: float = LIMIT_S,
    most_rows: int = MOST_ROWS,
) -> pandas.DataFrame:
    """Ask a hub a question, as `e3pose hub query` does.

    Args:
        hub: its file, or the folder that has it as hub.toml.
        sql: one statement that reads: `summaries`, `hours`, `sites` in the words of the hub's
            database; of archives `poses` and `files` in those of DuckDB.
        archives: whether it is about archives; such an access is logged.
        groups: of sites whose archives are read; all for None.
        limit_s: how long it may take, seconds.
        most_rows: the most that it may return.

    Returns:
        A row for each of the answer, a column for each name.

    Raises:
        InputError: for what does not read, takes too long, or returns too much.
    """
    import pandas

    found = load_hub(Path(hub))
    if archives:
        names, rows = answer_of_archives(found, sql, local_user(), groups, limit_s, most_rows)
    else:
        names, rows = answer(found.database, sql, limit_s, most_rows)
    return pandas.DataFrame.from_records([tuple(row) for row in rows], columns=names)
