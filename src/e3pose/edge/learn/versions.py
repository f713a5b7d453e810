"""Versions of a site's predictor: numbered, checked, with rollback."""

from __future__ import annotations

import hashlib
import os
from contextlib import AbstractContextManager
from pathlib import Path

import msgspec

from e3pose.base.atomic import write_file
from e3pose.base.bounded import UNDECODABLE, read_bytes
from e3pose.base.errors import InputError
from e3pose.base.lock import hold
from e3pose.base.private import make_folder
from e3pose.base.table import read_table
from e3pose.predict.attention_lstm import MAX_WEIGHTS_BYTES

MANIFEST = "versions.json"
COPY = "versions.json.copy"  # the same again, for the day when the other is damaged
FORMAT = "e3pose predictor versions"
MAX_MANIFEST_BYTES = 2**20
WAIT_S = 10.0  # for another process that changes the versions
SHIPPED_NUMBER = 0  # the weights to begin with, which are never stored here


class Version(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A network, with its origin and errors.

    Attributes:
        number: rising; 0 is the one to begin with.
        parent: the number of the network that it was trained from, and replaced.
        created_s: seconds since 1970.
        sha256: of its weights.
        leads: slots ahead at which both were compared on the newest minutes.
        error_m: its mean errors there, metres.
        parent_error_m: those of its parent on the same windows.
        windows: how many these were.
    """

    number: int
    parent: int
    created_s: float
    sha256: str
    leads: tuple[int, ...]
    error_m: tuple[float, ...]
    parent_error_m: tuple[float, ...]
    windows: int


class Manifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of `versions.json`."""

    format: str = FORMAT
    current: int = SHIPPED_NUMBER
    last: int = SHIPPED_NUMBER  # the highest number that was ever given
    versions: tuple[Version, ...] = ()

    def find(self, number: int) -> Version | None:
        """Return a version, None for the shipped one; raise `InputError` if there is none."""
        if number == SHIPPED_NUMBER:
            return None
        for version in self.versions:
            if version.number == number:
                return version
        known = ", ".join(str(v.number) for v in self.versions)
        raise InputError("version", number, f"one of 0, {known}".rstrip(", "))


def check_learning_folder(folder: Path) -> None:
    """Raise `InputError` unless the folder is new, empty, or one of an earlier learner."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: found a file, expected a folder to learn in")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / "versions").is_dir():
        raise InputError(
            f"{folder}: found a folder of other things, expected a new one or one to go on in"
        )


def _check(manifest: Manifest, path: Path) -> None:
    numbers = [version.number for version in manifest.versions]
    if len(set(numbers)) < len(numbers) or manifest.current not in (SHIPPED_NUMBER, *numbers):
        raise InputError(
            f"{path}: found versions {numbers[:20]}, current {manifest.current}, "
            "expected every number once and the current one among them"
        )
    for version in manifest.versions:
        fits = (
            0 < version.number < 2**53
            and 0 <= version.parent < version.number
            and 0 <= version.created_s <= 1e11
            and len(version.leads) == len(version.error_m) == len(version.parent_error_m)
            and len(version.sha256) == 64
        )
        if not fits:
            raise InputError(f"{path}: version {version.number}: found figures that cannot be")


class VersionStore:
    """A folder of versions. Processes that change it at the same time wait for each other."""

    def __init__(self, folder: Path, keep: int = 5) -> None:
        make_folder(folder)
        self.folder, self.keep = folder, keep

    def read(self) -> Manifest:
        """Return the manifest, an empty one where there is none yet.

        Raises:
            InputError: when it is damaged.
        """
        path = self.folder / MANIFEST
        return self._read(path) if path.exists() else Manifest()

    def _read(self, path: Path) -> Manifest:
        try:
            table = msgspec.json.decode(read_bytes(path, MAX_MANIFEST_BYTES))
        except UNDECODABLE as error:
            raise InputError(f"{path}: found no list of versions ({error})") from None
        try:
            manifest = read_table(Manifest, table)
        except InputError as error:
            raise error.at(path) from None
        if manifest.format != FORMAT:
            raise InputError(f"{path}: format: found {manifest.format[:40]!r}, expected {FORMAT!r}")
        _check(manifest, path)
        return manifest

    def weights(self, version: Version) -> Path:
        """Return the file of a version's weights; raise `InputError` if it is not as it was."""
        path = self._path(version.number)
        found = hashlib.sha256(read_bytes(path, MAX_WEIGHTS_BYTES)).hexdigest()
        if found != version.sha256:
            raise InputError(f"{path}: found a damaged file, expected SHA-256 {version.sha256}")
        return path

    def add(self, content: bytes, card: str, describe: Version) -> Version:
        """Store weights as the next version and make it current.

        Args:
            content: the weights.
            card: their model card.
            describe: the version, but for its number and checksum.
        """
        with self._lock():
            manifest = self.read()
            number = 1 + max(manifest.last, *(v.number for v in manifest.versions), 0)
            version = msgspec.structs.replace(
                describe, number=number, sha256=hashlib.sha256(content).hexdigest()
            )
            write_file(self._path(number), content)
            write_file(self._path(number).with_suffix(".md"), card)
            kept = [*manifest.versions, version]
            spared = {number, version.parent, *(v.number for v in kept[-self.keep :])}
            kept = [v for v in kept if v.number in spared]
            self._write(Manifest(current=number, last=number, versions=tuple(kept)))
            for path in self.folder.glob("*.onnx"):
                if path.stem.isdecimal() and int(path.stem) not in spared:
                    path.unlink(missing_ok=True)
                    path.with_suffix(".md").unlink(missing_ok=True)
            # Of a process that was killed while it wrote one.
            for path in self.folder.glob(".[0-9]*.onnx.*"):
                path.unlink(missing_ok=True)
        return version

    def use(self, number: int) -> None:
        """Make another version current; raise `InputError` if there is none, or it is damaged."""
        self.read().find(number)  # before a lock is made
        with self._lock():
            manifest = self.read()
            version = manifest.find(number)
            if version is not None:
                self.weights(version)
            self._write(msgspec.structs.replace(manifest, current=number))

    def back(self) -> int:
        """Make the network current that the current one replaced; return its number.

        Raises:
            InputError: when the current one replaced none.
        """
        manifest = self.read()
        version = manifest.find(manifest.current)
        if version is None:
            raise InputError(
                f"{self.folder}: found the network to begin with, nothing is before it"
            )
        parent = version.parent
        while parent and all(v.number != parent for v in manifest.versions):
            parent = SHIPPED_NUMBER  # it is no longer kept
        self.use(parent)
        return parent

    def put_aside(self) -> tuple[Path, Manifest]:
        """Move a damaged manifest aside; return its new path and its replacement.

        Its copy replaces it; where that is damaged too, one that names the network to begin with.
        """
        path = self.folder / MANIFEST
        aside = path.with_name(f"{MANIFEST}.damaged")
        with self._lock():
            os.replace(path, aside)
            try:
                manifest = self._read(self.folder / COPY)
            except InputError:
                numbers = [int(p.stem) for p in self.folder.glob("*.onnx") if p.stem.isdecimal()]
                manifest = Manifest(last=max(numbers, default=0))
            self._write(manifest)
        return aside, manifest

    def _path(self, number: int) -> Path:
        return self.folder / f"{number:06d}.onnx"

    def _write(self, manifest: Manifest) -> None:
        content = msgspec.json.format(msgspec.json.encode(manifest)) + b"\n"
        for name in (MANIFEST, COPY):
            write_file(self.folder / name, content)

    def _lock(self) -> AbstractContextManager[None]:
        return hold(self.folder / MANIFEST, wait_s=WAIT_S)
