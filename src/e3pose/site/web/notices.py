"""Notices for viewers of a site, in plain sentences."""

from __future__ import annotations

import datetime
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.edge.camera_state import sleeps_as_told
from e3pose.settings.resolved import ResolvedSite
from e3pose.site.connect import LiveSlot
from e3pose.site.stream_problems import problems_of
from e3pose.store.database import database_path, database_url
from e3pose.wire.keys.renewal import expiring, renewal_advice
from e3pose.wire.site_messages import Status

LOOK_S = 10.0  # between two looks at disk, certificates and streams
LEAST_FREE = 200_000_000  # bytes that a disk should have left
BEHIND_S = 30.0  # so long the store may need for a slot
STARTING_S = 20.0  # cameras connect meanwhile


class Notice(NamedTuple):
    """A notice: its kind, for styles and tests, and a sentence."""

    kind: str
    text: str


class Around(NamedTuple):
    """Surroundings of a site: free bytes on the store's disk, certificates with their ends.

    None where the store is not a file of this machine. And what is wrong with streams, a line each.
    """

    free: int | None = None
    certificates: Sequence[tuple[str, datetime.datetime]] = ()
    problems: Sequence[str] = ()


def notices(
    status: Status, slot: LiveSlot | None, around: Around, now: datetime.datetime
) -> list[Notice]:
    """Return the notices of a site, the most urgent first.

    Args:
        status: its newest.
        slot: likewise.
        around: what surrounds it.
        now: the time, UTC.
    """
    found = [Notice("overload", status.overload)] if status.overload else []
    found += [Notice("calibration", status.doubt)] if status.doubt else []
    gone = [c for c in status.cameras if not (c.online or c.paused or sleeps_as_told(c))]
    if gone and status.uptime_s > STARTING_S:
        reasons = _listed([f"{c.title} ({c.why})" if c.why else c.title for c in gone])
        words = f"{plural(len(gone), 'camera')} of {len(status.cameras)} gone: {reasons}."
        nobody = "No camera is connected: nobody is seen."
        all_gone = len(gone) == len(status.cameras)
        found.append(Notice("camera-gone", nobody if all_gone else words))
    if around.free is not None and around.free < LEAST_FREE:
        left = f"The disk of the store is almost full: {around.free / 1e6:.0f} MB left. "
        found.append(Notice("disk", left + "Make room, or keep less: [store] of the site file."))
    if slot is not None and (kept := _store_words(slot, status)):
        found.append(Notice("store", kept))
    found += [Notice("stream", f"{one[0].upper()}{one[1:]}.") for one in around.problems if one]
    running = [one for one in status.cameras if one.online and one.battery is not None]
    if flat := [one.title for one in running if (one.battery or 0.0) < 0.1]:
        found.append(Notice("battery", f"Battery almost empty: {_listed(flat)}."))
    for name, until in around.certificates:
        found.append(Notice("certificate", _certificate_words(name, until, now)))
    return found


@dataclass(eq=False)
class Surroundings:
    """Looks at the disk and at the certificates of a site now and then.

    Attributes:
        store: file of the store; None where it has none on this machine.
        keys: folder of the site's keys; None where it has none.
        now_s: a clock that only goes forward.
        site: its file; None where nobody looks beside it.
    """

    store: Path | None = None
    keys: Path | None = None
    now_s: Callable[[], float] = time.monotonic
    site: Path | None = None
    _due_s: float = 0.0
    _seen: Around = field(default_factory=Around)

    def look(self, now: datetime.datetime) -> Around:
        """Return the site's surroundings, at most `LOOK_S` old."""
        if self.now_s() < self._due_s:
            return self._seen
        self._due_s = self.now_s() + LOOK_S
        free, certificates = None, self._seen.certificates
        if self.store is not None and self.store.parent.is_dir():
            free = shutil.disk_usage(self.store.parent).free
        if self.keys is not None:
            try:
                certificates = tuple(expiring(self.keys, now))
            except InputError:  # being replaced, or not on this machine
                certificates = ()
        problems = () if self.site is None else tuple(problems_of(self.site))
        self._seen = Around(free, certificates, problems)
        return self._seen


def surroundings(site: ResolvedSite) -> Surroundings:
    """Return the observer of a site's surroundings."""
    place = None if site.file.store is None else database_path(database_url(site.file.store.place))
    return Surroundings(place, site.file.link.keys, site=site.file.path)


def _store_words(slot: LiveSlot, status: Status) -> str:
    behind_s = (slot.slot - slot.stored_to) / max(status.fps, 0.1)
    begun_s = (slot.slot - slot.stored_from) / max(status.fps, 0.1)
    if slot.stored_from >= 0 and min(behind_s, begun_s) > BEHIND_S:
        return (
            f"The store takes nothing: the last {_minutes(min(behind_s, begun_s))} wait on the "
            "edge. Is its disk full?"
        )
    return ""


def _minutes(seconds: float) -> str:
    return plural(round(seconds / 60), "minute") if seconds >= 90 else f"{seconds:.0f} seconds"


def _certificate_words(name: str, until: datetime.datetime, now: datetime.datetime) -> str:
    advice = renewal_advice(name)
    if until < now:
        return f"The certificate of {name} expired on {until:%Y-%m-%d}: {advice}."
    left = plural(max((until - now).days, 0), "day")
    return f"The certificate of {name} expires in {left}, on {until:%Y-%m-%d}: {advice}."


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
