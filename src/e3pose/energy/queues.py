"""Virtual queues, power profiles of devices, and energy saved by a selection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.energy.profiles import GROUPS, DeviceProfile, Mode
from e3pose.energy.profiles import load_profile as load_profile

DEFAULT_BATTERY_WH = 50.0
RADIO = "wifi"  # the group of components that sends


@dataclass(frozen=True, slots=True, eq=False)
class Queue:
    """How the virtual queues of a rig are charged, and what they ask for an active slot.

    Attributes:
        budget: `(num_cameras,)` the paper's E_n.
        cost_j: `(num_cameras,)` energy of an active slot beyond that of an idle one; only its
            proportions matter, and the paper has it 1 for all.
        as_published: the queue alone is charged, eq. (9), whatever cameras cost, and the first
            decision is made in slot M, for slot M + tau, as in Algorithm 1.
    """

    budget: Floats
    cost_j: Floats | None = None
    as_published: bool = False

    def price(self, deficit: Floats) -> Floats:
        """Return `(num_cameras,)` what queues of `deficit` slots ask for an active slot."""
        if self.as_published or self.cost_j is None:
            return deficit
        return price(deficit, self.cost_j)

    def after(self, deficit: Floats, selected: NDArray[np.bool_]) -> Floats:
        """Return `(num_cameras,)` the queues after a slot in which cameras are `selected`."""
        return advance_deficit(deficit, self.budget, selected)


def advance_deficit(deficit: Floats, budget: Floats, selected: NDArray[np.bool_]) -> Floats:
    """Advance the energy-deficit queues by one slot: `max(q - E, 0) + s`, paper eq. (8).

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
    that the drift is their product. It is given in units of the rig's mean cost, which makes it the
    paper's q_n where all cameras cost the same.

    Args:
        deficit: `(num_cameras,)` queue lengths in slots of activity.
        cost_j: `(num_cameras,)` energy of an active slot beyond that of an idle one.
    """
    return np.asarray(deficit * (cost_j / cost_j.mean()) ** 2)


def active_cost_j(profiles: Sequence[DeviceProfile], idle_mode: Mode, interval_s: float) -> Floats:
    """Return `(num_cameras,)` joules that an active slot costs beyond an idle one."""
    watts = [profile.watts("active") - profile.watts(idle_mode) for profile in profiles]
    return np.array(watts) * interval_s


def lifetime_budget(
    lifetime_s: float,
    battery_wh: ArrayLike,
    profiles: Sequence[DeviceProfile],
    camera_ids: Sequence[str],
    idle_mode: Mode = "power-saving",
) -> Floats:
    """Return the share of slots that lets every camera's battery last.

    A battery of `battery_wh` affords `battery_wh / lifetime` watts; what is left of these after the
    power of an idle camera pays for active slots.

    Args:
        lifetime_s: seconds that the batteries are to last.
        battery_wh: `(num_cameras,)`, or one for all.
        profiles: `(num_cameras,)` devices.
        camera_ids: `(num_cameras,)` names, for errors.
        idle_mode: what a camera does that is not selected.

    Returns:
        `(num_cameras,)` the paper's E_n, in (0, 1].

    Raises:
        InputError: naming the camera whose battery an idle camera would empty before.
    """
    if not (np.isfinite(lifetime_s) and lifetime_s > 0):
        raise InputError("lifetime", f"{lifetime_s:g} s", "more than 0")
    capacity_j = 3600 * np.broadcast_to(np.asarray(battery_wh, dtype=np.float64), len(profiles))
    idle = np.array([profile.watts(idle_mode) for profile in profiles])
    active = np.array([profile.watts("active") for profile in profiles])
    spare = capacity_j / lifetime_s - idle
    worst = int(np.argmin(spare))
    if spare[worst] <= 0:
        capacity_wh = capacity_j[worst] / 3600
        raise InputError(
            "lifetime",
            f"{lifetime_s / 3600:.3g} h for camera {camera_ids[worst]}",
            f"less than {capacity_wh / idle[worst]:.3g} h, which {capacity_wh:g} Wh last a camera "
            f"in {idle_mode} mode that is never selected",
        )
    return np.asarray(np.minimum(spare / np.maximum(active - idle, 1e-9), 1.0))


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
        battery_active_h: hours the same battery lasts an always active camera, mean over cameras.
    """

    paper_percent: float
    device_percent: float
    group_percent: Mapping[str, float]
    camera_percent: Floats
    camera_watts: Floats
    battery_h: Floats
    battery_active_h: float

    def with_sleep(self, slept_w: Floats, active_w: Floats, battery_wh: ArrayLike) -> Savings:
        """Return the same of cameras that also slept.

        What sleep saves of each group of components is not known: their shares stay.

        Args:
            slept_w: `(num_cameras,)` watts that sleep took off the mean draw.
            active_w: `(num_cameras,)` of the whole device when it is always active.
            battery_wh: capacity of the cameras' batteries, one for all or one for each.
        """
        watts = self.camera_watts - slept_w
        return replace(
            self,
            device_percent=self.device_percent + 100 * float((slept_w / active_w).mean()),
            camera_watts=watts,
            battery_h=np.asarray(battery_wh, dtype=np.float64) / watts,
        )


def savings(
    duty: ArrayLike,
    profile: DeviceProfile | Sequence[DeviceProfile],
    idle_mode: Mode = "power-saving",
    battery_wh: ArrayLike = DEFAULT_BATTERY_WH,
    sending: ArrayLike = 0.0,
) -> Savings:
    """Compute what is saved by cameras that are active in a share of the slots only.

    Args:
        duty: `(num_cameras,)` share of slots each camera was active, [0, 1].
        profile: what the cameras draw, one for all or one for each.
        idle_mode: what a camera does that is not selected.
        battery_wh: capacity of the cameras' batteries in watt-hours, one for all or one for each.
        sending: share of the slots in which a camera is idle but its WiFi sends, [0, 1 - duty],
            one for all or one for each.

    Raises:
        InputError: without a camera, with a duty outside [0, 1] or a battery of no capacity.
    """
    shares = np.asarray(duty, dtype=np.float64)
    if shares.ndim != 1 or len(shares) == 0 or not ((shares >= 0) & (shares <= 1)).all():
        raise InputError(f"duty: found {shares.tolist()}, expected one share in [0, 1] per camera")
    capacity_wh = np.broadcast_to(np.asarray(battery_wh, dtype=np.float64), shares.shape)
    for capacity in capacity_wh:
        if not (np.isfinite(capacity) and capacity > 0):
            raise InputError(f"battery capacity: found {capacity:g} Wh, expected more than 0")
    profiles = [profile] * len(shares) if isinstance(profile, DeviceProfile) else list(profile)
    rest = 1 - shares
    radio_w = [each.watts("active", RADIO) - each.watts(idle_mode, RADIO) for each in profiles]
    sent_w = np.asarray(np.asarray(sending, dtype=np.float64) * radio_w)
    active = np.array([each.watts("active") for each in profiles])
    camera_percent = rest * [
        _percent(each.paper_watts("active"), each.paper_watts(idle_mode)) for each in profiles
    ] - 100 * sent_w / [each.paper_watts("active") for each in profiles]
    device_percent = (
        rest * [_percent(each.watts("active"), each.watts(idle_mode)) for each in profiles]
        - 100 * sent_w / active
    )
    groups = {
        group: float(
            np.mean(
                rest
                * [
                    _percent(each.watts("active", group), each.watts(idle_mode, group))
                    for each in profiles
                ]
                - 100
                * sent_w
                / [each.watts("active", group) for each in profiles]
                * (group == RADIO)
            )
        )
        for group in GROUPS
        if all(each.watts("active", group) > 0 for each in profiles)
    }
    watts = shares * active + rest * [each.watts(idle_mode) for each in profiles] + sent_w
    return Savings(
        paper_percent=float(camera_percent.mean()),
        device_percent=float(device_percent.mean()),
        group_percent=groups,
        camera_percent=camera_percent,
        camera_watts=watts,
        battery_h=capacity_wh / watts,
        battery_active_h=float((capacity_wh / active).mean()),
    )


def _percent(active: float, idle: float) -> float:
    return 100 * (1 - idle / active)
