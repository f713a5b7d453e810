"""The parts of a site that list what is wrong with them before it starts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from e3pose.settings.resolved import ResolvedSite
from e3pose.site.check.finding import Finding
from e3pose.site.check.link import clock_problems, link_problems
from e3pose.site.check.places import place_problems
from e3pose.site.check.settings import (
    budget_problems,
    event_problems,
    feedback_problems,
    rig_problems,
    skeleton_problems,
    watt_problems,
)

Problems = Callable[[ResolvedSite], Iterable[Finding]]

# In the order in which a site is set up.
PARTS: Mapping[str, Problems] = {
    "calibration": rig_problems,
    "skeleton": skeleton_problems,
    "feedback": feedback_problems,
    "events": event_problems,
    "watts": watt_problems,
    "budget": budget_problems,
    "link": link_problems,
    "disks": lambda site: place_problems(site.file),
    "clock": lambda site: clock_problems(site.file.link.endpoint),
}


def start_problems(site: ResolvedSite) -> Iterator[Finding]:
    """Yield what all parts of a site find before it starts."""
    for problems in PARTS.values():
        yield from problems(site)
