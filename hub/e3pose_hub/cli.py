"""`e3pose hub`: many sites in one place: their summaries, questions, and who may see what."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, Parameter
from rich.table import Table
from rich.text import Text

from e3pose.base.errors import Exit, InputError
from e3pose.base.quantities import check_seconds
from e3pose.base.system import stand_back
from e3pose.cli.options import OUTPUT, Flag, Whole, as_typed
from e3pose.cli.output import JsonFile, is_stdout, wrote
from e3pose.cli.running import begin
from e3pose.evaluate.columns import table_console
from e3pose.site.run import run_until_stopped
from e3pose.store.export import write_tables
from e3pose.store.times import iso_text
from e3pose_hub.settings import check_links, load_hub
from e3pose_hub.users import grant as grant_user
from e3pose_hub.users import read_users, users_of
from e3pose_hub.users import revoke as revoke_user

hub_app = App(name="hub", help="Gather the summaries of many sites in one place.")
SHOWN_ROWS = 40
OPEN_THEM = (
    "open their Parquet files in DuckDB, Polars or pandas, as docs/how-to/read-archives.md shows"
)


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
    begin()
    from e3pose_hub.database import open_hub
    from e3pose_hub.pull import AT_ONCE, Pulling

    found = load_hub(hub)
    if found.archives:
        print(f"{found.path}: remove archives, a hub no longer reads them: {OPEN_THEM}", flush=True)
    if not found.sites:
        raise InputError(f"{found.path}: found no site, expected [[site]] tables")
    check_links(found)

    def said(site: str, problem: str) -> None:
        why = problem.removeprefix(f"{site}: ")
        print(f"{site}: {why or 'answers again'}", flush=True)

    engine = open_hub(found.database, AT_ONCE)
    try:
        with Pulling(found, engine, said):
            print(f"asking {len(found.sites)} sites into {found.database}", flush=True)
            run_until_stopped(lambda: True)
    finally:
        engine.dispose()


@hub_app.command
def view(
    hub: Path,
    /,
    *,
    listen: str | None = None,
    for_s: Annotated[float | None, Parameter(name="--for")] = None,
) -> None:
    """Serve one page over all sites: health, people, events, watts, blind slots and faults.

    Example: `e3pose hub view house`, then open the printed address with your token.

    Users and their rights come from `e3pose hub grant`; each sees the sites of their groups, and
    goes from there to a site's own live page, to see or to control it, which is logged. It works
    beside `e3pose hub run`. Ctrl-C stops it.

    Parameters
    ----------
    hub
        File of the hub, or its folder.
    listen
        HOST:PORT instead of the hub file's. Default: 127.0.0.1:8480.
    for_s
        Stop after this many seconds.
    """
    begin()
    from e3pose_hub.page import open_page, page_lines

    check_seconds("--for", for_s)
    found = load_hub(hub)
    with as_typed({} if listen is None else {"view.listen": "--listen"}, str(found.path)):
        page = open_page(found, listen)
    with page as opened:
        print("\n".join(page_lines(opened.url, found)), flush=True)
        opened.run(for_s)


@hub_app.command
def query(
    hub: Path,
    table: Literal["summaries", "hours", "sites"],
    /,
    *,
    site: str | None = None,
    from_: Annotated[str | None, Parameter(name="--from", allow_leading_hyphen=True)] = None,
    to: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    csv: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    json_file: Annotated[JsonFile, Parameter(group=OUTPUT)] = None,
) -> None:
    """Show or write what a hub gathered: minutes or hours of all sites, or how each is fetched.

    Example: `e3pose hub query house hours --from -30d --csv hours.csv`

    It works while the hub runs. `docs/how-to/ask-many-sites.md` has questions to ask of the rows.

    Parameters
    ----------
    hub
        File of the hub, or its folder.
    table
        `summaries` (a row per site and minute), `hours` (sums of them), `sites` (how each is
        fetched).
    site
        Only this site.
    from_
        Start: `2026-11-21T14:00` (local time; `Z` or `+01:00` for another zone), `14:00` (today),
        `-30d` (ago; s, min, h, d).
    to
        End, in the same formats. Default: now.
    csv
        Write the rows here as CSV.
    json_file
        Write the rows here as a JSON list; - is standard output.
    """
    from e3pose_hub.database import read_rows

    found = load_hub(hub)
    stand_back()
    with as_typed({"start": "--from", "end": "--to", "time": "--from, --to"}):
        names, rows = read_rows(found.database, table, site, from_, to)
    _put_out(names, rows, csv, json_file)


@hub_app.command
def grant(
    hub: Path,
    name: str,
    /,
    *,
    viewer: Flag = False,
    operator: Flag = False,
    group: Annotated[list[str] | None, Parameter(negative="")] = None,
) -> None:
    """Let somebody see sites on the hub's page; print the token, which is shown once.

    Example: `e3pose hub grant house ada --operator --group clinics`

    Granting again replaces rights and token.

    Parameters
    ----------
    hub
        File of the hub, or its folder.
    name
        Of the user, as the log of accesses has it.
    viewer
        The user may open the live pages of the sites to see.
    operator
        The user may also open them to control the sites.
    group
        Group of sites in the hub's file; repeatable.
    """
    if viewer == operator:
        raise InputError("--viewer, --operator: expected one of them")
    if not group:
        raise InputError("--group: not found, expected a group of sites in the hub's file")
    with as_typed({"camera id": "NAME", "group": "--group"}):
        token = grant_user(
            load_hub(hub), name, "operator" if operator else "viewer", tuple(dict.fromkeys(group))
        )
    print(f"{name}: token {token}\nappend it to the page's address: #token={token}")


@hub_app.command
def revoke(hub: Path, name: str, /) -> None:
    """Take all rights from a user of the hub's page.

    Example: `e3pose hub revoke house ada`

    Live pages of sites refuse the user from the next question of `e3pose hub run` on, also those
    that are open; without such questions after an hour.

    Parameters
    ----------
    hub
        File of the hub, or its folder.
    name
        Of the user.
    """
    with as_typed({"user": "NAME"}):
        found = load_hub(hub)
        revoke_user(found, name)
    print(f"{name}: revoked here; at sites with the next question, in about {found.every_s:g} s")


@hub_app.command
def users(hub: Path, /) -> None:
    """List who may see which sites on the hub's page.

    Example: `e3pose hub users house`

    Parameters
    ----------
    hub
        File of the hub, or its folder.
    """
    found = load_hub(hub)
    rows = [
        (user.name, user.role, ", ".join(user.groups), len(found.of_groups(user.groups)))
        for user in read_users(users_of(found).path)
    ]
    _put_out(["name", "role", "groups", "sites"], rows)


@hub_app.command
def accesses(
    hub: Path,
    /,
    *,
    site: str | None = None,
    who: str | None = None,
    limit: Whole = 100,
    csv: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    json_file: Annotated[JsonFile, Parameter(group=OUTPUT)] = None,
) -> None:
    """List who opened the live pages of sites through the hub, newest first.

    Example: `e3pose hub accesses house --site lab`

    Logged is the opening of a site's own page. The log has the newest 100 000. Whoever reads the
    files of an archive, or has a token or a certificate of a site, is not in it.

    Parameters
    ----------
    hub
        File of the hub, or its folder.
    site
        Of this site alone.
    who
        By this user alone.
    limit
        The most to list.
    csv
        Write the rows here as CSV.
    json_file
        Write the rows here as a JSON list; - is standard output.
    """
    from e3pose_hub.accesses import read_accesses

    found = read_accesses(load_hub(hub).database, site, who, limit)
    rows = [(iso_text(one.time_ns), one.who, one.site, one.what) for one in found]
    _put_out(["time", "who", "site", "what"], rows, csv, json_file)


@hub_app.command
def forgotten(
    hub: Path,
    /,
    *,
    csv: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    json_file: Annotated[JsonFile, Parameter(group=OUTPUT)] = None,
) -> None:
    """List deletions at sites, and what is left of them at the hub; exit code 1 if anything is.

    Example: `e3pose hub forgotten house`

    A hub hears of `e3pose archive delete` with the next summaries. Those of a deleted day go; those
    of a person stay, as nobody is in them.

    Parameters
    ----------
    hub
        File of the hub, or its folder.
    csv
        Write the rows here as CSV.
    json_file
        Write the rows here as a JSON list; - is standard output.
    """
    from e3pose.store.forgetting import day_of
    from e3pose_hub.database import read_forgotten

    found = read_forgotten(load_hub(hub).database)
    rows = [
        (
            one.site,
            f"day {day_of(one.start_ns)}" if one.track_id is None else f"person {one.track_id} "
            f"of the run that began {iso_text(one.run_started_ns or 0)}",
            iso_text(one.heard_ns), one.deleted, one.left,
        )
        for one in found
    ]  # fmt: skip
    _put_out(["site", "what", "heard", "deleted", "left"], rows, csv, json_file)
    if any(one.left for one in found):
        sys.exit(Exit.NO)


def _put_out(
    names: Sequence[str],
    rows: Sequence[Sequence[Any]],
    csv: Path | None = None,
    json_file: Path | None = None,
) -> None:
    """Show rows, or write them where they are wanted."""
    outputs = {form: path for form, path in (("csv", csv), ("json", json_file)) if path}
    if not outputs:
        _show(names, rows)
        return

    columns = {name: [row[at] for row in rows] for at, name in enumerate(names)}
    for form, path in outputs.items():
        place = None if is_stdout(path) else path
        count = write_tables([columns], place, form)
        if not is_stdout(path):
            wrote(path, f"{count} rows")


def _shown(value: Any) -> str:
    """Return a value as a table shows it: six digits are enough to look at."""
    if isinstance(value, float) and abs(value) < 1e6:
        return f"{value:.6g}"
    return "-" if value is None else str(value)


def _show(names: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    table = Table(*names, box=None)
    for row in rows[:SHOWN_ROWS]:
        table.add_row(*(Text(_shown(value)) for value in row))
    console = table_console(200)
    console.print(table)
    if len(rows) > SHOWN_ROWS:
        console.print(f"first {SHOWN_ROWS} of {len(rows)} rows; --csv or --json write all")
