"""`e3pose hub`: the summaries of many sites in one place, and questions about them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter

from e3pose.base.errors import InputError
from e3pose.cli.options import OUTPUT
from e3pose.cli.output import JsonFile, is_stdout, wrote

hub_app = App(name="hub", help="Gather the summaries of many sites, and ask questions about them.")
SHOWN_ROWS = 40


@hub_app.command
def run(hub: Path, /) -> None:
    """Fetch the summaries of all sites of a hub until Ctrl-C.

    Example: `e3pose hub run house/hub.toml`

    Every site is asked once a minute, at its own time, for what is new; one that does not answer,
    less and less often. What was fetched is committed with the place to go on from: a hub that was
    killed or away for weeks misses nothing that the site still has. Messages tell which site cannot
    be asked, and why.

    Parameters
    ----------
    hub
        File of the hub, or the folder that has it as hub.toml.
    """
    from e3pose.hub.database import open_hub
    from e3pose.hub.pull import Pulling
    from e3pose.hub.settings import load_hub
    from e3pose.site.run import run_until_stopped

    found = load_hub(hub)
    if not found.sites:
        raise InputError(f"{found.path}: found no site, expected [[site]] tables")
    for name in found.sites:
        found.link(name)  # certificates that cannot be used are told at once

    def said(site: str, problem: str) -> None:
        print(f"{site}: {problem}" if problem else f"{site}: answers again", flush=True)

    with Pulling(found, open_hub(found.database), said):
        print(f"asking {len(found.sites)} sites into {found.database}", flush=True)
        run_until_stopped(lambda: True)


@hub_app.command
def query(
    hub: Path,
    sql: str,
    /,
    *,
    csv: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    json_file: Annotated[JsonFile, Parameter(group=OUTPUT)] = None,
) -> None:
    """Ask a question in SQL about the summaries of all sites.

    Example: `e3pose hub query house "SELECT site, sum(slots) FROM summaries GROUP BY site"`

    Tables: `summaries` (a row per site and minute) and `sites` (how each is fetched). One statement
    that reads, within 30 s, of at most 10 000 rows; it works while the hub runs.

    Parameters
    ----------
    hub
        File of the hub, or its folder.
    sql
        In the words of the hub's database, SQLite or PostgreSQL.
    csv
        Write the rows here as CSV.
    json_file
        Write the rows here as a JSON list; - is standard output.
    """
    from e3pose.hub.question import answer
    from e3pose.hub.settings import load_hub

    names, rows = answer(load_hub(hub).database, sql)
    outputs = {form: path for form, path in (("csv", csv), ("json", json_file)) if path}
    if not outputs:
        _show(names, rows)
        return
    from e3pose.store.export import write_tables

    columns = {name: [row[at] for row in rows] for at, name in enumerate(names)}
    for form, path in outputs.items():
        place = None if is_stdout(path) else path
        count = write_tables([columns], place, form)
        if not is_stdout(path):
            wrote(path, f"{count} rows")


def _show(names: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    from rich.table import Table

    from e3pose.evaluate.columns import table_console

    table = Table(*names, box=None)
    for row in rows[:SHOWN_ROWS]:
        table.add_row(*("-" if value is None else str(value) for value in row))
    console = table_console(200)
    console.print(table)
    if len(rows) > SHOWN_ROWS:
        console.print(f"first {SHOWN_ROWS} of {len(rows)} rows; --csv or --json write all")
