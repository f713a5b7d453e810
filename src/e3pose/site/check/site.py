"""Check a site: all its parts list their problems, at its start and for `e3pose check`."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.calibrate.people_3d import People3D, doubt_people, doubt_placed
from e3pose.edge.camera_state import sleeps_as_told
from e3pose.model.blind_slot import blind_words
from e3pose.model.noises import detector_of, load_noise
from e3pose.recording import load_recording
from e3pose.settings.resolved import ResolvedSite
from e3pose.settings.sources import is_recorded, place_of
from e3pose.site.check.finding import Finding, ok, problem, warning
from e3pose.site.check.link import CLOCK_MS
from e3pose.site.check.parts import PARTS
from e3pose.site.check.places import store_problems
from e3pose.site.check.sources import hub_problems, rate_problems, source_problems
from e3pose.site.detector_speed import measure_detections, speed_problems
from e3pose.site.edge_program import check_edge
from e3pose.site.follow import status_of, viewer_link
from e3pose.site.keep.recordings import kept_recordings
from e3pose.wire.endpoint import Endpoint
from e3pose.wire.site_messages import Status

LISTEN_S = 1.0  # to find out whether a port is taken
BLIND_SHARE = 0.02  # of the last minute's slots
MOST_POSES = 2000  # of a run, from its beginning
MOST_RECORDINGS = 3  # kept ones that are tried, the newest first
Doubt = tuple[str, str | None]  # what was compared, and what is wrong; None where nobody tells
Counting = AbstractContextManager[Callable[[int, int], None]]


def examine_site(
    site: ResolvedSite,
    keys: Path | None,
    timeout_s: float,
    counting: Counting,
    measuring: AbstractContextManager[object],
    quick: bool = False,
) -> list[Finding]:
    """Return the findings of a site, in the order of its set-up.

    Args:
        site: what its file says; its cameras may have no places.
        keys: folder of a viewer's certificates; None for the keys of the site.
        timeout_s: how long to wait for the edge, if it runs.
        counting: entered while frames are counted; yields what takes cameras done, and all.
        measuring: entered while networks are measured.
        quick: do not measure how long the networks take, nor count frames.

    Raises:
        InputError: for settings that keep its edge from starting.
    """
    if site.rig.placed:
        check_edge(site)
    running, runs = _ask_edge(site, keys, timeout_s)
    sources = [*source_problems(site), *hub_problems(site)]
    usable = not quick and all(finding.level != "problem" for finding in sources)
    if usable and not runs:
        with counting as progress:  # a running site has the devices, and counts frames itself
            sources += rate_problems(site, progress)
    network = list(_network(site, measuring)) if usable else None
    people = None if runs or not site.rig.placed else list(people_problems(site))
    more: dict[str, Iterable[Finding] | None] = {
        "store": store_problems(site.file),
        "people": people,
        "sources": sources,
        "network": network,
        "edge": running,
    }
    found: list[Finding] = []
    for name, findings in [*((name, part(site)) for name, part in PARTS.items()), *more.items()]:
        if findings is not None:
            told = any(each.what == name for each in found)
            found += list(findings) or [ok(name)] * (not told)
    return found


def _ask_edge(
    site: ResolvedSite, keys: Path | None, timeout_s: float
) -> tuple[list[Finding], bool]:
    """Return the findings of the edge, and whether it runs."""
    try:
        link = viewer_link(site.file, keys)
        status = status_of(link, timeout_s)
    except InputError as error:
        return [warning("edge", f"cannot connect: {error}")], False
    return list(running_problems(status, link.endpoint)), status is not None


def running_problems(status: Status | None, endpoint: Endpoint) -> Iterator[Finding]:
    """Yield how the running edge and its cameras are, if there is one.

    Args:
        status: what it says; None if it does not answer.
        endpoint: where it was asked.
    """
    if status is None:
        found, advice = f"not running at {endpoint}", "e3pose edge, or e3pose up on one machine"
        host, port = endpoint.address
        with suppress(OSError):
            socket.create_connection((host, port), LISTEN_S).close()
            found = f"something listens at {endpoint}, but no edge of this site answers"
            advice = f"wait while it starts, or see whose port it is: ss -ltnp 'sport = :{port}'"
        yield warning("edge", found, advice)
        return
    yield ok("edge", f"running, slot {status.slot}, lead {status.lead}")
    advice = "a faster machine, fewer slots per second (fps) or fewer cameras"
    yield from [warning("edge", status.overload, advice)] * bool(status.overload)
    yield from [problem("calibration", status.doubt)] * bool(status.doubt)
    if status.blind_share > BLIND_SHARE:
        found = f"{status.blind_share:.0%} of the last minute's slots blind"
        advice = f"since its start: {blind_words(status.blind)}; docs/how-to/monitor.md"
        yield warning("edge", found, advice)
    for camera in status.cameras:
        what = f"camera {camera.camera_id}"
        if sleeps_as_told(camera):
            yield ok(what, camera.why)
        elif not camera.online:
            advice = "see its log"
            if camera.battery == 0 and not camera.gauge:
                advice = "charge it, then delete NAME.battery.json beside its camera file"
            yield problem(what, camera.why, advice)
        elif camera.turned_deg is not None:
            found = f"has moved: turned by {camera.turned_deg:.1f} degrees or more"
            advice = f"e3pose calibrate extrinsics SITE --only {camera.camera_id}"
            yield warning(what, found, advice)
        elif camera.why:
            yield warning(what, camera.why)
        elif abs(camera.clock_offset_ms) > CLOCK_MS:
            found = f"clock offset {camera.clock_offset_ms:+.1f} ms"
            yield warning(what, found, "corrected; for fast motion use chrony or PTP")
        else:
            found = f"connected, clock offset {camera.clock_offset_ms:+.1f} ms"
            if camera.unchanged is not None:
                found += f", image unchanged in {camera.unchanged:.0%} of its looks"
            yield ok(what, found)


def _network(site: ResolvedSite, measuring: AbstractContextManager[object]) -> Iterator[Finding]:
    """Yield how long detections take, and whether that is too long."""
    try:
        with measuring:
            times = measure_detections(site)
    except InputError as error:
        yield problem("network", str(error))
        return
    if times is not None:
        yield from speed_problems(
            site.file, times, min(site.loop.num_selected or len(site.rig), len(site.rig))
        )


def people_problems(site: ResolvedSite) -> Iterator[Finding]:
    """Yield whether people of a run or recording have people's size, and stand upright."""
    file = site.file.calibration
    try:
        found = (each for part in (_stored, _recorded) for each in part(site))
        of_what, words = next(each for each in found if each[1] is not None)
    except StopIteration:
        yield ok("people", "nothing to compare the calibration with: no people are stored yet")
        return
    except InputError as error:
        yield warning("people", f"not compared with the calibration: {error}")
        return
    if words:
        yield warning("people", f"{file}: {words} (by {of_what})")
    else:
        yield ok("people", f"of people's size and upright, by {of_what}")


def _stored(site: ResolvedSite) -> Iterator[Doubt]:
    """Compare the runs of the store that began with this calibration, the newest first."""
    place = None if site.file.store is None else site.file.store.place
    if place is None or (isinstance(place, Path) and not place.is_file()):
        return
    from e3pose.store import Store

    store, written_ns = Store(place), site.file.calibration.stat().st_mtime_ns
    for one in reversed(store.runs()):
        run = one.run
        if run.site != site.file.name or run.started_ns < written_ns:
            continue
        found = store.read(run=one.run_id, chunk=MOST_POSES)
        poses = next((chunk for chunk in found if len(chunk)), None)
        if poses is not None:
            joints_m, who = poses.people.joints_m.astype(float), poses.people.track_ids
            people = People3D(joints_m, who, poses.slots, run.limbed, 1 / run.interval_s)
            yield f"poses of run {one.run_id}", doubt_placed(people, site.file.calibration)


def _recorded(site: ResolvedSite) -> Iterator[Doubt]:
    """Compare played recordings, and those that the site kept, with its calibration."""
    sources = (each.source or "" for each in site.cameras.values())
    paths = [Path(place_of(source) or "") for source in sources if is_recorded(source)]
    kept = kept_recordings(site.file.record.path)[:MOST_RECORDINGS]
    for path in dict.fromkeys([*paths, *(site.file.record.path / one.name for one in kept)]):
        recording = load_recording(path)
        ids = recording.rig.camera_ids
        if set(ids) <= set(site.rig.camera_ids):
            rig = site.rig.subset([site.rig.index(name) for name in ids])
            noise = load_noise(detector_of(recording))
            yield str(path), doubt_people(replace(recording, rig=rig), noise, site.file.calibration)
