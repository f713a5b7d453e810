"""Check a site: all its parts list what is wrong with them, at its start and for `e3pose check`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.settings.resolved import ResolvedSite
from e3pose.site.check.finding import Finding, ok, problem, warning
from e3pose.site.check.parts import PARTS
from e3pose.site.check.people import people_problems
from e3pose.site.check.places import store_problems
from e3pose.site.check.running import running_problems
from e3pose.site.check.sources import hub_problems, rate_problems, source_problems
from e3pose.site.detector_speed import measure_detections, speed_problems
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
            found += list(findings) or [ok(name)]
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
