"""Options that several verbs share, declared once."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter

from e3pose.base.atomic import check_output
from e3pose.base.errors import InputError
from e3pose.base.masking import masked
from e3pose.base.table import read_table
from e3pose.cli import app
from e3pose.cli.output import STDOUT
from e3pose.cli.settings_options import Flag as Flag
from e3pose.cli.settings_options import Whole as Whole
from e3pose.cli.settings_options import options_from
from e3pose.settings.energy import EnergySettings
from e3pose.settings.loop import EXPERIMENTS, PAPER_ONLY, ReplaySettings

# Groups of options in `--help`, in their order.
GOAL = Group("Goal", sort_key=1)
SMOOTHING = Group("Smoothing", sort_key=2)
OUTPUT = Group("Output", sort_key=3)
POWER = Group(app.POWER, sort_key=4)
STORE = Group(app.STORE, sort_key=5)
EXPERIMENT = Group(app.EXPERIMENTS, sort_key=6)
FAULTS = Group(app.FAULTS, sort_key=7)
PAPER = Group(app.PAPER, sort_key=8)
GROUPS = {"Goal": GOAL, "Energy": POWER, EXPERIMENTS: EXPERIMENT, PAPER_ONLY: PAPER}

StorePlace = Annotated[
    str, Parameter(help="Store: a file, a URL, or a site (site.toml or its folder).")
]
Redetect = Annotated[
    str | None,
    Parameter(
        group=EXPERIMENT,
        help="Detect again in the recording's videos with this one: a name from "
        "`e3pose models list`, or the path of a network. Default: the recording's keypoints; with "
        "feedback, its detector.",
    ),
]

HoldOut = Annotated[
    tuple[str, ...],
    Parameter(
        negative="",
        show_default=False,
        help="Judge the poses by this camera, which takes no part in them; repeatable. `each`: by "
        "every camera in turn.",
    ),
]


@contextmanager
def as_typed(names: Mapping[str, str], place: str = "") -> Iterator[None]:
    """Let errors name what was typed.

    Args:
        names: things that errors name, to the option or the key that a person wrote.
        place: that a person named on the command line, and that errors need not name again.
    """
    try:
        yield
    except InputError as error:
        if error.place not in ("", place) or error.thing not in names:
            raise
        raise InputError(names[error.thing], error.found, error.expected) from None


def options_of(*kinds: type, more: Sequence[str] = ()) -> dict[str, str]:
    """Return the options of some records, by the thing that errors name."""
    things = [item.name for kind in kinds for item in fields(kind)] + list(more)
    return {thing: f"--{thing.replace('_', '-')}" for thing in things}


def ask(question: str, ended: InputError) -> str:
    """Return a person's answer to a question; raise `ended` where the input ends instead."""
    try:
        return input(question)
    except EOFError:
        raise ended from None


def warn(text: str) -> None:
    """Print a line on standard error for the person who typed the command; nothing if empty."""
    if text:
        print(f"e3pose: warning: {masked(text)}", file=sys.stderr)


def check_outputs(source: Path, outputs: Mapping[str, Path | None]) -> None:
    """Raise `InputError` before hours of work for results that could not be written, or not both.

    Args:
        source: the recording, whose own files must stay.
        outputs: option to the file it names.
    """
    taken: dict[Path, str] = {}
    for option, path in outputs.items():
        if path is None or path == STDOUT:
            continue
        check_output(path)
        place = path.resolve()
        if place in taken:
            raise InputError(
                f"{option}: found the file of {taken[place]}, expected another: {path}"
            )
        taken[place] = option
        if place.is_relative_to(source.resolve()) and place.suffix in (".toml", ".jsonl"):
            raise InputError(f"{option}: found a file of the recording, expected another: {path}")


@options_from(ReplaySettings, GROUPS)
@dataclass(frozen=True, kw_only=True)
class LoopOptions:
    """Settings of the loop, for every verb that runs it; `evaluate` takes lists for two."""

    budget: str | None = None
    quality_weight: str | None = None

    def settings(self, policy: str | None = None, cameras: float | None = None) -> ReplaySettings:
        """Return the settings that these options and two that some verbs have mean.

        Raises:
            InputError: naming the option.
        """
        given = {item.name: getattr(self, item.name) for item in fields(self)}
        numbers = {name: _one(name, given[name]) for name in ("budget", "quality_weight")}
        table = {**given, **numbers, "policy": policy, "cameras": cameras}
        written = {key: value for key, value in table.items() if value is not None}
        with as_typed(options_of(LoopOptions, more=("cameras", "policy"))):
            return read_table(ReplaySettings, written)


def _one(name: str, text: str | None) -> float | None:
    """Return the one number of an option of which `evaluate` takes several."""
    if text is None:
        return None
    option = f"--{name.replace('_', '-')}"
    if "," in text:
        raise InputError(option, repr(text[:40]), "one number; e3pose evaluate compares several")
    try:
        return float(text)
    except ValueError:
        raise InputError(option, repr(text[:40]), "a number, such as 0.8") from None


@options_from(EnergySettings, GROUPS)
@dataclass(frozen=True, kw_only=True)
class EnergyOptions:
    """The power of the cameras, for every verb that reports energy."""

    def settings(self) -> EnergySettings:
        """Return the settings that these options mean; raise `InputError` naming the option."""
        given = {item.name: getattr(self, item.name) for item in fields(self)}
        written = {key: value for key, value in given.items() if value is not None}
        with as_typed(options_of(EnergyOptions)):
            return read_table(EnergySettings, written)
