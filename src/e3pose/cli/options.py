"""Options that several verbs share, declared once."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter, Token

from e3pose.errors import InputError
from e3pose.files.table import read_table
from e3pose.settings.energy import EnergySettings, IdleMode
from e3pose.settings.loop import ReplaySettings

LOOP, ENERGY = ReplaySettings(), EnergySettings()


def whole_number(_: Any, tokens: Sequence[Token]) -> int:
    """Read a whole number and nothing that merely rounds to one."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"{tokens[0].value!r} is not a whole number") from None


Whole = Annotated[int, Parameter(converter=whole_number)]


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


def warn(text: str) -> None:
    """Print a line on standard error for the person who typed the command; nothing if empty."""
    if text:
        print(f"e3pose: warning: {text}", file=sys.stderr)


def check_outputs(source: Path, outputs: Mapping[str, Path | None]) -> None:
    """Raise `InputError` before hours of work for results that could not be written, or not both.

    Args:
        source: the recording, whose own files must stay.
        outputs: option to the file it names.
    """
    from e3pose.files.atomic import check_output

    taken: dict[Path, str] = {}
    for option, path in outputs.items():
        if path is None:
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


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class LoopOptions:
    """How the loop runs, for every verb that runs it."""

    pipeline: str = LOOP.pipeline
    """How the people are found: `default`, which is `memory`, keeps a filter per person, goes on
    with any number of views, and lets the policy `information` decide; `paper` is the published
    system, which places people slot by slot from two views each, under its policy `e3pose`."""
    target_error: str | None = None
    """Wake as few cameras as keep the expected error of the joints below this: 40mm, 4cm. In place
    of --cameras, for the policy `information`."""
    budget: Annotated[float | None, Parameter(alias="-E")] = None
    """E, the share of slots a camera may be active in, C/N to 1; C/N + 0.2 by default."""
    quality_weight: Annotated[float | None, Parameter(alias="-V")] = None
    """V: larger prefers clear views, smaller prefers even batteries; the policy's own by default
    (1, `information` 10)."""
    lead: Whole = LOOP.lead_slots
    """tau, how many slots ahead the cameras are told."""
    warmup: Whole = LOOP.warmup_slots
    """M, slots at the start in which every camera detects."""
    seed: Whole = LOOP.seed
    """Of random choices."""
    phase: Whole = LOOP.phase
    """Which camera comes first in turns and ties."""
    predictor: str | None = None
    """What foresees the poses for the policy and steers the filter of the pipeline `memory`:
    attention-lstm or a file of `e3pose train`; constant-velocity, damped-velocity and zero-velocity
    steer nothing. By default attention-lstm steers and the policy has its own."""
    noise: str | None = None
    """How far off keypoints are, by score: a detector's name, or a file made by
    `e3pose calibrate noise`; by default as the recording's detector is known to err."""
    match_distance: str | None = None
    """How far apart the rays of two views may pass, as a mean over the joints, to show one person:
    100mm, 0.1m; 150mm by default. For the pipeline `paper` alone."""
    reject_outliers: bool = LOOP.reject_outliers
    """Leave out views that disagree with the others."""
    occlusion_limit: float = LOOP.occlusion_limit
    """The threshold of the policy `independent`."""
    round_trip_ms: float = 1000 * LOOP.round_trip_s
    """The delay that the policy `central-2d` waits for in every decision."""

    def settings(self, policy: str | None = None, cameras: float | None = None) -> ReplaySettings:
        """Return the settings that these options and two that some verbs have mean.

        Raises:
            InputError: naming the option.
        """
        given = {item.name: getattr(self, item.name) for item in fields(self)}
        table = {**given, "policy": policy, "cameras": cameras}
        written = {key: value for key, value in table.items() if value is not None}
        with as_typed(options_of(LoopOptions, more=("cameras", "policy"))):
            return read_table(ReplaySettings, written)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class EnergyOptions:
    """What the cameras draw, for every verb that reports energy."""

    profile: str = ENERGY.profile.usual or ""
    """Power profile of the cameras: xavier-nx, tx2, generic, or a TOML file; exceptions with
    commas, as in xavier-nx,cam3=tx2."""
    idle_mode: IdleMode = ENERGY.idle_mode
    """What a camera does in slots for which it is not selected."""
    battery_wh: str | None = None
    """Capacity of the cameras' batteries in watt-hours; exceptions with commas: 50,cam1=20. By
    default what the recording says of a camera, and 50 for the others."""
    lifetime: str | None = None
    """Keep every camera's battery alive this long: 10h, 90min, 2d. Sets the budget of each camera,
    and without --cameras and --target-error wakes as many cameras as these pay for."""

    def settings(self) -> EnergySettings:
        """Return the settings that these options mean; raise `InputError` naming the option."""
        given = {item.name: getattr(self, item.name) for item in fields(self)}
        written = {key: value for key, value in given.items() if value is not None}
        with as_typed(options_of(EnergyOptions)):
            return read_table(EnergySettings, written)
