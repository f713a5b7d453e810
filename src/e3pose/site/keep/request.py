"""Requests for files of a store: period, people, form."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NamedTuple

from e3pose.base.errors import InputError
from e3pose.store.clips import LAST_NS

LONGEST_S = 86_400.0  # of a file; exports hold fewer than `Store.MAX_POSES` poses anyway
MOST_TRACKS = 200
UNSAFE = re.compile(r"[^A-Za-z0-9_-]+")


class Form(NamedTuple):
    """A file format: suffix, purpose, and whether people can be chosen and smoothed."""

    suffix: str
    words: str
    chooses: bool = True


# The keys are those of `e3pose export`, less `mcap` and `report`.
FORMS = {
    "trc": Form(".trc", "OpenSim and Pose2Sim: markers, a file for each person"),
    "c3d": Form(".c3d", "motion analysis"),
    "gltf": Form(".glb", "Blender and the web: animated skeletons"),
    "bvh": Form(".bvh", "animation: a file for each person"),
    "csv": Form(".csv", "spreadsheets: a row for each frame and person"),
    "parquet": Form(".parquet", "pandas and DuckDB: the same, smaller"),
    "mcap": Form(".mcap", "Foxglove and ROS tools, with zones and events"),
    "report": Form(".html", "a page to look at and pass on: 3D player, cameras, energy", False),
}


@dataclass(frozen=True, slots=True)
class ExportRequest:
    """A request for one file or set of files.

    Attributes:
        form: a key of `FORMS`.
        name: what somebody calls it; files are called after it.
        start_ns: first time, nanoseconds since 1970.
        end_ns: last time, included.
        tracks: people; none for everybody.
        run: of the store; None where one alone lies in that time.
        smooth: whether poses are smoothed with all later slots.
    """

    form: str
    name: str
    start_ns: int
    end_ns: int
    tracks: tuple[int, ...] = ()
    run: int | None = None
    smooth: bool = False

    def __post_init__(self) -> None:
        if self.form not in FORMS:
            raise InputError("form", repr(self.form[:40]), f"one of {', '.join(FORMS)}")
        if not 0 <= self.start_ns < self.end_ns <= LAST_NS:
            raise InputError("end", "no time after the start", "the earlier time first")
        if self.end_ns - self.start_ns > LONGEST_S * 1e9:
            hours = (self.end_ns - self.start_ns) / 3.6e12
            raise InputError("end", f"{hours:.0f} hours", f"at most {LONGEST_S / 3600:.0f}")
        if len(self.tracks) > MOST_TRACKS:
            raise InputError("tracks", f"{len(self.tracks)} people", f"at most {MOST_TRACKS}")
        if self.form == "mcap" and self.smooth:
            raise InputError("smooth", "with MCAP", "another form, or poses as they were published")

    @property
    def file_name(self) -> str:
        """Name of its file: letters, digits, - and _ of the name, never a path."""
        stem = UNSAFE.sub("-", self.name).strip("-")[:60].strip("-") or "poses"
        return stem + FORMS[self.form].suffix
