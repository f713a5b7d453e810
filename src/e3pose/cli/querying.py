"""`e3pose query`: rows of a store, as a table or as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from e3pose.base.atomic import check_output
from e3pose.base.errors import MISSING, InputError
from e3pose.base.quantities import plural
from e3pose.cli.options import OUTPUT, Whole, as_typed
from e3pose.cli.output import JsonFile, is_stdout, wrote
from e3pose.evaluate.columns import print_tables, table_console
from e3pose.settings.site_file import load_site
from e3pose.store.export import pose_columns, row_columns, write_tables

if TYPE_CHECKING:
    from e3pose.store import Store

SHOWN_ROWS = 40
OPTIONS = {"site": "--site", "run": "--run", "joint": "--joint", "time": "--from, --to"}
TOO_WIDE = ("joints", "number")  # or of no use, on a terminal; files have them
KEYS = ("run", "run_id", "slot", "time", "track", "joint")  # which every table begins with
FIRST = ("message",)  # of the other columns
TEXTS = ("time", "joint", "message", "kind", "camera_id", "source")
Table = Literal["poses", "slots", "tracks", "energy", "events", "zones", "summaries", "runs"]

ROWS = Group("Rows", sort_key=1)


@Parameter(name="*", group=ROWS)
@dataclass(frozen=True, kw_only=True)
class PeriodOptions:
    """Runs and times of a store, for every verb that reads one."""

    from_: Annotated[str | None, Parameter(name="--from", allow_leading_hyphen=True)] = None
    """Start: `2026-11-21T14:00` (local time; `Z` or `+01:00` for another zone), `14:00` (today),
    `-10min` (ago; s, min, h, d), or seconds since the start of the run, such as `12.5`."""
    to: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    """End, in the same formats. Default: now."""
    site: str | None = None
    """Only runs of this site."""
    run: Whole | None = None
    """Only this run, by its number in `e3pose query --what runs`. Default for times in seconds:
    the newest."""


PERIOD = PeriodOptions()


def query(
    store: str,
    /,
    *,
    what: Table = "poses",
    period: PeriodOptions = PERIOD,
    track: Annotated[Whole | None, Parameter(group=ROWS)] = None,
    joint: Annotated[str | None, Parameter(group=ROWS)] = None,
    json_file: Annotated[JsonFile, Parameter(group=OUTPUT)] = None,
) -> None:
    """Query a store: 3D poses, selections, energy, events, zones, summaries.

    Example: `e3pose query live.db --from -10min --track 7 --joint left_wrist`

    The command prints the first rows; `e3pose export STORE FILE.csv --what TABLE` writes them all.
    It works while the system runs.

    Parameters
    ----------
    store
        Database path or URL, as given to `e3pose replay --store`; or a site: site.toml or its
        folder.
    what
        `poses`; `slots` (selection, arrivals and energy per slot); `tracks` (first and last slot
        of each person); `energy` (meter readings); `events`; `zones` (who entered, stayed in or
        left which zone); `summaries` (one row per minute, what may leave the site); `runs`
        (contents of the store).
    track
        Only this track id.
    joint
        Only this joint, such as `left_wrist`.
    json_file
        Write the rows here as a JSON list; - is standard output.
    """
    from e3pose.store import Store

    store, site = store_of(store, period.site)
    if json_file is not None and not is_stdout(json_file):
        check_output(json_file)
        check_not_of(store, json_file)
    asked = Rows(Store(store), what, period, site, track, joint)
    if json_file is None:
        _show(asked)
        return
    count = write_tables(asked.chunks(), None if is_stdout(json_file) else json_file, "json")
    if not is_stdout(json_file):
        wrote(json_file, plural(count, "row"))


def check_not_of(store: str, path: Path) -> None:
    """Raise `InputError` for a file to write that belongs to the store."""
    from e3pose.store.database import database_path, database_url

    database = database_path(database_url(store))
    ends = ("", "-wal", "-shm", "-journal")  # SQLite keeps these files beside it
    if database is not None and path.resolve() in [Path(f"{database.resolve()}{e}") for e in ends]:
        raise InputError(f"{path}: found the store itself, expected another file")


@dataclass(frozen=True, slots=True)
class Rows:
    """The rows of a table of a store that are asked for.

    Attributes:
        store: what is asked.
        what: which table.
        period: which runs and times.
        site: whose runs; None for all sites.
        track: of poses, whose; None for everybody.
        joint: of poses, which; None for all.

    Raises:
        InputError: naming the option that a table does not have.
    """

    store: Store
    what: Table
    period: PeriodOptions
    site: str | None
    track: int | None = None
    joint: str | None = None

    def __post_init__(self) -> None:
        if self.what != "poses":
            for option, value in (("--joint", self.joint), ("--track", self.track)):
                if value is not None:
                    found = f"{value} with --what {self.what}"
                    raise InputError(option, found, "poses")
        if self.what == "runs":
            for option, text in (("--from", self.period.from_), ("--to", self.period.to)):
                if text is not None:
                    raise InputError(f"{option}: found with --what runs, which lists whole runs")
        check_numbers({"--track": (self.track,), "--run": (self.period.run,)})

    def chunks(self) -> Iterator[dict[str, list[Any]]]:
        """Yield parts of the table; the first, of no rows, names the columns of poses."""
        from e3pose.store import schema

        run, store = self.period.run, self.store
        bounds: dict[str, Any] = {
            "start": self.period.from_,
            "end": self.period.to,
            "site": self.site,
            "run": run,
        }
        with as_typed(OPTIONS, store.where):
            if self.what == "poses":
                for poses in store.read(**bounds, track=self.track, joint=self.joint):
                    yield pose_columns(poses)
            elif self.what == "runs":
                rows = [
                    {"run_id": one.run_id, **one.run.row()}
                    for one in store.runs()
                    if run in (None, one.run_id) and self.site in (None, one.run.site)
                ]
                yield row_columns(rows)
            else:
                rows = store.rows(self.what, **bounds)
                yield row_columns(rows, schema.ROWS[self.what].c.keys())


def check_numbers(numbers: Mapping[str, Sequence[int | None]]) -> None:
    """Raise `InputError` naming the option of a number that no track or run has."""
    for option, values in numbers.items():
        for value in values:
            if value is not None and not 0 <= value < 2**63:
                found = str(value)[:40]
                raise InputError(f"{option}: found {found}, expected a number of 0 or more")


def store_of(named: str, site: str | None) -> tuple[str, str | None]:
    """Return the store that is meant, and the site whose runs are asked for."""
    if "://" in named or not (Path(named).is_dir() or named.endswith(".toml")):
        return named, site

    table = load_site(Path(named))
    if table.store is None:
        wanted = '[store] path = "poses.db", without which a site keeps nothing'
        raise InputError("", MISSING, wanted, str(table.path))
    return str(table.store.place), site or table.name


def _show(asked: Rows) -> None:
    cells: dict[str, list[str]] = {}
    shown, more = 0, False
    for columns in asked.chunks():
        names = [n for n in columns if not n.endswith("_ns") and n not in TOO_WIDE]
        count = max((len(columns[name]) for name in names), default=0)
        for name in names:
            kept = columns[name][: SHOWN_ROWS - shown]
            cells.setdefault(name, []).extend(_cell(value) for value in kept)
        more = count > SHOWN_ROWS - shown
        shown = min(SHOWN_ROWS, shown + count)
        if more:  # nobody waits for a day to be read that is not shown
            break
    console = table_console(200)
    if not shown:
        console.print("No matching rows. List the contents of the store with --what runs.")
        return
    days = {time[:10] for time in cells.get("time", ())}
    title = f"{days.pop()}, times in UTC" if len(days) == 1 else ""
    if title:  # the date is the same in every row
        cells["time"] = [time[11:23] for time in cells["time"]]
    keys = {name: cells.pop(name) for name in KEYS if name in cells}
    cells = {**{name: cells[name] for name in FIRST if name in cells}, **cells}
    print_tables(console, keys, cells, title, left=TEXTS)
    if more:
        console.print(
            f"first {SHOWN_ROWS} rows; e3pose export STORE FILE.csv --what {asked.what} writes all"
        )


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, list):
        return " ".join(_cell(one) for one in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)
