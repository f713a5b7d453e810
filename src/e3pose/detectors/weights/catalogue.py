"""Catalogue of networks: source of the weights, licence and checksum."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources

from e3pose.base.bounded import parse_toml
from e3pose.base.table import read_table


@dataclass(frozen=True, slots=True)
class FromUrl:
    """Weights that are a file of their own at their publisher's."""

    url: str


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
        name: of the model and of its detector.
        title: for people.
        licence: of the weights.
        source: where `pull` gets them, or None where the user brings their own.
        filename: in the cache.
        size_bytes: exact; 0 if the user brings their own.
        sha256: of the weights' file.
    """

    name: str
    title: str
    licence: str
    source: FromUrl | FromIndex | None = None
    filename: str = ""
    size_bytes: int = 0
    sha256: str = ""


MODELS = {
    name: read_table(Network, {"name": name, **row})
    for name, row in parse_toml(
        resources.files(__package__).joinpath("catalogue.toml").read_text(encoding="utf-8"),
        "catalogue.toml",
    ).items()
}
