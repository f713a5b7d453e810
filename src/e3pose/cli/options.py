"""Options that several verbs share, declared once."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Group, Parameter, Token

from e3pose.cli.output import STDOUT
from e3pose.errors import InputError
from e3pose.files.table import read_table
from e3pose.settings.energy import EnergySettings, IdleMode
from e3pose.settings.loop import FEEDBACK, ReplaySettings

LOOP, ENERGY = ReplaySettings(), EnergySettings()
# Groups of options in `--help`, in their order.
GOAL = Group("Goal", sort_key=1)
PAPER = Group("Only for --pipeline paper and its policies", sort_key=2)
POWER = Group("Energy", sort_key=3)
FAULTS = Group("Faults to inject", sort_key=4)
SMOOTHING = Group("Smoothing", sort_key=5)
OUTPUT = Group("Output", sort_key=6)


def whole_number(_: Any, tokens: Sequence[Token]) -> int:
    """Read a whole number and nothing that merely rounds to one."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"{tokens[0].value!r} is not a whole number") from None


Whole = Annotated[int, Parameter(converter=whole_number)]
Flag = Annotated[bool, Parameter(negative="")]  # an option without a --no- form
Redetect = Annotated[
    str | None,
    Parameter(
        help="Detect again in the recording's videos with this one: a name from "
        "`e3pose models list`, or the path of a network. Default: the recording's keypoints; with "
        "feedback, its detector."
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


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class LoopOptions:
    """How the loop runs, for every verb that runs it."""

    pipeline: str = LOOP.pipeline
    """Estimator. `default` (= `memory`): a Kalman-type filter per person that accepts any number
    of views, with the policy `information`. `paper`: the published system, which triangulates
    each slot from two or more views, with the policy `e3pose`."""
    target_error: Annotated[str | None, Parameter(group=GOAL)] = None
    """Wake as few cameras as keep the expected joint error below this: 40mm, 4cm. Replaces
    --cameras; policy `information` only."""
    budget: Annotated[str | None, Parameter(alias="-E")] = None
    """Energy budget E: share of slots a camera may be active, C/N to 1. Default: C/N + 0.2.
    `evaluate` also takes several, comma-separated."""
    quality_weight: Annotated[str | None, Parameter(alias="-V")] = None
    """Quality weight V: larger favours better views, smaller favours even energy use. For the
    paper's policies, V is the number of active slots that a typical difference of occlusion
    between two cameras is worth. Default: set by the policy. `evaluate` also takes several,
    comma-separated."""
    raw_weight: Annotated[bool, Parameter(group=PAPER, negative="")] = LOOP.raw_weight
    """V of the paper's policies weighs IoU itself, as in its eq. (9)."""
    lead: Whole = LOOP.lead_slots
    """Lead tau: slots between a decision and the slot it is for."""
    warmup: Whole = LOOP.warmup_slots
    """Warm-up M: slots at the start in which every camera detects."""
    seed: Whole = LOOP.seed
    """Random seed."""
    phase: Whole = LOOP.phase
    """Camera that starts the round robin and wins ties."""
    predictor: str | None = None
    """Motion predictor: attention-lstm, attention-lstm-paper (the published network),
    constant-velocity, damped-velocity, zero-velocity, or a file from `e3pose train`. The policy
    predicts with it; attention-lstm and trained files also correct the filter's velocities
    (pipeline `memory`). Default: attention-lstm for the correction and the policy's own for the
    policy; with --pipeline paper, attention-lstm-paper for the policy `e3pose`."""
    noise: str | None = None
    """Keypoint noise model: a detector name, or a file from `e3pose calibrate noise`. Default:
    the model of the recording's detector."""
    feedback: Annotated[bool, Parameter(negative="")] = LOOP.feedback
    """Semantic feedback: detect again in the videos of the recording, only where people are
    expected, in parts scaled to the network's best size. Same as +feedback after the name of a
    policy."""
    whole_every: Whole = LOOP.whole_every
    """With feedback, detect in the whole image every this many detections."""
    matcher: Annotated[str | None, Parameter(group=PAPER)] = None
    """How the views of one person are matched: `epipolar` (as the paper words it, default),
    `tanke-gall` (by the rules of the publication that the paper names) or `rays`."""
    match_distance: Annotated[str | None, Parameter(group=PAPER)] = None
    """Maximum mean distance between the rays of two views of one person: 100mm, 0.1m. Default:
    150mm. Matcher `rays` only."""
    epipolar_px: Annotated[float | None, Parameter(group=PAPER)] = None
    """Maximum mean distance from epipolar lines between two views of one person, in pixels.
    Default: 30 with the matcher `epipolar`, 20 with `tanke-gall`."""
    reject_outliers: Annotated[bool, Parameter(group=PAPER)] = LOOP.reject_outliers
    """Reject views that disagree with the others."""
    fill: Annotated[bool | None, Parameter(group=PAPER)] = None
    """Keep a joint that a slot lacks where it last was on the body. Default: on."""
    occlusion_limit: Annotated[float, Parameter(group=PAPER)] = LOOP.occlusion_limit
    """Occlusion threshold of the policy `independent`."""
    independent_queue: Annotated[bool, Parameter(group=PAPER, negative="")] = LOOP.independent_queue
    """Keep cameras of the policy `independent` within their energy budgets, too."""
    round_trip_ms: Annotated[float, Parameter(group=PAPER)] = 1000 * LOOP.round_trip_s
    """Network round trip that the policy `central-2d` waits for in each decision."""

    def settings(self, policy: str | None = None, cameras: float | None = None) -> ReplaySettings:
        """Return the settings that these options and two that some verbs have mean.

        Raises:
            InputError: naming the option.
        """
        given = {item.name: getattr(self, item.name) for item in fields(self)}
        if policy is not None and policy.endswith(FEEDBACK):
            policy, given["feedback"] = policy.removesuffix(FEEDBACK), True
        numbers = {name: _one(name, given[name]) for name in ("budget", "quality_weight")}
        table = {**given, **numbers, "policy": policy, "cameras": cameras}
        written = {key: value for key, value in table.items() if value is not None}
        with as_typed(options_of(LoopOptions, more=("cameras", "policy"))):
            return read_table(ReplaySettings, written)


def numbers_of(option: str, text: str, such_as: str) -> list[float]:
    """Return the numbers in a comma-separated list; raise `InputError` naming the option."""
    found = []
    for part in text.split(","):
        try:
            value = float(part)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            wanted = f"comma-separated numbers, such as {such_as}"
            raise InputError(option, repr(part.strip()[:40]), wanted)
        found.append(int(value) if value == int(value) else value)
    return list(dict.fromkeys(found))


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


@Parameter(name="*", group=POWER)
@dataclass(frozen=True, kw_only=True)
class EnergyOptions:
    """What the cameras draw, for every verb that reports energy."""

    profile: str = ENERGY.profile.usual or ""
    """Power profile of the cameras: xavier-nx, tx2, generic, or a TOML file. Per camera:
    xavier-nx,cam3=tx2."""
    idle_mode: IdleMode = ENERGY.idle_mode
    """Mode of a camera in slots in which it is not selected."""
    battery_wh: str | None = None
    """Battery capacity in watt-hours. Per camera: 50,cam1=20. Default: the recording's, else 50."""
    lifetime: Annotated[str | None, Parameter(group=GOAL)] = None
    """Make every battery last this long: 10h, 90min, 2d. Sets the budget of each camera. Without
    --cameras and --target-error it also sets how many cameras to wake."""

    def settings(self) -> EnergySettings:
        """Return the settings that these options mean; raise `InputError` naming the option."""
        given = {item.name: getattr(self, item.name) for item in fields(self)}
        written = {key: value for key, value in given.items() if value is not None}
        with as_typed(options_of(EnergyOptions)):
            return read_table(EnergySettings, written)
