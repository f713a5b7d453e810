"""`e3pose people`: names and colours of people in a store, and forgetting them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from e3pose.base.errors import Exit, InputError
from e3pose.base.quantities import plural
from e3pose.cli.options import StorePlace, Whole, warn
from e3pose.cli.querying import check_numbers, store_of
from e3pose.evaluate.columns import print_tables, table_console
from e3pose.settings.resolved import resolve_site
from e3pose.store.exported import FORMS, forget_rows
from e3pose.store.times import iso_text

if TYPE_CHECKING:
    from e3pose.store.people import Track

people_app = App(name="people", help="List, name, colour, merge and forget people of a store.")
Person = Annotated[str, Parameter(help="Number of the track, or name.")]
Run = Annotated[Whole | None, Parameter(help="Run of the track. Default: the newest.")]
THERE_S = 60.0  # somebody seen within it may still be there


@people_app.command(name="list")
def list_people(store: StorePlace, /) -> None:
    """List the people of a store: name, tracks, and when they were there.

    Example: `e3pose people list site.toml`
    """
    from e3pose.store.people import people_of

    people = people_of(*store_of(store, None))
    if not people:
        print("Nobody is stored")
        return
    keys = {"person": [person.name or f"Person {person.tracks[0][1]}" for person in people]}
    columns = {
        "tracks": [_shown(person.tracks) for person in people],
        "colour": [person.colour or "-" for person in people],
        "first seen": [iso_text(person.first_ns)[:19] for person in people],
        "last seen, UTC": [iso_text(person.last_ns)[:19] for person in people],
    }
    print_tables(table_console(200), keys, columns, left=("person", *columns))


@people_app.command(name="name")
def name(store: StorePlace, person: Person, new: str, /, *, run: Run = None) -> None:
    """Name a person: a track, or somebody who has a name already.

    Example: `e3pose people name site.toml 7 Ada`

    Tracks of the same name are the same person. A track keeps its name while it is followed, also
    when the person was lost for a moment.

    Parameters
    ----------
    new
        The name.
    """
    from e3pose.store.people import set_name

    place, tracks = _found(store, person, run)
    print(f"Named {plural(set_name(place, tracks, new), 'track')}: {new}")


@people_app.command(name="colour")
def colour(store: StorePlace, person: Person, colour: str, /, *, run: Run = None) -> None:
    """Choose the colour that a person is drawn in on the live page.

    Example: `e3pose people colour site.toml Ada orange`

    Parameters
    ----------
    colour
        blue, orange, green, pink, sky, gold, grey or brown.
    """
    from e3pose.store.people import set_colour

    place, tracks = _found(store, person, run)
    print(f"Coloured {plural(set_colour(place, tracks, colour), 'track')}: {colour}")


@people_app.command(name="merge")
def merge(store: StorePlace, person: Person, into: str, /, *, run: Run = None) -> None:
    """Say that two people are the same: the tracks of one get the name of the other.

    Example: `e3pose people merge site.toml 9 Ada`

    Parameters
    ----------
    into
        Name of the other.
    """
    from e3pose.store.people import people_of, set_name

    place, tracks = _found(store, person, run)
    if into not in [one.name for one in people_of(place)]:
        raise InputError("INTO", repr(into[:40]), "a name that somebody has: e3pose people list")
    print(f"Merged {plural(set_name(place, tracks, into), 'track')} into {into}")


@people_app.command(name="find")
def find(store: StorePlace, person: Person, /, *, run: Run = None) -> None:
    """Show what a store has of a person; exit code 1 if it has anything.

    Example: `e3pose people find site.toml 7 --run 1`

    After `forget` it shows that nothing is left.
    """
    from e3pose.store.people import kept_of

    place, tracks = _found(store, person, run)
    kept = kept_of(place, tracks)
    if not any(kept.values()):
        print(f"Nothing of {_shown(tracks)} in {store}")
        return
    print(f"{_shown(tracks)} in {store}: {_counted(kept)}")
    raise SystemExit(Exit.NO)


@people_app.command(name="forget")
def forget(
    store: StorePlace,
    person: Person,
    /,
    *,
    run: Run = None,
    also: Annotated[list[Path] | None, Parameter(negative="", consume_multiple=True)] = None,
) -> None:
    """Remove all that a store has of a person: poses, times, events, zones, the name.

    Example: `e3pose people forget site.toml Ada --also backup.db january.parquet`

    The files are written anew, so that nothing is left in their bytes. It works while the site
    runs, which keeps its slots in a spool meanwhile; somebody who is still there is stored again.

    With a site as STORE, its other files as well: the state that the edge resumes from, poses that
    it learns from, and files that the page made. Recordings, in which nobody can be deleted, are
    named; exit code 1 while anything is left.

    Parameters
    ----------
    also
        Copies of the store, and tables of `query`, `replay --poses` and `export` (.csv, .json,
        .parquet), to forget the person in.
    """
    from e3pose.output.archive.deleting import delete_everywhere
    from e3pose.site.traces import forget_beside
    from e3pose.store.people import people_of, requests_of, write_anew

    place, tracks = _found(store, person, run)
    for path in also or ():
        if not path.is_file():
            raise InputError(f"--also: {path}: file not found")
    there = [one for one in people_of(place) if set(one.tracks) & set(tracks)]
    asked = requests_of(place, tracks)
    for path in also or ():
        if path.suffix.lower() in FORMS:
            print(f"{path}: {plural(forget_rows(path, tracks), 'row')} deleted")
    print(f"Forgets {_shown(tracks)}")
    left = False
    site = None if store_of(store, None)[1] is None else resolve_site(Path(store))
    if site is not None:
        span_ns = (
            min((person.first_ns for person in there), default=time.time_ns()),
            max((person.last_ns for person in there), default=0),
        )
        for trace in forget_beside(site, asked, span_ns):
            print(f"{trace.place}: {trace.said}")
            left |= trace.left
    stores = [str(path) for path in also or () if path.suffix.lower() not in FORMS]
    for where in (*stores, place):
        for one in (one for what in asked for one in delete_everywhere(where, what)):
            print(f"{one.place}: {one.problem or f'{one.rows} rows deleted, {one.left} left'}")
            left |= one.left != 0
        write_anew(where)
    if any(time.time() - person.last_ns / 1e9 < THERE_S for person in there):
        warn("the person was there until now: forget again when they are gone")
    if left:
        print(
            "not everywhere: see to the places that remain (archives: e3pose archive), then again"
        )
        raise SystemExit(Exit.NO)


def _found(store: str, person: str, run: int | None) -> tuple[str, tuple[Track, ...]]:
    """Return the place of a store, and the tracks of a person in it."""
    from e3pose.store.people import tracks_of

    check_numbers({"--run": (run,), "PERSON": (int(person),) if person.isdecimal() else ()})
    place, site = store_of(store, None)
    return place, tracks_of(place, person, site, run)


def _shown(tracks: Sequence[Track]) -> str:
    runs = dict.fromkeys(run for run, _ in tracks)
    return "; ".join(
        f"run {run} track {', '.join(str(track) for of, track in tracks if of == run)}"
        for run in runs
    )


def _counted(rows: dict[str, int]) -> str:
    counts = [plural(count, table[:-1]) for table, count in rows.items() if count]
    return ", ".join(counts) or "nothing"
