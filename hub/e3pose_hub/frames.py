"""Answers of a hub as data frames."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from e3pose_hub.question import LIMIT_S, MOST_ROWS, answer
from e3pose_hub.settings import load_hub

if TYPE_CHECKING:
    import pandas


def query(
    hub: str | Path,
    sql: str,
    limit_s: float = LIMIT_S,
    most_rows: int = MOST_ROWS,
) -> pandas.DataFrame:
    """Ask a hub a question, as `e3pose hub query` does.

    Args:
        hub: its file, or the folder that has it as hub.toml.
        sql: one statement that reads, in the SQL of the hub's database.
        limit_s: how long it may take, seconds.
        most_rows: the most that it may return.

    Returns:
        A row for each of the answer, a column for each name.

    Raises:
        InputError: for what does not read, takes too long, or returns too much.
    """
    import pandas

    names, rows = answer(load_hub(Path(hub)).database, sql, limit_s, most_rows)
    return pandas.DataFrame.from_records([tuple(row) for row in rows], columns=names)
