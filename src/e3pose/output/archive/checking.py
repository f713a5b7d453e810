"""Check an archive: that every file is there and is what was written."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from e3pose.base.errors import InputError
from e3pose.output.archive.manifest import NAME, Manifest, days_of, digest, read_manifest
from e3pose.output.archive.places import Place


@dataclass(frozen=True, slots=True)
class Checked:
    """What a check found.

    Attributes:
        days: with a manifest.
        deleted: of these, days that somebody asked to be deleted.
        files: that are what was written.
        rows: of people in them.
        bytes: of them.
        problems: one line each.
        strays: files that no manifest names, as a killed pass leaves: the next one writes them.
    """

    days: int
    deleted: int
    files: int
    rows: int
    bytes: int
    problems: tuple[str, ...]
    strays: tuple[str, ...]


def check_archive(
    place: Place, progress: Callable[[list[tuple[str, str]]], Iterable[tuple[str, str]]] = list
) -> Checked:
    """Read all of an archive, and compare every file with its hash.

    Args:
        place: of the archive.
        progress: wraps the days.

    Raises:
        InputError: when there is no archive, or it cannot be read.
    """
    days = days_of(place)
    if not days:
        raise InputError(f"{place.name}: found no archive, expected what e3pose archive writes")
    problems, named = list[str](), set[str]()
    deleted = files = rows = size = 0
    for site, day in progress(days):
        named.add(f"{Manifest(site, day).folder}/{NAME}")
        try:
            manifest = read_manifest(place, site, day)
        except InputError as error:
            problems.append(str(error))
            continue
        if manifest is None:
            continue
        deleted += manifest.deleted
        for name, entry in manifest.files.items():
            if not entry.sha256:
                continue  # nobody was there
            path = f"{manifest.folder}/{name}"
            named.add(path)
            try:
                content = place.read(path)
            except InputError as error:
                problems.append(str(error))
                continue
            if content is None:
                problems.append(f"{path}: found no file, expected {entry.bytes} bytes")
            elif digest(content) != entry.sha256:
                problems.append(f"{path}: found {len(content)} other bytes, expected those written")
            else:
                files, rows, size = files + 1, rows + entry.rows, size + entry.bytes
    strays = [name for name in place.names() if name.startswith("site=") and name not in named]
    return Checked(len(days), deleted, files, rows, size, tuple(problems), tuple(strays))
