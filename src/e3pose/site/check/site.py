"""Check a site before it runs: ask its edge, try its sources, time its networks, then judge."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from datetime import datetime
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.detectors.timing import DetectionTimes
from e3pose.settings.resolved import ResolvedSite
from e3pose.site.check.clock import check_clock
from e3pose.site.check.finding import Finding
from e3pose.site.check.link import check_link_of
from e3pose.site.check.places import check_places
from e3pose.site.check.rig import check_calibration, uncalibrated
from e3pose.site.check.running import check_running
from e3pose.site.check.settings import (
    check_budgets,
    check_events,
    check_feedback,
    check_skeletons,
    check_watts,
)
from e3pose.site.check.sources import check_rates, check_sources
from e3pose.site.detector_speed import check_speed, measure_detections
from e3pose.site.edge_program import check_edge
from e3pose.site.follow import status_of, viewer_link

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
    parts = check_edge(site) if site.rig.placed else None
    edge, runs = _ask_edge(site, keys, timeout_s)
    sources = list(check_sources(site))
    usable = not quick and all(finding.level != "problem" for finding in sources)
    if usable and not runs:
        with counting as progress:  # a running site has the devices, and counts frames itself
            sources += check_rates(site, progress)
    times = _measure(site, measuring) if usable else None

    if parts is None:
        found = [uncalibrated(site)]
    else:
        found = [
            *check_calibration(site.rig),
            *check_skeletons(site),
            *check_feedback(site),
            *check_events(site),
            *check_watts(site),
            *check_budgets(site, parts, datetime.now().astimezone()),
        ]
    found += [*check_link_of(site), *check_places(site.file), *sources]
    if isinstance(times, InputError):
        found.append(Finding("problem", "network", str(times)))
    elif times is not None:
        selected = min(site.loop.num_selected or len(site.rig), len(site.rig))
        found += check_speed(site.file, times, selected)
    return [*found, check_clock(site.file.link.endpoint), *edge]


def _ask_edge(
    site: ResolvedSite, keys: Path | None, timeout_s: float
) -> tuple[list[Finding], bool]:
    """Return the findings of the edge, and whether it runs."""
    try:
        link = viewer_link(site.file, keys)
        status = status_of(link, timeout_s)
    except InputError as error:
        return [Finding("warning", "edge", f"cannot connect: {error}")], False
    return [*check_running(status, link.endpoint)], status is not None


def _measure(
    site: ResolvedSite, measuring: AbstractContextManager[object]
) -> DetectionTimes | InputError | None:
    """Return the detection times; None without detections on this machine."""
    try:
        with measuring:
            return measure_detections(site)
    except InputError as error:
        return error
