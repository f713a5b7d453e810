"""The Protocol of an export: a take in, a file or folder out."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.camera import Rig
from e3pose.model.take import Take

Units = Literal["mm", "m"]
Layout = Literal["long", "wide", "archive"]
Progress = Callable[[Iterable[Any], int, str], Iterable[Any]]

PER_METRE: dict[str, float] = {"mm": 1000.0, "m": 1.0}


@dataclass(frozen=True, slots=True)
class ExportSettings:
    """Settings for writing a take; each format takes the ones that concern it.

    Attributes:
        units: of TRC, C3D and BVH; None for the format's usual ones.
        names: what markers of TRC are called, a key of `opensim.markers.NAMES`, or bones of BVH and
            glTF, of `bone_names.BONE_NAMES`; None for the joints' own names.
        angles: whether tables have columns of joint angles.
        osim: the OpenSim model that set-ups beside TRC scale; None for one that is written.
        rig: the cameras of formats that hold 2D keypoints; None without.
        layout: of tables: a row per joint, per person, or the archive of `wide` (Parquet).
        progress: wraps what takes long: the work, how much it is, what it is called.
    """

    units: Units | None = None
    names: str | None = None
    angles: bool = False
    rig: Rig | None = None
    layout: Layout = "long"
    progress: Progress = lambda items, total, label: items
    osim: Path | None = None


class Writer(Protocol):
    """Write a take."""

    def __call__(self, take: Take, dest: Path, settings: ExportSettings) -> str:
        """Write to `dest` and return a note about it, one line or empty."""
        ...


@dataclass(frozen=True, slots=True)
class Export:
    """A format.

    Attributes:
        suffixes: of its files, the usual one first; none for a folder.
        write: writes it.
        one_person: whether a file holds one person, so that a take makes as many files.
    """

    suffixes: tuple[str, ...]
    write: Writer
    one_person: bool = False


def y_up(points_m: Floats) -> Floats:
    """Return `(*batch, 3)` points of the world, z up, as x, z, -y: y up, right-handed as before."""
    return np.stack([points_m[..., 0], points_m[..., 2], -points_m[..., 1]], axis=-1)


def person_name(track_id: int) -> str:
    """Return the name of a person in files."""
    return f"track{track_id}"
