"""`e3pose events`: test in your own room the detection of falls."""

from __future__ import annotations

import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter
from msgspec import to_builtins

from e3pose.base.errors import Exit, InputError
from e3pose.base.quantities import check_seconds
from e3pose.cli.options import OUTPUT, warn
from e3pose.cli.output import JsonFile, is_stdout, write_json
from e3pose.cli.placed import load_placed
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.events import trial as trials
from e3pose.events import watch as watching
from e3pose.events.people import Seen
from e3pose.events.watch import Watch, begin_watch, site_watch
from e3pose.settings.events_table import EventsTable
from e3pose.settings.resolved import resolve_site
from e3pose.site.connect import Connection
from e3pose.site.follow import viewer_link

if TYPE_CHECKING:
    from e3pose.events.trial import Trial

events_app = App(name="events", help="Test event alerts.")
PATIENCE_S = 10.0  # without anybody, before that is said
AFTER_S = 3.0  # after somebody got up from a fall, it is over
Look = tuple[Seen, int]  # people, and when the slot was published


@events_app.command(name="test")
def test(
    source: Path,
    /,
    *,
    for_s: Annotated[float, Parameter(name="--for")] = 120.0,
    cameras: Annotated[float | None, Parameter(alias="-C")] = None,
    keys: Path | None = None,
    json_file: Annotated[JsonFile, Parameter(group=OUTPUT)] = None,
) -> None:
    """Test fall detection: lie down and watch what is reported.

    Example: `e3pose events test site.toml`

    Start it beside a running site, walk into the room, go down as somebody who falls would (onto a
    mattress), lie still for half a minute, get up. It prints what each person does, when a fall or
    a long lie was reported and after how many seconds, or why not. It ends when you got up after a
    fall, after two minutes, or at Ctrl-C. Nothing is stored or sent. Exit code 1:
    neither a fall nor a long lie was reported.

    Try each place where somebody could fall: behind the bed, in the doorway, under the table.

    Parameters
    ----------
    source
        A running site: its file, or the folder that contains site.toml. Or a recording, which is
        replayed.
    for_s
        Seconds of a site to follow, from its first slot.
    cameras
        Cameras per slot of a recording. Default: 2.
    keys
        Folder from `e3pose keys add NAME --viewer`. Default on the edge server: the first viewer.
    json_file
        Write the result and the events here as JSON; - is standard output.
    """
    check_seconds("--for", for_s)

    recorded = (source / "recording.toml").is_file()
    if cameras is not None and not recorded:
        raise InputError("--cameras", f"{cameras:g} with a site", "a recording")
    say = (lambda line: None) if is_stdout(json_file) else _say
    found, table, watch, looks = _replayed(source, cameras) if recorded else _live(source, keys)
    say(found)
    trial = trials.Trial()
    try:
        for line, newest in _followed(looks, watch, None if recorded else for_s):
            trial = newest
            say(line)
    except KeyboardInterrupt:
        pass
    result = trials.account(trial, table)
    say("\n" + result)
    write_json(json_file, {"result": result, "told": [to_builtins(one) for one in trial.told]})
    if not (trial.was_told("fall") or trial.was_told("on-floor")):
        raise SystemExit(Exit.NO)


def _say(line: str) -> None:
    if line:
        print(line, flush=True)


def _live(source: Path, keys: Path | None) -> tuple[str, EventsTable, Watch, Iterator[Look]]:
    """Return the first line to print, settings, and the slots of a running site."""
    from e3pose.wire.network import open_network

    site = resolve_site(source)
    asked, table = site_watch(site), site.file.events or EventsTable()
    watch = asked or begin_watch(table, site.skeleton.joints, site.file.zone)
    if asked is None:
        warn(
            f"{site.file.path}: no [events], so the site itself tells nothing; "
            "tested with the usual"
        )
    link = viewer_link(site.file, keys)

    def looks() -> Iterator[Look]:
        with Connection(site.file.name, open_network(link)) as connection:
            for slot in connection:
                yield slot, slot.published_ns

    lies = f"lie still for {max(table.fall_s, table.lies_s) + 5:.0f} s"
    return f"Watching site {site.file.name}. Go down, {lies}, get up.", table, watch, looks()


def _replayed(
    source: Path, cameras: float | None
) -> tuple[str, EventsTable, Watch, Iterator[Look]]:
    """Return the same of a recording that is replayed."""
    recording, table = load_placed(source), EventsTable()
    settings = ReplaySettings() if cameras is None else ReplaySettings(num_selected=cameras)

    def looks() -> Iterator[Look]:
        for record in replay(recording, settings):
            time_ns = round(record.time_s * 1e9)
            yield Seen(record.slot, time_ns, record.people), time_ns

    return f"Replaying {source}", table, begin_watch(table, recording.skeleton.joints), looks()


def _followed(
    looks: Iterator[Look], watch: Watch, for_s: float | None
) -> Iterator[tuple[str, Trial]]:
    """Yield after each slot the lines to print and everything seen so far."""
    trial, begun_s, up_ns, patient = trials.Trial(), time.monotonic(), 0, True
    for seen, told_ns in looks:
        watch, events = watching.advance(watch, seen)
        trial, lines = trials.advance(trial, watch, events, told_ns)
        if patient and not trial.stays and trial.time_ns - trial.begun_ns > PATIENCE_S * 1e9:
            patient = False
            lines.append(trials.NOBODY_SEEN)
        clock = datetime.fromtimestamp(watch.time_ns / 1e9).strftime("%H:%M:%S")
        at = f"{watch.time_ns / 1e9:6.1f} s" if for_s is None else clock
        yield "\n".join(f"{at}  {line}" for line in lines), trial
        if not up_ns and trial.was_told("fall") and trial.was_told("got-up"):
            up_ns = watch.time_ns
        over = up_ns and watch.time_ns - up_ns >= AFTER_S * 1e9
        if for_s is not None and (over or time.monotonic() - begun_s >= for_s):
            return
