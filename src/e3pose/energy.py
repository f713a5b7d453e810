"""Energy: budgets and deficit queues, power profiles of devices, and what a selection saves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from e3pose.errors import InputError
from e3pose.profiles import GROUPS, DeviceProfile, Mode
from e3pose.profiles import load_profile as load_profile

Floats = NDArray[np.float64]

DEFAULT_BATTERY_WH = 50.0


def advance_deficit(deficit: Floats, budget: Floats, selected: NDArray[np.bool_]) -> Floats:
    """Advance the energy-deficit queues by one slot: the paper's `max(q - E, 0) + s`.

    Args:
        deficit: `(num_cameras,)` queue lengths before the slot, in slots of activity.
        budget: `(num_cameras,)` share of slots that each camera may be active, (0, 1].
        selected: `(num_cameras,)` cameras that were active in the slot.

    Returns:
        `(num_cameras,)` queue lengths after the slot; never negative.
    """
    return np.maximum(deficit - budget, 0.0) + selected


def price(deficit: Floats, cost_j: Floats) -> Floats:
    """Return what the queues ask for an active slot: the drift of half their squares in joules.

    A queue of `deficit` slots holds `deficit * cost_j` joules, and an active slot adds `cost_j`, so
    that the drift is their product. It is told in units of the rig's mean cost, which makes it the
    paper's q_n where all cameras cost the same.

    Args:
        deficit: `(num_cameras,)` queue lengths in slots of activity.
        cost_j: `(num_cameras,)` energy of an active slot beyond that of an idle one.
    """
    return np.asarray(deficit * (cost_j / cost_j.mean()) ** 2)


def check_budget(budget: ArrayLike, num_selected: float) -> None:
    """Check that budgets leave room for the cameras to be selected: every E_n >= C / N.

    Args:
        budget: `(num_cameras,)` share of slots that each camera may be active.
        num_selected: cameras to select in every slot, or on average.

    Raises:
        InputError: when a budget lies outside (0, 1] or below `num_selected / num_cameras`, or
            `num_selected` is not above 0 and at most `num_cameras`.
    """
    shares = np.asarray(budget, dtype=np.float64)
    if shares.ndim != 1 or len(shares) == 0:
        raise InputError(f"budget: found shape {shares.shape}, expected (num_cameras,)")
    if not 0 < num_selected <= len(shares):
        raise InputError(f"cameras: found {num_selected:g}, expected 1 to {len(shares)} to select")
    for share in shares:
        if not 0 < share <= 1:
            raise InputError(f"budget: found {share:g}, expected a share of slots in (0, 1]")
    if shares.min() < num_selected / len(shares) - 1e-9:
        raise InputError(
            f"budget: found {shares.min():g}, expected at least {num_selected / len(shares):g} "
            f"for {num_selected:g} of {len(shares)} cameras a slot"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Savings:
    """What a selection saves against every camera active in every slot.

    Percentages are of the always-active energy of the same components.

    Attributes:
        paper_percent: of CPU + GPU + WiFi + DDR, mean over cameras: the paper's figure.
        device_percent: of the whole device, mean over cameras.
        group_percent: of each group of components the device has, mean over cameras.
        camera_percent: `(num_cameras,)` of CPU + GPU + WiFi + DDR.
        camera_watts: `(num_cameras,)` mean power of the whole device.
        battery_h: `(num_cameras,)` hours a battery lasts at that power.
        battery_active_h: hours the same battery lasts an always active camera.
    """

    paper_percent: float
    device_percent: float
    group_percent: Mapping[str, float]
    camera_percent: Floats
    camera_watts: Floats
    battery_h: Floats
    battery_active_h: float


def savings(
    duty: ArrayLike,
    profile: DeviceProfile,
    idle_mode: Mode = "power-saving",
    battery_wh: float = DEFAULT_BATTERY_WH,
) -> Savings:
    """Compute what is saved by cameras that are active in a share of the slots only.

    Args:
        duty: `(num_cameras,)` share of slots each camera was active, [0, 1].
        profile: what the cameras draw; all cameras are the same device.
        idle_mode: what a camera does that is not selected.
        battery_wh: capacity of each camera's battery in watt-hours.

    Raises:
        InputError: without a camera, with a duty outside [0, 1] or a battery of no capacity.
    """
    shares = np.asarray(duty, dtype=np.float64)
    if shares.ndim != 1 or len(shares) == 0 or not ((shares >= 0) & (shares <= 1)).all():
        raise InputError(f"duty: found {shares.tolist()}, expected one share in [0, 1] per camera")
    if not (np.isfinite(battery_wh) and battery_wh > 0):
        raise InputError(f"battery capacity: found {battery_wh:g} Wh, expected more than 0")
    rest = 1 - shares
    camera_percent = rest * _percent(profile.paper_watts("active"), profile.paper_watts(idle_mode))
    device_percent = rest * _percent(profile.watts("active"), profile.watts(idle_mode))
    groups = {
        group: float(
            rest.mean() * _percent(profile.watts("active", group), profile.watts(idle_mode, group))
        )
        for group in GROUPS
        if profile.watts("active", group) > 0
    }
    watts = shares * profile.watts("active") + rest * profile.watts(idle_mode)
    return Savings(
        paper_percent=float(camera_percent.mean()),
        device_percent=float(device_percent.mean()),
        group_percent=groups,
        camera_percent=camera_percent,
        camera_watts=watts,
        battery_h=battery_wh / watts,
        battery_active_h=battery_wh / profile.watts("active"),
    )


def _percent(active: float, idle: float) -> float:
    return 100 * (1 - idle / active)
