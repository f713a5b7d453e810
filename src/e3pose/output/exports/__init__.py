"""Export a take to the formats of other tools (docs/how-to/export.md)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from e3pose.base.atomic import check_output
from e3pose.base.errors import InputError
from e3pose.model.take import Take
from e3pose.output.exports.base import Export as Export
from e3pose.output.exports.base import ExportSettings as ExportSettings
from e3pose.output.exports.base import person_name
from e3pose.output.exports.bvh import write_bvh
from e3pose.output.exports.c3d import write_c3d
from e3pose.output.exports.coco import write_coco
from e3pose.output.exports.gltf import write_gltf
from e3pose.output.exports.openpose import write_openpose
from e3pose.output.exports.opensim.mot import write_mot
from e3pose.output.exports.rrd import write_rrd
from e3pose.output.exports.table import write_csv, write_parquet
from e3pose.output.exports.trc import write_trc

EXPORTS: dict[str, Export] = {
    "trc": Export((".trc",), write_trc, one_person=True),
    "mot": Export((".mot",), write_mot, one_person=True),
    "c3d": Export((".c3d",), write_c3d),
    "csv": Export((".csv",), write_csv),
    "parquet": Export((".parquet",), write_parquet),
    "bvh": Export((".bvh",), write_bvh, one_person=True),
    "gltf": Export((".glb", ".gltf"), write_gltf),
    "openpose": Export((), write_openpose),
    "coco": Export((".json",), write_coco),
    "rerun": Export((".rrd",), write_rrd),
}


def format_of(dest: Path, named: str | None = None) -> str:
    """Return the format of a file by its ending, or the one that is named.

    Raises:
        InputError: for a format that is unknown, or that does not go with the ending.
    """
    suffix = dest.suffix.lower()
    if named is None:
        for name, export in EXPORTS.items():
            if suffix in export.suffixes:
                return name
        endings = ", ".join(end for export in EXPORTS.values() for end in export.suffixes)
        raise InputError(
            f"{dest}: found ending {suffix!r}, expected one of {endings}, or --format openpose "
            "for a folder"
        )
    if named not in EXPORTS:
        raise InputError(f"--format: found {named[:40]!r}, expected one of {', '.join(EXPORTS)}")
    suffixes = EXPORTS[named].suffixes
    if suffixes and suffix not in suffixes:
        raise InputError(f"{dest}: found ending {suffix!r}, expected {' or '.join(suffixes)}")
    return named


def places_of(take: Take, dest: Path, format_name: str) -> list[tuple[Take, Path]]:
    """Return the files to write: one, or one a person as `walk-track7.trc`."""
    if not EXPORTS[format_name].one_person or len(take.motions) == 1:
        return [(take, dest)]
    return [
        (
            replace(take, motions=(motion,)),
            dest.with_name(f"{dest.stem}-{person_name(motion.track_id)}{dest.suffix}"),
        )
        for motion in take.motions
    ]


def export(
    take: Take, dest: Path, format_name: str, settings: ExportSettings | None = None
) -> Iterator[tuple[Path, str]]:
    """Write a take; yield each file or folder with a note about it.

    Args:
        take: of one person at least.
        dest: the file, the first part of files' names, or a new folder.
        format_name: a key of `EXPORTS`.
        settings: how; by default as the format usually is.

    Raises:
        InputError: when the take has no people, or the format cannot hold it.
    """
    settings = settings or ExportSettings()
    if not take.motions:
        raise InputError(f"{take.name}: found nobody, expected poses: ask for another time")
    write = EXPORTS[format_name].write
    places = places_of(take, dest, format_name)
    if EXPORTS[format_name].suffixes:
        for _, path in places:
            check_output(path)
    shown = settings if len(places) == 1 else replace(settings, progress=ExportSettings().progress)
    for part, path in (
        settings.progress(places, len(places), "write") if len(places) > 1 else places
    ):
        yield path, write(part, path, shown)
