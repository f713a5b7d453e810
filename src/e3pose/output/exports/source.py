"""Read a take from a store, or from a pose table of `replay` or `export`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.people import People
from e3pose.model.region import in_rectangle, middles_m
from e3pose.model.skeleton import BODY_JOINTS, MAX_JOINTS, SKELETONS, Skeleton
from e3pose.model.take import Motion, Take, kept_rows, motions_of
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
NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Asked:
    """What is asked for; None is no limit.

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

    Raises:
        InputError: when columns are missing, or the rows do not make a take.
    """
    for option, value in (("--site", asked.site), ("--run", asked.run)):
        if value is not None:
            raise InputError(f"{option}: found with {path}, expected a store: a table is one run")
    table = (_parquet if path.suffix.lower() == ".parquet" else _csv)(path)
    if isinstance(table, Take):
        return _chosen(path, table, asked)
    runs = set(np.unique(table["run"]).tolist()) if "run" in table else {0}
    if len(runs) > 1:
        raise InputError(f"{path}: found rows of {len(runs)} runs, expected one: query --run")
    skeleton = _skeleton(path, tuple(dict.fromkeys(table["joint"].tolist())))
    slots = table["slot"].astype(np.int64)
    interval_s, started_ns = _clock(path, table, slots)
    keep = _within(slots, interval_s, started_ns, asked, path)
    index = {name: column for column, name in enumerate(skeleton.joints)}
    joints = np.array([index[name] for name in table["joint"].tolist()], dtype=np.int64)
    motions: list[Motion] = []
    tracks = table["track"].astype(np.int64)
    for track in np.unique(tracks[keep]).tolist():
        if asked.tracks and track not in asked.tracks:
            continue
        own = np.flatnonzero(keep & (tracks == track))
        frames, rows = np.unique(slots[own], return_inverse=True)
        if len(np.unique(rows * len(index) + joints[own])) < len(own):
            raise InputError(f"{path}: track {track}: found a joint twice in a slot")
        cells = (rows, joints[own])
        shape = (len(frames), len(skeleton))
        joints_m, sigma_m = np.full((*shape, 3), np.nan), np.full(shape, np.nan)
        scores, measured = np.zeros(shape), np.zeros(shape, dtype=bool)
        joints_m[cells] = np.stack([table[axis][own] for axis in "xyz"], axis=-1)
        scores[cells] = table["score"][own] if "score" in table else 1.0
        measured[cells] = table["measured"][own] if "measured" in table else True
        if "sigma" in table:
            sigma_m[cells] = table["sigma"][own]
        ids = np.full(len(frames), track)
        inside = _inside(joints_m, asked)
        people = People(ids, joints_m, scores, measured, sigma_m)[inside]
        motions += motions_of(frames[inside], people)
    if not motions:
        raise InputError(f"{path}: found no poses that fit, expected some")
    return Take(path.stem, skeleton, interval_s, tuple(motions), started_ns)


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
    """Return what is asked for of a take."""
    motions = []
    for motion in take.motions:
        if asked.tracks and motion.track_id not in asked.tracks:
            continue
        slots = motion.first + np.arange(len(motion), dtype=np.int64)
        keep = motion.known.any(axis=1) & _inside(motion.joints_m, asked)
        keep &= _within(slots, take.interval_s, take.started_ns, asked, path)
        if keep.any():
            motions.append(kept_rows(motion, keep))
    if not motions:
        raise InputError(f"{path}: found no poses that fit, expected some")
    return replace(take, motions=tuple(motions))


def _parquet(path: Path) -> Take | dict[str, NDArray[Any]]:
    """Return the columns of a table, or all of a wide one.

    Columns and counts are in a file's last bytes: of one that is no such table nothing is read.
    """
    from pyarrow import parquet

    with _readable(path), parquet.ParquetFile(path) as file:
        schema = file.schema_arrow
        if is_wide(schema.metadata):
            return read_wide(path, file, MAX_ROWS)
        _check(path, schema.names, file.metadata.num_rows)
        used = [column for column in schema if column.name in USED]
        for column in used:
            found = str(column.type)
            if found.startswith(NUMBERS) is (column.name == "joint"):
                raise InputError(column.name, found, "numbers, and text as joint", str(path))
        names = [column.name for column in used]
        return _columns(path, parquet.read_table(path, columns=names, read_dictionary=["joint"]))


def _csv(path: Path) -> dict[str, NDArray[Any]]:
    from pyarrow import csv

    with _readable(path):
        _check(path, csv.open_csv(path).schema.names, 1)
        return _columns(path, csv.read_csv(path))


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    import pyarrow

    try:
        yield
    except InputError:
        raise
    except (pyarrow.ArrowException, OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: {str(error).splitlines()[0][:120]}, expected a table of poses"
        ) from None


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
    import pyarrow

    _check(path, found.column_names, found.num_rows)
    try:
        table = {name: found.column(name).to_numpy() for name in USED & set(found.column_names)}
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


def _clock(
    path: Path, table: dict[str, NDArray[Any]], slots: NDArray[np.int64]
) -> tuple[float, int | None]:
    """Return seconds per slot, and when slot 0 was if the table says."""
    first, last = int(slots.argmin()), int(slots.argmax())
    count = int(slots[last] - slots[first])
    if count == 0:
        raise InputError(f"{path}: found one slot, expected two at least, to find the frame rate")
    if "time_ns" in table:
        times_ns = table["time_ns"].astype(np.int64)
        interval_s = float(times_ns[last] - times_ns[first]) / NS / count
        started_ns: int | None = int(times_ns[first]) - round(int(slots[first]) * interval_s * NS)
    else:
        times_s = table["time"].astype(np.float64)
        interval_s, started_ns = float(times_s[last] - times_s[first]) / count, None
    if not 1e-4 < interval_s < 1e4:
        raise InputError(f"{path}: found {interval_s:g} s per slot, expected rising times")
    return round(interval_s, 9), started_ns


def _within(
    slots: NDArray[np.int64], interval_s: float, started_ns: int | None, asked: Asked, path: Path
) -> NDArray[np.bool_]:
    keep = np.ones(len(slots), dtype=bool)
    now = datetime.now().astimezone()
    for option, words, later in (("--from", asked.start, False), ("--to", asked.end, True)):
        if words is None:
            continue
        when = as_when(words, now)
        if when.origin != "run" and started_ns is None:
            raise InputError(
                f"{option}: found {words!r}, expected seconds such as 12.5: {path} has no dates"
            )
        ns = when.ns if when.origin == "run" else when.ns - (started_ns or 0)
        edge = ns / NS / interval_s
        keep &= (slots <= edge + 1e-6) if later else (slots >= edge - 1e-6)
    return keep
