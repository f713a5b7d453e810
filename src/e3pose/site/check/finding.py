"""Findings of checks, with their fixes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "warning", "problem"]


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check.

    Attributes:
        level: how it is.
        what: what was checked.
        found: how it was found.
        advice: what to do about it; empty if nothing.
    """

    level: Level
    what: str
    found: str
    advice: str = ""
