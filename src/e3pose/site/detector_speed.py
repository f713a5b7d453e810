"""Check that detectors are fast enough for a site on this machine."""

from __future__ import annotations

import json
import platform
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from e3pose.base.atomic import write_file
from e3pose.base.bounded import read_bytes
from e3pose.base.quantities import plural
from e3pose.base.system import num_cores
from e3pose.camera.orientation import Orientation
from e3pose.detectors.timing import DEFAULT_SIZE, DetectionTimes, Workload, time_detections
from e3pose.settings.resolved import ResolvedSite
from e3pose.settings.site_file import SiteTable
from e3pose.settings.sources import detects
from e3pose.site.check.finding import Finding, ok, problem, warning

KEPT = "look-times.json"  # beside the site file
MAX_BYTES = 10**5
SPARE = 0.8  # of what a machine reaches, for what else it does: decoding, fusing, other programs
WAIT_S = 0.04  # of a view for its frame and its way to the edge, beyond the detection
HOPELESS = 1.5  # times what is reached: a busy moment's measurement errs by less


def workloads_of(site: ResolvedSite, without: Collection[str] = ()) -> dict[str, Workload]:
    """Return the cameras whose networks `e3pose up` runs here, with their settings.

    Args:
        site: what its file says.
        without: cameras to leave out.
    """
    found = {}
    for (name, camera), seen in zip(site.cameras.items(), site.rig.cameras, strict=True):
        if name in without or camera.source is None or detects(camera.source):
            continue
        found[name] = Workload(
            camera.detector or "",
            camera.model,
            camera.provider,
            camera.threads,
            Orientation.from_degrees(camera.rotation or 0).size(*seen.image_size),
        )
    return found


def measure_detections(
    site: ResolvedSite, again: bool = True, without: Collection[str] = ()
) -> DetectionTimes | None:
    """Return how long detections take on this machine; None if it runs no network.

    Args:
        site: what its file says, beside which the times are kept.
        again: measure, even if it was done before with the same networks on this machine.
        without: cameras to leave out.

    Raises:
        InputError: when a network cannot be loaded.
    """
    workloads = workloads_of(site, without)
    if not workloads:
        return None
    kept = site.file.folder / KEPT
    if not again and (known := _read(kept, workloads, site.rig.placed)) is not None:
        return known
    times = time_detections(list(workloads.values()))
    save_times(kept, workloads, times)
    return times


def save_times(path: Path, workloads: dict[str, Workload], times: DetectionTimes) -> None:
    """Save measured times beside a site file."""
    table = {
        "of": _asked(workloads),
        "alone_s": times.alone_s.tolist(),
        "together_s": times.together_s.tolist(),
        "aspects": times.aspects,
    }
    with suppress(OSError):  # measured anew next time
        write_file(path, json.dumps(table, indent=1) + "\n")


def _asked(workloads: dict[str, Workload]) -> list[str]:
    machine = f"{platform.node()}, {plural(num_cores(), 'core')}"
    return [machine, *(f"{n} {replace(w, image_size=DEFAULT_SIZE)}" for n, w in workloads.items())]


def _read(path: Path, workloads: dict[str, Workload], sized: bool) -> DetectionTimes | None:
    """Return the times kept; of images of any shape, unless it is known (`sized`)."""
    try:
        table = json.loads(read_bytes(path, MAX_BYTES))
        kept = np.array([table[key] for key in ("alone_s", "together_s", "aspects")], dtype=float)
        fits = table["of"] == _asked(workloads) and kept.shape == (3, len(workloads))
    except (OSError, ValueError, KeyError, TypeError):
        return None
    if sized and fits:  # a network scales images to a size of its own: their shape tells
        fits = np.allclose(kept[2], [each.aspect for each in workloads.values()], rtol=0.01)
    return DetectionTimes(kept[0], kept[1], tuple(kept[2])) if fits and (kept > 0).all() else None


def speed_problems(
    site: SiteTable, times: DetectionTimes, num_selected: float
) -> Iterator[Finding]:
    """Yield how deadline and slot rate of a site compare with the time of detections here.

    Args:
        site: its file.
        times: of the cameras that this machine runs.
        num_selected: active cameras per slot.
    """
    alone_s, together_s = float(times.alone_s.max()), float(times.together_s.max())
    found = f"{1000 * alone_s:.0f} ms per detection, {1000 * together_s:.0f} ms with all cameras"
    yield ok("network", found)
    needed_ms = 1000 * (alone_s + WAIT_S)
    if site.deadline_ms < needed_ms:
        late = site.deadline_ms < 1000 * alone_s
        yield (problem if late else warning)(
            "deadline_ms",
            f"{site.deadline_ms:g} ms, but a detection takes {1000 * alone_s:.0f} ms here: "
            f"{'all' if late else 'many'} views would come too late",
            f"deadline_ms = {suggested_deadline_ms(times)}",
        )
    asked = site.fps * site.pace
    reached = times.reach_fps(num_selected)
    if asked > SPARE * reached:
        cameras = plural(num_selected, "camera")
        slots = "" if site.pace == 1 else f" (fps {site.fps:g} at pace {site.pace:g})"
        able = f"{times.rate:.2g} detections per second, {reached:.2g} slots with {cameras} each"
        if reached < times.rate / max(num_selected, 1):  # one camera is the slowest, not all
            able = f"{reached:.2g} slots per second, as a detection takes {1000 * alone_s:.0f} ms"
        slower = f"fps = {suggested_fps(times, num_selected):g}"
        yield (problem if asked > HOPELESS * reached else warning)(
            "fps",
            f"this machine manages {able}; the site asks for {asked:.3g} slots per second{slots}",
            f"{slower}, fewer cameras per slot, a smaller network, or run `e3pose init` again",
        )


def with_time_for_all(site: ResolvedSite, times: DetectionTimes) -> ResolvedSite:
    """Return a site slowed down until all its cameras can detect in every slot.

    Films are played slower; cameras that film get longer slots.
    """
    reach = suggested_fps(times, len(times.together_s))
    file = site.file
    if file.fps * file.pace <= reach:
        return site
    if file.pace < 1:
        slower = replace(file, pace=max(float(f"{reach / file.fps:.2g}"), 0.001))
    else:
        slower = replace(file, fps=max(reach, 0.1))
    return replace(site, file=slower)


def suggested_fps(times: DetectionTimes, num_selected: float) -> float:
    """Return the slot rate that a machine sustains, rounded down to two digits."""
    reach = SPARE * times.reach_fps(num_selected)
    unit = 10.0 ** (np.floor(np.log10(reach)) - 1)
    return max(float(np.floor(reach / unit) * unit), 0.1)


def suggested_deadline_ms(times: DetectionTimes) -> int:
    """Return a deadline for slots in which all cameras are active, in steps of 10 ms."""
    return int(np.ceil((1250 * times.together_s.max() + 1000 * WAIT_S) / 10) * 10)
