"""Findings of the parts of a site, with their fixes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from e3pose.base.errors import InputError
from e3pose.base.masking import masked

Level = Literal["ok", "warning", "problem"]


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check.

    Attributes:
        level: how it is.
        what: what was checked.
        found: how it was found; empty where nothing is to be said.
        advice: what to do about it; empty if nothing.
    """

    level: Level
    what: str
    found: str = ""
    advice: str = ""

    @property
    def line(self) -> str:
        """The finding in one line."""
        return ": ".join(filter(None, (self.what, self.found, self.advice)))


def ok(what: str, found: str = "", advice: str = "") -> Finding:
    """Return a fact."""
    return Finding("ok", what, masked(found), masked(advice))


def warning(what: str, found: str, advice: str = "") -> Finding:
    """Return the finding of a weakness."""
    return Finding("warning", what, masked(found), masked(advice))


def problem(what: str, found: str, advice: str = "") -> Finding:
    """Return the finding of a problem, which keeps a site from working."""
    return Finding("problem", what, masked(found), masked(advice))


def report(findings: Iterable[Finding], warn: Callable[[str], object], refusing: str = "") -> None:
    """Print the findings at the start of a program.

    Args:
        findings: of its parts.
        warn: called with a line for each warning or problem.
        refusing: the file whose problems keep the program from starting; empty if none does.

    Raises:
        InputError: for the first problem, if problems are refused.
    """
    for finding in findings:
        if finding.level == "problem" and refusing:
            raise InputError(f"{refusing}: {finding.line}")
        if finding.level != "ok":
            warn(finding.line)
