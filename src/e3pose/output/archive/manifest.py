"""The content of a day's archive, with hashes: `manifest.json` in its folder; its check."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace

import msgspec

from e3pose.base.bounded import UNDECODABLE
from e3pose.base.errors import InputError
from e3pose.output.archive.places import Place

FORMAT, VERSION = "e3pose-archive", 1
NAME = "manifest.json"
MARK = "e3pose-archive.json"  # tells an archive from a folder that is not mounted
MAX_BYTES = 50_000_000


@dataclass(frozen=True, slots=True)
class Entry:
    """An hour of a run.

    Attributes:
        hour: of the day, UTC.
        run: what a person calls the run.
        started_ns: when it began, nanoseconds since 1970, UTC.
        slots: that the store had of the hour.
        rows: of people, in the file.
        tracks: people in the file.
        bytes: of the file.
        sha256: of the file, hexadecimal; empty where nobody was there, and no file is.
        interval_s: seconds per slot; 0 in an archive that does not say it.
        skeleton: of the poses; files of one have the same columns.
    """

    hour: int
    run: str
    started_ns: int
    slots: int
    rows: int
    tracks: tuple[int, ...] = ()
    bytes: int = 0
    sha256: str = ""
    interval_s: float = 0.0
    skeleton: str = ""


@dataclass(frozen=True, slots=True)
class Manifest:
    """The content of an archive of a day of a site.

    Attributes:
        site: its name.
        day: UTC, such as 2026-11-25.
        files: hours by the name of their file.
        deleted: whether somebody asked for the day to be deleted: nothing of it comes back.
        format: `FORMAT`.
        version: `VERSION`.
    """

    site: str
    day: str
    files: Mapping[str, Entry] = field(default_factory=dict)
    deleted: bool = False
    format: str = FORMAT
    version: int = VERSION

    @property
    def folder(self) -> str:
        """Its folder in the archive, as DuckDB and others read partitions."""
        return f"site={self.site}/day={self.day}"

    def with_file(self, name: str, entry: Entry | None) -> Manifest:
        """Return the manifest with another file of a name, or with none."""
        files = {n: e for n, e in self.files.items() if n != name}
        if entry is not None:
            files[name] = entry
        return replace(self, files=dict(sorted(files.items())))


def check_there(place: Place) -> None:
    """Raise `InputError` where an archive was and none is now."""
    if place.read(MARK) is None:
        raise InputError(
            f"{place.name}: found no archive where one was, expected it: mount it; or where it is "
            "gone for good, begin anew: e3pose archive STORE DEST --new"
        )


def mark(place: Place) -> None:
    """Make a place an archive."""
    if place.read(MARK) is None:
        place.write(MARK, msgspec.json.encode({"format": FORMAT, "version": VERSION}))


def digest(content: bytes) -> str:
    """Return the SHA-256 of a file's content, hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def read_manifest(place: Place, site: str, day: str) -> Manifest | None:
    """Return the manifest of a day; None if there is none.

    Raises:
        InputError: for one that no archive writes.
    """
    name = f"{Manifest(site, day).folder}/{NAME}"
    content = place.read(name)
    if content is None:
        return None
    try:
        if len(content) > MAX_BYTES:
            raise msgspec.ValidationError(f"found {len(content)} bytes")
        found = msgspec.json.decode(content, type=Manifest)
    except UNDECODABLE as error:
        raise InputError(f"{place.name}/{name}: found no manifest ({error})") from None
    kind = found.format, found.version
    if kind != (FORMAT, VERSION) or (found.site, found.day) != (site, day):
        raise InputError(
            f"{place.name}/{name}: found {kind[0][:40]} version {kind[1]} of {found.site[:40]}, "
            f"{found.day[:10]}, expected {FORMAT} version {VERSION} of {site}, {day}"
        )
    if any("/" in file or not file.endswith(".parquet") for file in found.files):
        raise InputError(f"{place.name}/{name}: found a file outside its folder")
    return found


def write_manifest(place: Place, manifest: Manifest) -> None:
    """Write the manifest of a day, after all that it names."""
    content = msgspec.json.format(msgspec.json.encode(manifest), indent=1)
    place.write(f"{manifest.folder}/{NAME}", content)


def days_of(place: Place, site: str | None = None) -> list[tuple[str, str]]:
    """Return the sites and days of an archive that have a manifest, oldest first of each.

    A day that is no folder is one of them: whoever reads its manifest says so.
    """
    found = []
    for name in place.names("" if site is None else f"site={site}"):
        parts = name.split("/")
        no_folder = len(parts) == 2 and parts[1].startswith("day=")
        if parts[0].startswith("site=") and (no_folder or parts[2:] == [NAME]):
            found.append((parts[0].removeprefix("site="), parts[1].removeprefix("day=")))
    return sorted(found)


@dataclass(frozen=True, slots=True)
class Checked:
    """The findings of a check.

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
