"""Compare the calibration of a site with the one length that is known: people."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.quantities import shell
from e3pose.calibrate.people_3d import People3D, doubt_people, doubt_placed
from e3pose.model.noises import detector_of, load_noise
from e3pose.recording import load_recording
from e3pose.settings.resolved import ResolvedSite
from e3pose.settings.sources import is_recorded, place_of
from e3pose.site.check.finding import Finding, ok, warning
from e3pose.site.keep.recordings import kept_recordings

MOST_POSES = 2000  # of a run, from its beginning
MOST_RECORDINGS = 3  # kept ones that are tried, the newest first
Doubt = tuple[str, str | None]  # what was compared, and what is wrong; None where nobody tells


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
        said = words.replace("CALIBRATION", shell(file))
        yield warning("people", f"{file}: {said} (by {of_what})")
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
            yield f"poses of run {one.run_id}", doubt_placed(people)


def _recorded(site: ResolvedSite) -> Iterator[Doubt]:
    """Compare the recordings that cameras play, and those that the site kept."""
    sources = (each.source or "" for each in site.cameras.values())
    paths = [Path(place_of(source) or "") for source in sources if is_recorded(source)]
    kept = kept_recordings(site.file.record.path)[:MOST_RECORDINGS]
    for path in dict.fromkeys([*paths, *(site.file.record.path / one.name for one in kept)]):
        recording = load_recording(path)
        ids = recording.rig.camera_ids
        if set(ids) <= set(site.rig.camera_ids):
            rig = site.rig.subset([site.rig.index(name) for name in ids])
            noise = load_noise(detector_of(recording))
            yield str(path), doubt_people(replace(recording, rig=rig), noise)
