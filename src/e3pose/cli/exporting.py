"""`e3pose export`: poses in the formats of other tools."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from e3pose.cli.options import Flag, Whole, as_typed
from e3pose.cli.output import wrote
from e3pose.cli.smoothing import SmoothOptions
from e3pose.errors import InputError

if TYPE_CHECKING:
    from e3pose.exports.source import Asked
    from e3pose.model.take import Motion, Take

SMOOTH = SmoothOptions()
OPTIONS = {"site": "--site", "run": "--run", "time": "--from, --to", "track": "--track"}


def export(
    source: str,
    dest: Path,
    /,
    *,
    format_name: Annotated[
        Literal["trc", "c3d", "csv", "parquet", "bvh", "gltf", "openpose", "coco", "rerun"] | None,
        Parameter(name="--format"),
    ] = None,
    from_: Annotated[str | None, Parameter(name="--from", allow_leading_hyphen=True)] = None,
    to: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    track: Annotated[list[Whole] | None, Parameter(consume_multiple=True, negative="")] = None,
    region: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    site: str | None = None,
    run: Whole | None = None,
    smooth: SmoothOptions = SMOOTH,
    fill: str | None = None,
    fps: float | None = None,
    units: Literal["mm", "m"] | None = None,
    angles: Flag = False,
    calibration: Path | None = None,
) -> None:
    """Export poses to OpenSim, Blender, pandas, rerun and other tools.

    Example: `e3pose export live.db walk.trc --from 14:00 --to 14:05 --smooth rts`

    The suffix of DEST selects the format: .trc (OpenSim), .c3d, .csv and .parquet (one row per
    frame and person), .bvh, .glb and .gltf (animated skeletons), .json (COCO), .rrd (rerun); a
    folder of OpenPose JSON needs `--format openpose`. TRC and BVH hold one person per file, such
    as walk-track7.trc. Missing joints stay missing without --fill.

    Parameters
    ----------
    source
        A store as in `e3pose query` (file, URL or site folder), or a table of poses from
        `e3pose replay --poses` or `e3pose query`.
    dest
        Output file, replaced if it exists; for OpenPose a new folder.
    format_name
        Output format, if the suffix of DEST does not determine it.
    from_
        Start, as in `e3pose query`: `2026-11-21T14:00`, `-10min`, seconds such as `12.5`.
    to
        End, in the same formats.
    track
        Only these track ids.
    region
        Only people whose centre is in this rectangle of the floor: x,y,x,y in metres.
    site
        Only runs of this site.
    run
        Only this run.
    fill
        Fill gaps of a joint up to this length, such as 200ms, and mark them. Default: none.
    fps
        Frame rate, by linear interpolation. Default: the slot rate.
    units
        Length unit of TRC, C3D (default mm) and BVH (default m).
    angles
        Add joint angles as columns of CSV and Parquet.
    calibration
        Calibration file, for 2D keypoints: required for COCO, optional for OpenPose JSON.
    """
    from e3pose.cli.progress import track_progress
    from e3pose.estimate.smooth import SmoothSettings, smoothed
    from e3pose.exports import ExportSettings, format_of
    from e3pose.exports import export as write
    from e3pose.exports.resample import resampled
    from e3pose.exports.source import Asked
    from e3pose.quantities import duration_s

    form = format_of(dest, format_name)
    if angles and form not in ("csv", "parquet"):
        raise InputError(f"--angles: found with {form}, expected csv or parquet")
    if units is not None and form not in ("trc", "c3d", "bvh"):
        raise InputError(f"--units: found with {form}, expected trc, c3d or bvh")
    asked_smoothing = smooth.settings()
    with as_typed({"": "--fill"}):
        fill_s = 0.0 if fill is None else duration_s(fill)
    settings = SmoothSettings(asked_smoothing.method, asked_smoothing.cutoff_hz, fill_s)
    rig = None
    if calibration is not None:
        from e3pose.recording.calibration import load_rig

        if form not in ("coco", "openpose"):
            raise InputError(f"--calibration: found with {form}, expected coco or openpose")
        rig = load_rig(calibration)
    for number in [*(track or ()), *([] if run is None else [run])]:
        if not 0 <= number < 2**63:
            raise InputError(f"--track, --run: found {number}, expected a number of 0 or more")
    corners = None if region is None else _corners(region)
    asked = Asked(from_, to, tuple(track or ()), site, run, corners)
    with as_typed(OPTIONS, source):
        take = _take(source, dest, asked)

    def progress(items: Iterable[Any], total: int, label: str) -> Iterable[Any]:
        return track_progress(items, total, label)

    if settings.method is not None or settings.fill_s > 0:
        motions: list[Motion] = []
        for motion in progress(take.motions, len(take.motions), "smooth"):
            motions += smoothed(replace(take, motions=(motion,)), settings).motions
        take = replace(take, motions=tuple(motions))
    if fps is not None:
        before, take = take, resampled(take, fps)
        if take is not before:
            print(f"resampled from {before.fps:g} to {take.fps:g} frames per second, linearly")
    for path, note in write(take, dest, form, ExportSettings(units, angles, rig, progress)):
        wrote(path, note)
    _print_filled(take)


def _take(source: str, dest: Path, asked: Asked) -> Take:
    """Read what is asked for, and check that it would not be written over."""
    from e3pose.cli.querying import files_of, store_of
    from e3pose.exports.source import TABLES, take_from_store, take_from_table
    from e3pose.store.database import database_path, database_url

    path = Path(source)
    if "://" not in source and path.suffix.lower() in TABLES:
        if not path.is_file():
            raise InputError(f"{source}: no such file, expected a store or a table of poses")
        if dest.resolve() == path.resolve():
            raise InputError(f"{dest}: found the source itself, expected another file")
        return take_from_table(path, asked)
    if (path / "recording.toml").is_file():
        raise InputError(
            f"{source}: found a recording, expected poses: first run e3pose replay {source} "
            "--poses poses.parquet"
        )
    store, site = store_of(source, asked.site)
    database = database_path(database_url(store))
    if database is not None and dest.resolve() in files_of(database.resolve()):
        raise InputError(f"{dest}: found the store itself, expected another file")
    return take_from_store(store, replace(asked, site=site))


def _corners(region: str) -> tuple[float, float, float, float]:
    try:
        values = [float(part) for part in region.split(",")]
    except ValueError:
        values = []
    if len(values) != 4 or not all(map(math.isfinite, values)):
        raise InputError(f"--region: found {region[:60]!r}, expected x,y,x,y in metres: -2,-1,3,4")
    return values[0], values[1], values[2], values[3]


def _print_filled(take: Take) -> None:
    from e3pose.model.take import FILLED, PREDICTED

    known = sum(int(motion.known.sum()) for motion in take.motions)
    if not known:
        return
    for origin, what in ((PREDICTED, "predicted by the estimator"), (FILLED, "filled")):
        count = sum(int((motion.origin == origin).sum()) for motion in take.motions)
        if count:
            print(f"{100 * count / known:.1f} % of the joints {what}, not measured in their frame")
