"""Read a take from a store, or from a pose table of `replay` or `export`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats, Integers
from e3pose.base.errors import InputError
from e3pose.model.region import in_rectangle, middles_m
from e3pose.model.skeleton import BODY_JOINTS, MAX_JOINTS, SKELETONS, Skeleton
from e3pose.model.take import (
    MEASURED,
    MISSING,
    PREDICTED,
    Motion,
    Take,
    check_fit,
    kept_rows,
    motions_of,
    nowhere,
)
from e3pose.output.exports.wide import is_wide, read_wide
from e3pose.store import Store
from e3pose.store.answers import StoredPoses, StoredRun
from e3pose.store.query import Time
from e3pose.store.times import as_when

TABLES = (".csv", ".parquet")
NEEDED = ("slot", "track", "joint", "x", "y", "z")
USED = {*NEEDED, "time", "time_ns", "score", "sigma", "measured", "run"}
NUMBERS = ("int", "uint", "float", "double", "halffloat", "bool")  # as Parquet files name them
MAX_ROWS = 40_000_000  # of a table in memory: as many joints as a store gives at once
BATCH = 65_536  # rows that are read at a time
NS = 1_000_000_000
Parts = Callable[[], Iterator[dict[str, NDArray[Any]]]]  # the columns of some rows at a time


@dataclass(frozen=True, slots=True)
class Asked:
    """The requested part of a store; None is no limit.

    Attributes:
        start: from when, as `e3pose query` takes it.
        end: until when, included.
        tracks: people; none for everybody.
        site: of a store.
        run: of a store.
        region_m: x and y of two corners on the floor: frames in which the middle of somebody's
            joints lies between them.
    """

    start: Time = None
    end: Time = None
    tracks: tuple[int, ...] = ()
    site: str | None = None
    run: int | None = None
    region_m: tuple[float, float, float, float] | None = None


def query(
    store: str | Path,
    start: str | None = None,
    end: str | None = None,
    *,
    tracks: Sequence[int] = (),
    site: str | None = None,
    run: int | None = None,
) -> Take:
    """Return the people that a store holds, each with arrays over time.

        take = e3pose.query("lab.db", "-10min")
        joints_m, tracks, first_slot = take.dense()

    Args:
        store: file or URL of a database.
        start: from when: `-10min`, `14:00`, `2026-11-21T14:00`, seconds of the run such as `12.5`.
        end: until when, included.
        tracks: people; everybody by default.
        site: runs of one site only.
        run: one run only; needed where times lie in several.

    Raises:
        InputError: when nothing is found, or what is asked for lies in several runs.
    """
    return take_from_store(str(store), Asked(start, end, tuple(tracks), site, run))


def take_from_store(store: str, asked: Asked) -> Take:
    """Return poses of one run of a store.

    Raises:
        InputError: when nothing is found, or what is asked for lies in several runs.
    """
    open_store = Store(store)
    track = asked.tracks[0] if len(asked.tracks) == 1 else None
    found = open_store.query(asked.start, asked.end, track=track, site=asked.site, run=asked.run)
    runs = {one.run_id: one for one in open_store.runs()}
    ids = sorted(set(found.run_ids.tolist()))
    if len(ids) > 1:
        named = ", ".join(f"{i} ({runs[i].run.site}, {runs[i].run.name})" for i in ids[:6])
        raise InputError(f"{open_store.where}: found poses of runs {named}, expected one: --run")
    if not ids:
        raise InputError(
            f"{open_store.where}: found no poses that fit; e3pose query --what runs lists what "
            "is there"
        )
    return _take_of_run(runs[ids[0]], found, asked)


def take_from_table(path: Path, asked: Asked) -> Take:
    """Return the poses of a table of `replay --poses`, `query` or `export`, long or archive.

    Frame rate and skeleton follow from the rows: from times and slots, and from the joints' names.
    Rows are read twice, some at a time: first what there is, then what is asked for.

    Raises:
        InputError: when columns are missing, or the rows do not make a take.
    """
    for option, value in (("--site", asked.site), ("--run", asked.run)):
        if value is not None:
            raise InputError(f"{option}: found with {path}, expected a store: a table is one run")
    parts = (_parquet if path.suffix.lower() == ".parquet" else _csv)(path)
    take = parts if isinstance(parts, Take) else _take_of_rows(path, parts, asked)
    return _chosen(path, take, asked)


def _take_of_rows(path: Path, parts: Parts, asked: Asked) -> Take:
    """Return the take of a long table, without the people and times that are not asked for."""
    names: dict[str, int] = {}
    spans: dict[int, tuple[int, int]] = {}
    runs, ends = set[int](), list[tuple[int, float]]()
    for part in parts():
        runs |= set(np.unique(np.nan_to_num(part.get("run", np.zeros(1)), nan=-1)).tolist())
        _, begins = np.unique(part["joint"], return_index=True)
        for name in part["names"][part["joint"][np.sort(begins)]].tolist():
            names.setdefault(name, len(names))
        slots, tracks = part["slot"].astype(np.int64), part["track"].astype(np.int64)
        dated = "time_ns" in part
        times = part["time_ns"].astype(np.int64) if dated else part["time"].astype(np.float64)
        ends += [(int(slots[i]), times[i].item()) for i in (slots.argmin(), slots.argmax())]
        for track in np.unique(tracks).tolist():
            own = slots[tracks == track]
            found = int(own.min()), int(own.max())
            low, high = spans.get(track, found)
            spans[track] = min(low, found[0]), max(high, found[1])
    if len(runs) > 1:
        raise InputError(f"{path}: found rows of {len(runs)} runs, expected one: query --run")
    skeleton = _skeleton(path, tuple(names))
    interval_s, started_ns = _clock(path, ends, dated)
    first, last = _between(interval_s, started_ns, asked, path)
    wanted = {
        track: (max(low, first), min(high, last) + 1)
        for track, (low, high) in sorted(spans.items())
        if max(low, first) <= min(high, last) and track in (asked.tracks or (track,))
    }
    held = sum(end - low for low, end in wanted.values())
    check_fit("all tracks", held, len(skeleton), str(path))
    motions = {t: nowhere(t, low, end - low, len(skeleton)) for t, (low, end) in wanted.items()}
    for part in parts():
        joints = np.array([skeleton.index(name) for name in part["names"].tolist()])[part["joint"]]
        slots, tracks = part["slot"].astype(np.int64), part["track"].astype(np.int64)
        for track in np.unique(tracks).tolist():
            if motion := motions.get(track):
                own = (tracks == track) & (slots >= motion.first)
                own = np.flatnonzero(own & (slots < motion.first + len(motion)))
                _fill(path, motion, (slots[own] - motion.first, joints[own]), part, own)
    return Take(path.stem, skeleton, interval_s, tuple(motions.values()), started_ns)


def _fill(
    path: Path,
    motion: Motion,
    cells: tuple[Integers, Integers],
    part: Mapping[str, NDArray[Any]],
    own: Integers,
) -> None:
    """Write rows of a table into a motion, where cells say."""
    rows, joints = cells
    twice = len(np.unique(rows * motion.scores.shape[1] + joints)) < len(own)
    if twice or (motion.origin[cells] != MISSING).any():
        raise InputError(f"{path}: track {motion.track_id}: found a joint twice in a slot")
    places_m = np.stack([part[axis][own] for axis in "xyz"], axis=-1).astype(np.float64)
    scores = part["score"][own] if "score" in part else np.ones(len(own))
    known = np.isfinite(places_m).all(axis=-1) & (scores > 0)
    cells, own = (rows[known], joints[known]), own[known]
    motion.joints_m[cells], motion.scores[cells] = places_m[known], scores[known]
    measured = part["measured"][own].astype(bool) if "measured" in part else True
    motion.origin[cells] = np.where(measured, MEASURED, PREDICTED)
    if "sigma" in part:
        motion.sigma_m[cells] = part["sigma"][own]


def _take_of_run(stored: StoredRun, found: StoredPoses, asked: Asked) -> Take:
    run = stored.run
    skeleton = run.limbed
    wanted = _inside(found.people.joints_m.astype(np.float64), asked)
    if asked.tracks:
        wanted &= np.isin(found.people.track_ids, asked.tracks)
    motions = motions_of(found.slots[wanted], found.people[wanted])
    if not motions:
        raise InputError(f"run {stored.run_id}: found no poses that fit, expected some")
    return Take(run.name, skeleton, run.interval_s, motions, run.started_ns)


def _inside(joints_m: Floats, asked: Asked) -> NDArray[np.bool_]:
    """Return `(num_rows,)`: whose joints' middle lies in the region."""
    if asked.region_m is None:
        return np.ones(len(joints_m), dtype=bool)
    return in_rectangle(middles_m(joints_m), asked.region_m)


def _chosen(path: Path, take: Take, asked: Asked) -> Take:
    """Return the requested part of a take."""
    first, last = _between(take.interval_s, take.started_ns, asked, path)
    motions = []
    for motion in take.motions:
        if asked.tracks and motion.track_id not in asked.tracks:
            continue
        slots = motion.first + np.arange(len(motion), dtype=np.int64)
        there = motion.known.any(axis=1)
        keep = there & _inside(motion.joints_m, asked) & (slots >= first) & (slots <= last)
        if keep.any():
            whole = keep[0] and keep[-1] and (keep == there).all()
            motions.append(motion if whole else kept_rows(motion, keep))
    if not motions:
        raise InputError(f"{path}: found no poses that fit, expected some")
    return replace(take, motions=tuple(motions))


def _parquet(path: Path) -> Take | Parts:
    """Return the reader of a table's columns, or of a whole wide table.

    Columns and counts are in a file's last bytes: of one that is no such table nothing is read.
    """
    import pyarrow
    from pyarrow import parquet

    with _readable(path), parquet.ParquetFile(path) as file:
        schema = file.schema_arrow
        if is_wide(schema.metadata):
            return read_wide(path, file, MAX_ROWS)
        _check(path, schema.names, file.metadata.num_rows)
        unused = {"time"} if "time_ns" in schema.names else set()  # dates
        used = [column for column in schema if column.name in USED - unused]
        for column in used:
            found = str(column.type)
            if found.startswith(NUMBERS) is (column.name == "joint"):
                raise InputError(column.name, found, "numbers, and text as joint", str(path))
        names = [column.name for column in used]

    def parts() -> Iterator[dict[str, NDArray[Any]]]:
        with _readable(path), parquet.ParquetFile(path, read_dictionary=["joint"]) as file:
            for batch in filter(len, file.iter_batches(BATCH, columns=names)):
                yield _columns(path, pyarrow.Table.from_batches([batch]))

    return parts


def _csv(path: Path) -> Parts:
    from pyarrow import csv

    with _readable(path):
        _check(path, csv.open_csv(path).schema.names, 1)
        whole = _columns(path, csv.read_csv(path))
    return lambda: iter((whole,))


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    import pyarrow

    try:
        yield
    except InputError:
        raise
    except (pyarrow.ArrowException, OSError, UnicodeDecodeError) as error:
        why = f"{path}: {str(error).splitlines()[0][:120]}, expected a table of poses"
        raise InputError(why) from error  # whose fault it is: the machine's or the file's


def _check(path: Path, names: Sequence[str], num_rows: int) -> None:
    """Raise `InputError` for a table without the columns of poses, or with too many rows."""
    missing = [name for name in NEEDED if name not in names]
    if missing or not {"time", "time_ns"} & set(names):
        raise InputError(
            f"{path}: found no column {', '.join(missing) or 'time'}, expected a table of poses "
            "in the layout long or archive"
        )
    if not 0 < num_rows <= MAX_ROWS:
        raise InputError(f"{path}: found {num_rows} rows, expected 1 to {MAX_ROWS}")


def _columns(path: Path, found: Any) -> dict[str, NDArray[Any]]:
    """Return columns by name; that of joints has indices of `names`."""
    import pyarrow

    _check(path, found.column_names, found.num_rows)
    numbers = USED & set(found.column_names) - {"joint"}
    try:
        joints = found.column("joint").cast(pyarrow.string()).combine_chunks().dictionary_encode()
        table = {name: found.column(name).to_numpy() for name in numbers}
        table["names"] = np.array(joints.dictionary.to_pylist(), dtype=object)
        table["joint"] = joints.indices.to_numpy()
    except (pyarrow.ArrowException, ValueError) as error:
        raise InputError(f"{path}: {str(error)[:120]}, expected a table of poses") from None
    scores = table.get("score", np.ones(1))
    if scores.dtype.kind not in "fiu" or not ((scores >= 0) & (scores <= 1)).all():
        raise InputError("score", "another value", "numbers in [0, 1]", str(path))
    return table


def _skeleton(path: Path, names: tuple[str, ...]) -> Skeleton:
    """Return the smallest skeleton that has all the joints, or one of points without limbs."""
    fitting = [one for one in SKELETONS.values() if set(names) <= set(one.joints)]
    if not fitting and not (len(names) <= MAX_JOINTS and BODY_JOINTS.intersection(names)):
        some = ", ".join(str(name)[:30] for name in names[:6])
        raise InputError(f"{path}: found joints {some}, ..., expected those of a skeleton")
    return min(fitting, key=len) if fitting else Skeleton(path.stem, names, ())


def _clock(path: Path, ends: Sequence[tuple[int, float]], dated: bool) -> tuple[float, int | None]:
    """Return seconds per slot, and when slot 0 was if the table says.

    Args:
        path: of the table.
        ends: slot and time of rows, the first and the last slot among them.
        dated: whether times are nanoseconds since 1970, not seconds.
    """
    (first, begin), (last, end) = (choose(ends, key=itemgetter(0)) for choose in (min, max))
    if last == first:
        raise InputError(f"{path}: found one slot, expected two at least, to find the frame rate")
    interval_s = float(end - begin) / (NS if dated else 1) / (last - first)
    if not 1e-4 < interval_s < 1e4:
        raise InputError(f"{path}: found {interval_s:g} s per slot, expected rising times")
    started_ns = int(begin) - round(first * interval_s * NS) if dated else None
    return round(interval_s, 9), started_ns


def _between(
    interval_s: float, started_ns: int | None, asked: Asked, path: Path
) -> tuple[int, int]:
    """Return the first and the last slot that are asked for."""
    bounds, now = [-(2.0**62), 2.0**62], datetime.now().astimezone()
    for index, (option, words) in enumerate((("--from", asked.start), ("--to", asked.end))):
        if words is None:
            continue
        when = as_when(words, now)
        if when.origin != "run" and started_ns is None:
            raise InputError(
                f"{option}: found {words!r}, expected seconds such as 12.5: {path} has no dates"
            )
        ns = when.ns if when.origin == "run" else when.ns - (started_ns or 0)
        bounds[index] = ns / NS / interval_s
    return math.ceil(bounds[0] - 1e-6), math.floor(bounds[1] + 1e-6)
