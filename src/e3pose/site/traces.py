"""Forget a person in the files of a site beside its store, and name the files left over."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.lock import hold
from e3pose.base.quantities import plural
from e3pose.edge.checkpoint import forget_people
from e3pose.edge.learn.ring_buffer import Ring, forget_poses
from e3pose.estimate.filter.reidentification import DEPARTED_S
from e3pose.settings.resolved import ResolvedSite
from e3pose.site.keep.jobs import FILES, jobs_in
from e3pose.site.keep.recordings import kept_recordings
from e3pose.store.database import database_path, database_url
from e3pose.store.forgetting import Forgotten

NS = 10**9


@dataclass(frozen=True, slots=True)
class Trace:
    """A place that has, or had, something of a person.

    Attributes:
        place: file or folder.
        said: what became of it.
        left: whether something is still there.
    """

    place: Path
    said: str
    left: bool = False


def forget_beside(
    site: ResolvedSite, asked: Sequence[Forgotten], span_ns: tuple[int, int]
) -> Iterator[Trace]:
    """Forget a person in the files of a site; yield what became of each.

    Args:
        site: what its file says.
        asked: the person's tracks.
        span_ns: when the person was there, first and last.
    """
    yield from _in_state(site, span_ns[1])
    learned = None if site.file.learn is None else site.file.learn / "poses"
    if learned is not None and learned.is_dir():
        ids = [one.track_id for one in asked if one.track_id is not None]
        joints, files = site.skeleton.joints, Ring(learned, site.skeleton, 0).files()
        if rows := sum(forget_poses(path, joints, ids, span_ns) for path in files):
            yield Trace(learned, f"{plural(rows, 'row')} deleted")
    folder = site.file.folder / FILES
    for job in jobs_in(folder):  # the page makes them again, without the person
        if job.request.start_ns <= span_ns[1] and job.request.end_ns >= span_ns[0]:
            shutil.rmtree(folder / job.number, ignore_errors=True)
            yield Trace(folder / job.number, f"{job.request.file_name}: deleted")
    yield from _in_copies(site, span_ns)


def _in_state(site: ResolvedSite, last_ns: int) -> Iterator[Trace]:
    """Everybody leaves the state of an edge that does not run: who is there is found anew."""
    path = site.file.state
    if path is None:
        return
    unusable = path.with_name(f"{path.name}.unusable")
    if unusable.exists():
        unusable.unlink()
        yield Trace(unusable, "deleted")
    if not path.exists():
        return
    with ExitStack() as stack:
        try:
            stack.enter_context(hold(path))
        except InputError:
            if (wait_s := DEPARTED_S - (time.time() - last_ns / NS)) > 0:
                words = f"the running edge knows who left for {DEPARTED_S / 60:g} minutes"
                yield Trace(path, f"{words}: run this again in {wait_s:.0f} s", left=True)
            return
        try:
            forget_people(path, site.pipeline())
            yield Trace(path, "people deleted")
        except InputError:  # of no use to an edge either
            path.unlink()
            yield Trace(path, "deleted, as no edge can read it")


def _in_copies(site: ResolvedSite, span_ns: tuple[int, int]) -> Iterator[Trace]:
    """Name what nobody can be taken out of: recordings of that time, files set aside, pictures."""
    with suppress(OSError):
        for folder in {site.file.record.path, site.file.folder}:
            for kept in kept_recordings(folder):
                end_ns = (folder / kept.name / "recording.toml").stat().st_mtime_ns
                begun_ns = kept.start_ns or end_ns - round(kept.seconds * NS)
                if begun_ns <= span_ns[1] and end_ns >= span_ns[0]:
                    said = "a recording of that time: delete it, or keep it knowingly"
                    yield Trace(folder / kept.name, said, left=True)
    store = None if site.file.store is None else database_path(database_url(site.file.store.place))
    aside = [] if store is None else [f"{store.name}.corrupt-*", f"{store.name}.damaged-spool-*"]
    for pattern in (*aside, "walk-pictures"):
        for path in sorted((store or site.file.path).parent.glob(pattern)):
            yield Trace(path, "may have the person: delete it", left=True)
