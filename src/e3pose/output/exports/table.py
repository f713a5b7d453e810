"""CSV and Parquet: one row per frame and person, metres with z up."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.take import MISSING, ORIGINS, Motion, Take
from e3pose.output.exports.angles import joint_angles
from e3pose.output.exports.base import ExportSettings
from e3pose.output.exports.wide import write_wide
from e3pose.store.export import write_tables
from e3pose.store.times import iso_text

DECIMALS_M, DECIMALS_DEG = 5, 2


def write_csv(take: Take, dest: Path, settings: ExportSettings) -> str:
    """Write all people of a take, person after person; missing is an empty cell."""
    rows = write_tables(_tables(take, settings), dest, "csv")
    return f"{rows} rows, metres, z up"


def write_parquet(take: Take, dest: Path, settings: ExportSettings) -> str:
    """Write the same columns as `write_csv`, missing as null; or the wide layout of an archive."""
    if settings.wide:
        return write_wide(take, dest, settings)
    rows = write_tables(_tables(take, settings), dest, "parquet")
    return f"{rows} rows, metres, z up"


def _tables(take: Take, settings: ExportSettings) -> Iterator[dict[str, Any]]:
    for motion in settings.progress(take.motions, len(take.motions), "write"):
        yield _columns(take, motion, settings.angles)


def _columns(take: Take, motion: Motion, angles: bool) -> dict[str, Any]:
    there = np.flatnonzero(motion.known.any(axis=1))
    slots = motion.first + there
    columns: dict[str, Any] = {
        "frame": slots.tolist(),
        "seconds": (slots * take.interval_s).round(6).tolist(),
    }
    if take.started_ns is not None:
        interval_ns = take.interval_s * 1e9
        time_ns = [take.started_ns + round(slot * interval_ns) for slot in slots.tolist()]
        columns["time"] = [iso_text(ns) for ns in time_ns]
        columns["time_ns"] = time_ns
    columns["track"] = [motion.track_id] * len(there)
    names = np.array(["", *ORIGINS[1:]], dtype=object)
    for index, joint in enumerate(take.skeleton.joints):
        known = motion.origin[there, index] != MISSING
        for axis, letter in enumerate("xyz"):
            columns[f"{joint}_{letter}"] = _cells(motion.joints_m[there, index, axis], DECIMALS_M)
        columns[f"{joint}_sigma"] = _cells(motion.sigma_m[there, index], DECIMALS_M)
        scores = np.where(known, motion.scores[there, index], np.nan)
        columns[f"{joint}_score"] = _cells(scores, 4)
        columns[f"{joint}_origin"] = names[motion.origin[there, index]].tolist()
    if angles:
        for name, degrees in joint_angles(motion.joints_m[there], take.skeleton).items():
            columns[name] = _cells(degrees, DECIMALS_DEG)
    return columns


def _cells(values: Floats, decimals: int) -> list[float | None]:
    return [None if np.isnan(value) else value for value in values.round(decimals).tolist()]
