"""Energy settings of a rig: power profiles, batteries, budgets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Generic, Literal, TypeVar

from e3pose.base.errors import InputError
from e3pose.base.quantities import duration_s, number
from e3pose.base.table import entry
from e3pose.energy.profiles import DeviceProfile, load_profile, modes_of
from e3pose.energy.queues import DEFAULT_BATTERY_WH, active_cost_j, lifetime_budget
from e3pose.energy.rest_costs import RestCosts, rest_costs

T = TypeVar("T")
U = TypeVar("U")

RestChoice = Literal["none", "asleep", "suspended"]
AWAKE: RestChoice = "none"  # every camera, always
IdleMode = Literal["power-saving", "aggressive-power-saving"]


@dataclass(frozen=True, slots=True)
class PerCamera(Generic[T]):
    """One value for all cameras, one for each, or one for all with exceptions.

    Attributes:
        usual: for cameras that are no exception; None if every camera must be named.
        special: camera id to its value.
    """

    usual: T | None = None
    special: Mapping[str, T] = field(default_factory=dict)

    def each(self, thing: str, camera_ids: Sequence[str]) -> list[T]:
        """Return one value a camera; raise `InputError` about `thing` for other cameras."""
        for camera_id in self.special:
            if camera_id not in camera_ids:
                known = f"one of {', '.join(camera_ids)}"
                raise InputError(thing, f"camera {camera_id[:40]!r}", known)
        found = [self.special.get(camera_id, self.usual) for camera_id in camera_ids]
        for camera_id, value in zip(camera_ids, found, strict=True):
            if value is None:
                raise InputError(thing, f"nothing for camera {camera_id}", "a value for each")
        return [value for value in found if value is not None]

    def map(self, change: Callable[[T], U]) -> PerCamera[U]:
        """Return the results of a function of every value."""
        usual = None if self.usual is None else change(self.usual)
        return PerCamera(usual, {key: change(value) for key, value in self.special.items()})


def per_camera(text: object, read: Callable[[str], T], example: str) -> PerCamera[T]:
    """Read one value for all cameras, exceptions as `camera=value`, or both, with commas.

    Args:
        text: such as `50`, `50,cam1=20` or `cam1=20,cam2=50`.
        read: reads one value.
        example: for errors.

    Raises:
        InputError: for anything else, or two values for all cameras.
    """
    usual: T | None = None
    special: dict[str, T] = {}
    if not isinstance(text, str):
        raise InputError("", repr(text)[:40], f"text such as {example}")
    for part in text.split(","):
        name, equals, value = part.strip().rpartition("=")
        if equals:
            special[name] = read(value)
        elif usual is not None:
            raise InputError("", "two values for all cameras", example)
        else:
            usual = read(part.strip())
    return PerCamera(usual, special)


def read_profile(text: object) -> PerCamera[str]:
    """Read names of power profiles; unknown names are an error when they are loaded."""
    return per_camera(text, str, "xavier-nx or xavier-nx,cam3=tx2")


def read_battery_wh(text: object) -> PerCamera[float]:
    """Read capacities in watt-hours."""
    words = str(text) if isinstance(text, int | float) and not isinstance(text, bool) else text
    wanted = "watt-hours above 0, such as 50 or 50,cam1=20"
    return per_camera(words, lambda word: number(word, wanted), "50 or 50,cam1=20")


@dataclass(frozen=True, slots=True)
class EnergySettings:
    """The power and the energy of the cameras.

    See `LoopSettings` for what the fields say; by default a battery has what the recording or the
    site says of its camera.
    """

    profile: PerCamera[str] = entry(
        PerCamera("xavier-nx"),
        read=read_profile,
        shown="xavier-nx",
        group="Energy",
        help="""Power profile of the cameras: xavier-nx, tx2, generic, or a TOML file. Per camera:
        xavier-nx,cam3=tx2.""",
    )
    idle_mode: IdleMode = entry(
        "power-saving",
        group="Energy",
        help="Mode of a camera in slots in which it is not selected.",
    )
    battery_wh: PerCamera[float] | None = entry(
        None,
        read=read_battery_wh,
        group="Energy",
        help="""Battery capacity in watt-hours. Per camera: 50,cam1=20. Default: the recording's,
        else 50.""",
    )
    lifetime_s: float | None = entry(
        None,
        key="lifetime",
        read=duration_s,
        group="Goal",
        help="""Make every battery last this long, such as 10h. Sets the budget of each camera.""",
    )

    def plan(
        self,
        camera_ids: Sequence[str],
        interval_s: float,
        known_wh: Mapping[str, float] | None = None,
    ) -> EnergyPlan:
        """Return the plan of a rig; raise `InputError` for an impossible one.

        Args:
            camera_ids: the rig's.
            interval_s: of a slot.
            known_wh: by camera, what a recording or a site says of batteries.
        """
        if self.battery_wh is None:
            known = known_wh or {}
            battery_wh = [known.get(camera_id, DEFAULT_BATTERY_WH) for camera_id in camera_ids]
        else:
            battery_wh = self.battery_wh.each("battery_wh", camera_ids)
        profiles = [*map(cache(load_profile), self.profile.each("profile", camera_ids))]
        budget = None
        if self.lifetime_s is not None:
            shares = lifetime_budget(
                self.lifetime_s, battery_wh, profiles, camera_ids, self.idle_mode
            )
            budget = tuple(shares.tolist())
        costs = tuple(active_cost_j(profiles, self.idle_mode, interval_s).tolist())
        alike = max(costs) - min(costs) < 1e-9
        return EnergyPlan(
            tuple(profiles), tuple(battery_wh), self.idle_mode, budget, None if alike else costs
        )


@dataclass(frozen=True, slots=True)
class EnergyPlan:
    """The power and the energy of each camera.

    Attributes:
        profiles: of each camera.
        battery_wh: of each camera.
        idle_mode: what a camera does that is not selected.
        budget: share of slots of each camera that lets its battery last as asked; None without a
            lifetime.
        cost_j: energy of an active slot beyond an idle one, if that differs between cameras.
    """

    profiles: tuple[DeviceProfile, ...]
    battery_wh: tuple[float, ...]
    idle_mode: IdleMode
    budget: tuple[float, ...] | None
    cost_j: tuple[float, ...] | None

    @property
    def watts(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The power of the cameras when active, and when not."""
        return (
            tuple(profile.watts("active") for profile in self.profiles),
            tuple(profile.watts(self.idle_mode) for profile in self.profiles),
        )

    def rest_costs(self, rest: RestChoice) -> RestCosts | None:
        """Return the power of cameras awake and in a rest; None if all are to stay awake.

        A camera whose profile has no such rest never sleeps.

        Raises:
            InputError: when no camera has it.
        """
        if rest == "none":
            return None
        found = [modes_of(profile).rest(rest) for profile in self.profiles]
        if not any(found):
            names = ", ".join(dict.fromkeys(profile.name for profile in self.profiles))
            wanted = f"a profile with [rests.{rest}], see docs/reference/power-profiles.md"
            raise InputError("rest", f"{rest} with the profile {names}", wanted)
        return rest_costs(*self.watts, found)
