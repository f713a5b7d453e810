"""Options that several verbs share, declared once."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter, Token

from e3pose.errors import InputError
from e3pose.settings.quantities import duration_s, length_m, number, per_camera

if TYPE_CHECKING:
    from e3pose.energy.profiles import DeviceProfile

# Of the camera slots that a lifetime affords: the rest lets the choice among the cameras be free.
LIFETIME_SHARE = 0.95


def whole_number(_: Any, tokens: Sequence[Token]) -> int:
    """Read a whole number and nothing that merely rounds to one."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"{tokens[0].value!r} is not a whole number") from None


Whole = Annotated[int, Parameter(converter=whole_number)]


def as_typed(error: InputError, names: Mapping[str, str], found_in: str = "") -> InputError:
    """Return an error that names what was typed, where it begins with what that sets.

    Args:
        error: such as `pace: found 7, expected ...`.
        names: what errors begin with, to what a person wrote: an option, or a key of a file.
        found_in: what to take off the beginning first.
    """
    text = str(error).removeprefix(found_in)
    word = re.match(r"([a-z_]+)( id)?(?=[: ])", text)
    if word is None or word[1] not in names:
        return error
    return InputError(f"{names[word[1]]}{text[word.end() :]}")


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

    pipeline: str = "default"
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
    lead: Whole = 1
    """tau, how many slots ahead the cameras are told."""
    warmup: Whole = 10
    """M, slots at the start in which every camera detects."""
    seed: Whole = 0
    """Of random choices."""
    phase: Whole = 0
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
            "target_error_m": None
            if self.target_error is None
            else length_m("--target-error", self.target_error),
            "budget": self.budget,
            "quality_weight": self.quality_weight,
            "lead_slots": self.lead,
            "warmup_slots": self.warmup,
            "seed": self.seed,
            "phase": self.phase,
            "predictor": self.predictor,
            "noise": self.noise,
            "match_distance_m": None
            if self.match_distance is None
            else length_m("--match-distance", self.match_distance),
            "reject_outliers": self.reject_outliers,
            "occlusion_limit": self.occlusion_limit,
            "round_trip_s": self.round_trip_ms / 1000,
        }


@dataclass(frozen=True, slots=True)
class EnergyPlan:
    """What every camera draws and has.

    Attributes:
        profiles: of each camera.
        battery_wh: of each camera.
        idle_mode: what a camera does that is not selected.
        budget: share of slots of each camera that lets its battery last as asked; None if nobody
            asked.
        cost_j: energy of an active slot beyond an idle one, if that differs between cameras.
    """

    profiles: tuple[DeviceProfile, ...]
    battery_wh: tuple[float, ...]
    idle_mode: Literal["power-saving", "aggressive-power-saving"]
    budget: tuple[float, ...] | None
    cost_j: tuple[float, ...] | None

    @property
    def watts(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """What the cameras draw when active, and when not."""
        return (
            tuple(profile.watts("active") for profile in self.profiles),
            tuple(profile.watts(self.idle_mode) for profile in self.profiles),
        )


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class EnergyOptions:
    """What the cameras draw, for every verb that reports energy."""

    profile: str = "xavier-nx"
    """Power profile of the cameras: xavier-nx, tx2, generic, or a TOML file; exceptions with
    commas, as in xavier-nx,cam3=tx2."""
    idle_mode: Literal["power-saving", "aggressive-power-saving"] = "power-saving"
    """What a camera does in slots for which it is not selected."""
    battery_wh: str | None = None
    """Capacity of the cameras' batteries in watt-hours; exceptions with commas: 50,cam1=20. By
    default what the recording says of a camera, and 50 for the others."""
    lifetime: str | None = None
    """Keep every camera's battery alive this long: 10h, 90min, 2d. Sets the budget of each camera,
    and without --cameras and --target-error wakes as many cameras as these pay for."""

    def plan(
        self,
        camera_ids: Sequence[str],
        interval_s: float,
        known_wh: Mapping[str, float] | None = None,
    ) -> EnergyPlan:
        """Return what these options mean for a rig; raise `InputError` for what cannot be.

        Args:
            camera_ids: the rig's.
            interval_s: of a slot.
            known_wh: by camera, what a recording says of batteries.
        """
        from e3pose.energy.profiles import load_profile
        from e3pose.energy.queues import DEFAULT_BATTERY_WH, active_cost_j, lifetime_budget

        battery_wh = per_camera(
            "--battery-wh",
            self.battery_wh or str(DEFAULT_BATTERY_WH),
            camera_ids,
            lambda text: number("--battery-wh", text, "watt-hours above 0"),
            "50 or 50,cam1=20",
        )
        if self.battery_wh is None:
            known = known_wh or {}
            battery_wh = [known.get(i, wh) for i, wh in zip(camera_ids, battery_wh, strict=True)]
        profiles = per_camera(
            "--profile", self.profile, camera_ids, load_profile, "a name or NAME,CAMERA=NAME"
        )
        budget = None
        if self.lifetime is not None:
            lifetime_s = duration_s("--lifetime", self.lifetime)
            shares = lifetime_budget(lifetime_s, battery_wh, profiles, camera_ids, self.idle_mode)
            budget = tuple(shares.tolist())
        costs = tuple(active_cost_j(profiles, self.idle_mode, interval_s).tolist())
        alike = max(costs) - min(costs) < 1e-9
        return EnergyPlan(
            tuple(profiles), tuple(battery_wh), self.idle_mode, budget, None if alike else costs
        )


def choice(
    cameras: float | None, settings: Mapping[str, Any], plan: EnergyPlan, num_cameras: int
) -> dict[str, Any]:
    """Return the fields of `ReplaySettings` that say how many cameras may be woken.

    Args:
        cameras: a number a slot, a mean, or None for what the other options leave.
        settings: of `LoopOptions`.
        plan: of `EnergyOptions`.
        num_cameras: of the rig.

    Raises:
        InputError: for options that contradict each other.
    """
    if cameras is not None and settings["target_error_m"] is not None:
        raise InputError("--target-error: chooses the number of cameras, expected no --cameras")
    if plan.budget is not None and settings["budget"] is not None:
        raise InputError("--lifetime: sets the budgets of all cameras, expected no --budget")
    budget = settings["budget"] if plan.budget is None else plan.budget
    if cameras is None:
        cameras = min(3, num_cameras)
        if plan.budget is not None:
            cameras = min(LIFETIME_SHARE * sum(plan.budget), num_cameras)
        elif settings["pipeline"] != "paper":
            cameras = min(2, num_cameras)
    return {"num_selected": cameras, "budget": budget, "cost_j": plan.cost_j}
