"""`e3pose stream`: what a running site publishes, for other programs."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from e3pose.base.errors import Fault, InputError, reason_of
from e3pose.base.quantities import check_seconds
from e3pose.cli.options import Flag, warn
from e3pose.cli.running import begin
from e3pose.events.watch import Watch, site_watch
from e3pose.settings.events_table import EventsTable
from e3pose.settings.resolved import ResolvedSite, resolve_site
from e3pose.site.connect import Connection
from e3pose.site.follow import viewer_link
from e3pose.site.run import run_until_stopped
from e3pose.site.stream_problems import ProblemFile
from e3pose.site.streams import Source, Stream, naming, open_stream
from e3pose.site.streams.send import RETRY_S, UNAVAILABLE, Awaited, Sender
from e3pose.site.trial_notices import Answerer
from e3pose.site.zones import Zones

FIRST_SLOT_S = 60.0  # to wait for what --for counts from
RUNNING = "an edge that runs, with cameras online (`e3pose top`)"


def stream(
    site: Path,
    target: Annotated[list[str], Parameter(consume_multiple=True)],
    /,
    *,
    delayed: Flag = False,
    keys: Path | None = None,
    for_s: Annotated[float | None, Parameter(name="--for")] = None,
) -> None:
    """Stream poses and events live to OSC, LSL, VMC, Foxglove, MQTT, Home Assistant and others.

    Example: `e3pose stream site.toml osc://127.0.0.1:9000 mcap:today.mcap`

    Only mqtts, homeassistants and webhook:https are encrypted. A program that is too slow misses
    slots. Ctrl-C stops.

    Parameters
    ----------
    site
        Site file, or the folder that contains site.toml.
    target
        osc://HOST:PORT, vmc://HOST:PORT and vrchat://HOST:PORT (one person as an avatar),
        lsl:NAME, foxglove://HOST:PORT, mcap:FILE.mcap, mqtt://HOST:PORT, mqtts://HOST:PORT,
        homeassistant://HOST:PORT or homeassistants://HOST:PORT (a broker) and webhook:https://URL
        (what people do, as [events] of the site file says, and no poses). The secret of a
        webhook: in the file that E3POSE_WEBHOOK_SECRET_FILE names. User and password of a broker:
        E3POSE_MQTT_USER, E3POSE_MQTT_PASSWORD in the environment, or the file that
        E3POSE_MQTT_PASSWORD_FILE names.
    delayed
        Stream the smoothed poses that the edge publishes later, as `smooth_delay_ms` of the site
        file or its --delay says, in place of those at once.
    keys
        Folder from `e3pose keys add NAME --viewer`. Default on the edge server: the first viewer.
    for_s
        Stop this many seconds after the first slot, which must come within a minute. Default: at
        Ctrl-C.
    """
    begin()
    check_seconds("--for", for_s)
    from e3pose.wire.network import open_network

    if not target:
        raise InputError("TARGET", "none", "one at least, such as osc://127.0.0.1:9000")
    resolved = resolve_site(site)
    watch = site_watch(resolved)
    source = _source(resolved, watch)
    link = viewer_link(resolved.file, keys)
    with ExitStack() as stack:
        streams = list[Stream]()
        for one in target:
            opening = partial(open_stream, one, naming(source, resolved.file, one))
            try:
                streams.append(opening())
            except UNAVAILABLE as error:
                streams.append(Awaited(opening, f"{one}: {reason_of(error)}", warn))
            stack.callback(streams[-1].close)
        away = [each.reason for each in streams if isinstance(each, Awaited)]
        if len(away) == len(streams):
            raise Fault(away[0])
        for reason in away:
            warn(f"{reason}; the others go on, tried again every {RETRY_S:g} s")
        connection = stack.enter_context(
            Connection(resolved.file.name, open_network(link), delayed=delayed)
        )
        sender = stack.enter_context(
            Sender(connection, streams, Zones(resolved.file.zone), warn, watch)
        )
        problems = stack.enter_context(closing(ProblemFile(resolved.file.path)))
        answerer = stack.enter_context(closing(Answerer(resolved.file.path, streams)))
        what = "smoothed poses of site" if delayed else "site"
        print(f"Streaming {what} {resolved.file.name} to {', '.join(target)}", flush=True)
        begun_s = time.monotonic()

        def runs() -> bool:
            problems.update(streams)
            answerer.update()
            return sender.running() and not _over(sender, begun_s, for_s)

        run_until_stopped(runs)
        if sender.failure is not None:
            raise Fault(str(sender.failure)) from sender.failure
    print(f"Sent {sender.sent} slots, {connection.dropped} lost", file=sys.stderr)


def _source(site: ResolvedSite, watch: Watch | None) -> Source:
    """Return the stream, without names."""
    return Source(
        site.file.name,
        site.skeleton,
        site.file.fps,
        warn,
        site.rig.camera_ids,
        tuple(zone.name for zone in site.file.zone),
        () if watch is None else tuple(watch.rules),
        site.file.events or EventsTable(),
        site.rig.titles,
    )


def _over(sender: Sender, begun_s: float, for_s: float | None) -> bool:
    """Return whether it has sent for so long; raise `InputError` if there was nothing to send."""
    if for_s is None or sender.first_s is not None:
        return for_s is not None and time.monotonic() - (sender.first_s or 0.0) >= for_s
    if time.monotonic() - begun_s >= FIRST_SLOT_S:
        raise InputError(f"site {sender.site}", f"no slot in {FIRST_SLOT_S:g} s", RUNNING)
    return False
