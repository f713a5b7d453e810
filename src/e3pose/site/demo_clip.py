"""The four-camera clip of the demo, downloaded from a Python package index."""

from __future__ import annotations

import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError
from e3pose.detectors.weights import Progress, cache_folder, fetch_from_index
from e3pose.detectors.weights.fetch import CHUNK_BYTES, file_sha256, no_progress, save_verified

PROJECT, VERSION = "pose2sim", "0.10.49"
WHEEL_SHA256 = "403e0dc4065898ba6a595e72a8970950310979253d60e24c2e00b16b36bf21e1"
TITLE = "Balancing and watching: a real scene, four cameras"
SOURCE = (
    f"The multi-person demonstration videos of {PROJECT} {VERSION} (BSD-3-Clause, David Pagnon and "
    "contributors), taken from its package without installing it."
)
TOP = "Pose2Sim/Demo_MultiPerson/"


@dataclass(frozen=True, slots=True)
class Member:
    """One file of the wheel: its place and checksum."""

    name: str
    size_bytes: int
    sha256: str


CALIBRATION = Member(
    "calibration/Calib.qca.txt",
    4843,
    "fd90e4bbae3278ef1dc0cdd42a34ee06bf88286f628a02c00a29407aa39e34c5",
)
# The files are named after the cameras of the calibration, and start together: reprojection errors
# are smallest with this pairing and no offset. They hold frames as calibrated, not turned.
VIDEOS = (
    Member(
        "videos/cam01.mp4",
        764061,
        "543cee6a4c2c2b52dc9eac9137ee63d14f1f84e706a9a7264769edcb11e5ea53",
    ),
    Member(
        "videos/cam02.mp4",
        610385,
        "8895092a7cf26359205a427b7ac2f4a935c2e0bd36d9b7a5140cb33faa468a6b",
    ),
    Member(
        "videos/cam03.mp4",
        801091,
        "d3daf48cdf9f5603868ddb99166ddaf9b12279e7ce968922926560d5fd3f0c99",
    ),
    Member(
        "videos/cam04.mp4",
        877130,
        "1490149dc40e7301fa5ceae23862b044ba5c398a8b2a40df21ed894702728c09",
    ),
)
MEMBERS = (CALIBRATION, *VIDEOS)


@dataclass(frozen=True, slots=True)
class Clip:
    """Where the clip is: a calibration, and one video per camera."""

    calibration: Path
    videos: tuple[Path, ...]


def clip_folder() -> Path:
    """Return the folder of the clip, in the user's cache."""
    return cache_folder() / "clips" / f"{PROJECT}-{VERSION}"


def find_clip() -> Clip | None:
    """Return the clip if it is in the cache, whole and unaltered."""
    paths = {member: clip_folder() / Path(member.name).name for member in MEMBERS}
    if not all(path.is_file() and file_sha256(path) == m.sha256 for m, path in paths.items()):
        return None
    return Clip(paths[CALIBRATION], tuple(paths[video] for video in VIDEOS))


def fetch_clip(progress: Progress = no_progress, index_url: str | None = None) -> Clip:
    """Fetch the clip into the cache, unless it is there.

    The wheel is only read as an archive: nothing of it is installed or run, only the five files
    are taken out, and it is thrown away.

    Raises:
        InputError: when it cannot be fetched or is not what it should be.
    """
    clip = find_clip()
    if clip is not None:
        return clip
    with tempfile.TemporaryDirectory(prefix="e3pose-") as folder:
        wheel = Path(folder) / f"{PROJECT}.whl"
        fetch_from_index(PROJECT, VERSION, "wheel", WHEEL_SHA256, wheel, progress, index_url)
        extract_members(wheel, MEMBERS, clip_folder())
    clip = find_clip()
    assert clip is not None  # every member was verified on its way
    return clip


def extract_members(wheel: Path, members: tuple[Member, ...], dest: Path) -> None:
    """Write the members of a wheel to the folder `dest`, each under its own last name.

    Names inside the archive are only looked up, never used as paths, and no member is read beyond
    the size it should have.

    Raises:
        InputError: when the archive is damaged, or a member is missing or another.
    """
    try:
        with zipfile.ZipFile(wheel) as archive:
            for member in members:
                where = f"{wheel.name}: {member.name}"
                try:
                    source = archive.open(TOP + member.name)
                except KeyError:
                    raise InputError(f"{where}: not in the archive") from None
                target = dest / Path(member.name).name
                with source, atomic_file(target) as temporary, temporary.open("wb") as file:
                    save_verified(_chunks(source), file, where, member.sha256, member.size_bytes)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise InputError(f"{wheel.name}: not a readable wheel: {error}") from None


def _chunks(source: IO[bytes]) -> Iterator[bytes]:
    while chunk := source.read(CHUNK_BYTES):
        yield chunk
