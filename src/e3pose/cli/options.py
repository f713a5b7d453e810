"""Options that several verbs share, declared once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter, Token

from e3pose.errors import InputError


def whole_number(_: Any, tokens: Sequence[Token]) -> int:
    """Read a whole number and nothing that merely rounds to one."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"{tokens[0].value!r} is not a whole number") from None


Whole = Annotated[int, Parameter(converter=whole_number)]


def check_outputs(source: Path, outputs: Mapping[str, Path | None]) -> None:
    """Raise `InputError` before hours of work for results that could not be written, or not both.

    Args:
        source: the recording, whose own files must stay.
        outputs: option to the file it names.
    """
    from e3pose.atomic import check_file_free

    taken: dict[Path, str] = {}
    for option, path in outputs.items():
        if path is None:
            continue
        check_file_free(path)
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

    pipeline: str = "paper"
    """The estimator: `paper` places people slot by slot, from two views each; `memory` keeps a
    filter per person and goes on with any number of views."""
    budget: Annotated[float | None, Parameter(alias="-E")] = None
    """E, the share of slots a camera may be active in, C/N to 1; C/N + 0.2 by default."""
    quality_weight: Annotated[float, Parameter(alias="-V")] = 1.0
    """V: larger prefers clear views, smaller prefers even batteries."""
    lead: Whole = 1
    """tau, how many slots ahead the cameras are told."""
    warmup: Whole = 10
    """M, slots at the start in which every camera detects."""
    seed: Whole = 0
    """Of random choices."""
    phase: Whole = 0
    """Which camera comes first in turns and ties."""
    predictor: str | None = None
    """What foresees the poses: attention-lstm, constant-velocity, damped-velocity, zero-velocity;
    by default the policy's own."""
    reject_outliers: bool = False
    """Leave out views that disagree with the others."""
    occlusion_limit: float = 0.1
    """The threshold of the policy `independent`."""
    round_trip_ms: float = 50.0
    """The delay that the policy `central-2d` waits for in every decision."""

    def settings(self) -> dict[str, Any]:
        """Return the fields of `ReplaySettings` that these options set."""
        return {
            "pipeline": self.pipeline,
            "budget": self.budget,
            "quality_weight": self.quality_weight,
            "lead_slots": self.lead,
            "warmup_slots": self.warmup,
            "seed": self.seed,
            "phase": self.phase,
            "predictor": self.predictor,
            "reject_outliers": self.reject_outliers,
            "occlusion_limit": self.occlusion_limit,
            "round_trip_s": self.round_trip_ms / 1000,
        }


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class EnergyOptions:
    """What the cameras draw, for every verb that reports energy."""

    profile: str = "xavier-nx"
    """Power profile of the cameras: xavier-nx, tx2, generic, or a TOML file."""
    idle_mode: Literal["power-saving", "aggressive-power-saving"] = "power-saving"
    """What a camera does in slots for which it is not selected."""
    battery_wh: float = 50.0
    """Capacity of each camera's battery in watt-hours."""

    def check(self) -> None:
        """Raise `InputError` for a battery that cannot be."""
        if not 0 < self.battery_wh < float("inf"):
            raise InputError(f"--battery-wh: found {self.battery_wh:g}, expected more than 0")
