"""`e3pose export`: poses in the formats of other tools, a report page, rows of a store."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from cyclopts import Group, Parameter

from e3pose.base.atomic import check_output
from e3pose.base.errors import MISSING, InputError
from e3pose.base.quantities import duration_s, plural, shell
from e3pose.calibrate.people_3d import People3D, doubt_placed
from e3pose.cli.options import Flag, Whole, as_typed, warn
from e3pose.cli.output import wrote
from e3pose.cli.progress import track_progress
from e3pose.cli.querying import (
    PERIOD,
    ROWS,
    PeriodOptions,
    Rows,
    Table,
    check_not_of,
    check_numbers,
    store_of,
)
from e3pose.cli.smoothing import SmoothOptions
from e3pose.estimate.smooth import SmoothSettings, smoothed
from e3pose.model.take import FILLED, PREDICTED, Take
from e3pose.output.exports import ExportSettings, format_of
from e3pose.output.exports import export as write
from e3pose.output.exports.base import Layout
from e3pose.output.exports.resample import resampled
from e3pose.recording.calibration import load_rig
from e3pose.settings.resolved import resolve
from e3pose.settings.site_file import load_site
from e3pose.store.export import write_tables

if TYPE_CHECKING:
    from e3pose.output.exports.base import Progress
    from e3pose.output.exports.source import Asked

SMOOTH = SmoothOptions()
BONES = ("bvh", "gltf")
NAMED = {
    "pose2sim": ("trc",), "opencap": ("trc",), "vrm": BONES, "mixamo": BONES, "unreal": BONES
}  # fmt: skip
PAGES = (".html", ".htm")
MOMENTS = 20_000  # of people, for doubts about their size
OPTIONS = {"site": "--site", "run": "--run", "time": "--from, --to", "track": "--track"}


@Parameter(name="*", group=Group("Format", sort_key=2))
@dataclass(frozen=True, kw_only=True)
class FormatOptions:
    """The format of the files, and its options."""

    format_name: Annotated[
        Literal["trc", "mot", "c3d", "csv", "parquet", "bvh", "gltf", "openpose", "coco", "rerun"]
        | None,
        Parameter(name="--format"),
    ] = None
    """Output format, if the suffix of DEST does not determine it."""
    fill: str | None = None
    """Fill gaps of a joint up to this length, such as 200ms, and mark them. Default: none."""
    fps: float | None = None
    """Frame rate, by linear interpolation. Default: the slot rate."""
    units: Literal["mm", "m"] | None = None
    """Length unit of TRC, C3D (default mm) and BVH (default m)."""
    names: Literal["pose2sim", "opencap", "vrm", "mixamo", "unreal"] | None = None
    """Names of another tool. TRC: `pose2sim` or `opencap`, with OpenSim's model and set-up files
    beside. BVH, glTF: bones as in `vrm`, `mixamo` or `unreal`. Default: those of the joints."""
    angles: Flag = False
    """Add joint angles as columns of CSV and Parquet, whose layout is then wide."""
    layout: Layout | None = None
    """Rows of CSV and Parquet: long, one per joint (default); wide, one per person; archive,
    Parquet of whole millimetres, a tenth of the size, which `export` reads."""
    osim: Path | None = None
    """OpenSim model that the set-up files of TRC scale. Default: one that is written with them."""
    calibration: Path | None = None
    """Calibration file, for 2D keypoints: required for COCO, optional for OpenPose JSON."""

    def settings(self, dest: Path, progress: Progress) -> tuple[str, ExportSettings]:
        """Return the format and its settings; raise `InputError` for options that it lacks."""
        form = format_of(dest, self.format_name)
        for option, value, forms in (
            ("--angles", self.angles or None, ("csv", "parquet")),
            ("--layout", self.layout, ("csv", "parquet")),
            ("--layout archive", self.layout == "archive" or None, ("parquet",)),
            ("--layout long", (self.layout == "long" and self.angles) or None, ("no --angles",)),
            ("--units", self.units, ("trc", "c3d", "bvh")),
            ("--osim", self.osim, ("trc",)),
            (f"--names {self.names}", self.names, NAMED.get(self.names or "", ())),
            ("--calibration", self.calibration, ("coco", "openpose")),
        ):
            if value is not None and form not in forms:
                listed = " or ".join(filter(None, (", ".join(forms[:-1]), forms[-1])))
                raise InputError(f"{option}: found with {form}, expected {listed}")
        if self.osim is not None and self.names is None:
            raise InputError("--osim", "without --names", "--names pose2sim or opencap beside it")
        rig = None if self.calibration is None else load_rig(self.calibration)
        layout = self.layout or ("wide" if self.angles else "long")
        more = (layout, progress, self.osim)
        return form, ExportSettings(self.units, self.names, self.angles, rig, *more)


FORMAT = FormatOptions()


def export(
    source: str,
    dest: Path,
    /,
    *,
    what: Annotated[Table | None, Parameter(group=ROWS)] = None,
    period: PeriodOptions = PERIOD,
    track: Annotated[
        list[Whole] | None, Parameter(consume_multiple=True, negative="", group=ROWS)
    ] = None,
    region: Annotated[str | None, Parameter(allow_leading_hyphen=True, group=ROWS)] = None,
    smooth: SmoothOptions = SMOOTH,
    form: FormatOptions = FORMAT,
) -> None:
    """Export poses to OpenSim, Blender, pandas, rerun and other tools; write a report page.

    Example: `e3pose export live.db walk.trc --from 14:00 --to 14:05 --smooth rts`

    The suffix of DEST selects the format: .trc and .mot (OpenSim: markers, joint angles), .c3d,
    .csv and .parquet (tables: --layout), .bvh, .glb and .gltf (animated skeletons),
    .json (COCO), .rrd (rerun); a folder of OpenPose JSON needs `--format openpose`. TRC, MOT and
    BVH hold one person per file, such as walk-track7.trc. Missing joints stay missing without
    --fill.

    A DEST ending in .html is the report page of any stretch of a live site, as `e3pose replay
    --report` makes it of a recording: 3D player, camera selection, energy. Of several runs in that
    time it shows the newest, with the videos that the site recorded.

    Example: `e3pose export site.toml morning.html --from 09:00 --to 09:30`

    With --what, DEST (.csv or .parquet) gets the rows of a table as they are stored.

    Example: `e3pose export site.toml selections.csv --what slots`

    Parameters
    ----------
    source
        A store as in `e3pose query` (file, URL or site folder), or a table of poses from
        `e3pose replay --poses` or `e3pose export`, long or archive. For a report page, a
        site.
    dest
        Output file, replaced if it exists; for OpenPose a new folder.
    what
        The rows of this table, as in `e3pose query`; `poses`: one per person, slot and joint.
    track
        Only these track ids.
    region
        Only people whose centre is in this rectangle of the floor: x,y,x,y in metres.
    """
    from e3pose.output.exports.source import Asked

    smoothing = smooth.settings()
    if what is not None or (form.format_name is None and dest.suffix.lower() in PAGES):
        given = {item.name.removesuffix("_name"): getattr(form, item.name) for item in fields(form)}
        given |= {"region": region, "smooth": what and smooth.smooth, "track": not what and track}
        for option, value in given.items():
            if value not in (None, False):
                kind = "a report page" if what is None else f"--what {what}"
                raise InputError(f"--{option}", f"with {kind}", "poses in another format")
        _write_page(source, dest, period, smoothing) if what is None else _write_rows(
            source, dest, what, period, track or ()
        )
        return
    name, settings = form.settings(dest, track_progress)
    with as_typed({"": "--fill"}):
        fill_s = 0.0 if form.fill is None else duration_s(form.fill)
    smoothing = SmoothSettings(smoothing.method, smoothing.cutoff_hz, fill_s)
    check_numbers({"--track, --run": (*(track or ()), period.run)})
    corners = None if region is None else _corners(region)
    asked = Asked(period.from_, period.to, tuple(track or ()), period.site, period.run, corners)
    with as_typed(OPTIONS, source):
        take = _take(source, dest, asked)
    if take.motions and (doubt := doubt_placed(_people(take), "THEIR_CALIBRATION")):
        warn(f"{source}: {doubt}")
    if smoothing.method is not None or smoothing.fill_s > 0:
        take = smoothed(take, smoothing, track_progress)
    if form.fps is not None:
        before, take = take, resampled(take, form.fps)
        if take is not before:
            print(f"resampled from {before.fps:g} to {take.fps:g} frames per second, linearly")
    for path, note in write(take, dest, name, settings):
        wrote(path, note)
    _print_filled(take)


def _people(take: Take) -> People3D:
    """Return moments that tell how tall people are."""
    step = max(1, sum(map(len, take.motions)) // MOMENTS)
    joints_m = np.concatenate([motion.joints_m[::step] for motion in take.motions])
    lengths = [-(-len(motion) // step) for motion in take.motions]
    who = np.repeat([motion.track_id for motion in take.motions], lengths)
    slots = np.concatenate([m.first + np.arange(0, len(m), step) for m in take.motions])
    return People3D(joints_m, who, slots, take.skeleton, take.fps)


def _write_page(source: str, dest: Path, period: PeriodOptions, smoothing: SmoothSettings) -> None:
    """Write the report page of a stored period."""
    from e3pose.output.report.stored import write_stretch
    from e3pose.store import Store

    check_output(dest)
    path = Path(source)
    if (path / "recording.toml").is_file():
        raise InputError(
            f"{source}: found a recording, expected a site: e3pose replay {shell(source)} "
            f"--report {shell(dest)}"
        )
    if not (path.is_dir() or path.suffix == ".toml"):
        raise InputError(f"{source}: found a store, expected its site, which names its cameras")
    table = load_site(path)
    if table.store is None:
        wanted = '[store] path = "poses.db", without which a site keeps nothing'
        raise InputError("", MISSING, wanted, str(table.path))
    store = Store(table.store.place)
    with as_typed(OPTIONS, store.where):
        slots = write_stretch(
            resolve(table), store, dest, period.from_, period.to, smoothing, period.run
        )
    wrote(dest, plural(slots, "slot"))


def _write_rows(
    source: str, dest: Path, what: Table, period: PeriodOptions, tracks: Sequence[int]
) -> None:
    """Write the rows of a table of a store."""
    from e3pose.store import Store

    form = dest.suffix.lower().removeprefix(".")
    if form not in ("csv", "parquet"):
        raise InputError("DEST", repr(str(dest)), f"a name ending in .csv or .parquet with {what}")
    if len(tracks) > 1:
        raise InputError("--track", f"{len(tracks)} with --what {what}", "at most one")
    store, site = store_of(source, period.site)
    check_output(dest)
    check_not_of(store, dest)
    rows = Rows(Store(store), what, period, site, next(iter(tracks), None))
    wrote(dest, plural(write_tables(rows.chunks(), dest, form), "row"))


def _take(source: str, dest: Path, asked: Asked) -> Take:
    """Read the requested take, and check that no file of it is overwritten."""
    from e3pose.output.exports.source import TABLES, take_from_store, take_from_table

    path = Path(source)
    if "://" not in source and path.suffix.lower() in TABLES:
        if not path.is_file():
            raise InputError(f"{source}: no such file, expected a store or a table of poses")
        if dest.resolve() == path.resolve():
            raise InputError(f"{dest}: found the source itself, expected another file")
        return take_from_table(path, asked)
    if (path / "recording.toml").is_file():
        raise InputError(
            f"{source}: found a recording, expected poses: first run e3pose replay {shell(source)} "
            "--poses poses.parquet"
        )
    store, site = store_of(source, asked.site)
    check_not_of(store, dest)
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
    known = sum(int(motion.known.sum()) for motion in take.motions)
    if not known:
        return
    for origin, what in ((PREDICTED, "predicted by the estimator"), (FILLED, "filled")):
        count = sum(int((motion.origin == origin).sum()) for motion in take.motions)
        if count:
            print(f"{100 * count / known:.1f} % of the joints {what}, not measured in their frame")
