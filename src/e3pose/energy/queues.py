"""Virtual queues, and the power that a selection draws by profiles of devices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.energy.profiles import PAPER_GROUPS, DeviceProfile, Mode
from e3pose.energy.profiles import load_profile as load_profile

DEFAULT_BATTERY_WH = 50.0
RADIO = "wifi"  # the group of components that sends


@dataclass(frozen=True, slots=True, eq=False)
class Queue:
    """The charges of a rig's virtual queues, and their price of an active slot.

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
    """Return the queues' price of an active slot: the drift of half their squares in joules.

    A queue of `deficit` slots holds `deficit * cost_j` joules, and an active slot adds `cost_j`, so
    that the drift is their product. It is given in units of the rig's mean cost, which makes it the
    paper's q_n where all cameras cost the same.

    Args:
        deficit: `(num_cameras,)` queue lengths in slots of activity.
        cost_j: `(num_cameras,)` energy of an active slot beyond that of an idle one.
    """
    return np.asarray(deficit * (cost_j / (cost_j.sum() / len(cost_j))) ** 2)


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


def mean_watts(
    duty: Floats,
    profiles: Sequence[DeviceProfile],
    idle_mode: Mode = "power-saving",
    sending: ArrayLike = 0.0,
    group: str | None = None,
) -> Floats:
    """Return `(num_cameras,)` mean power of cameras that are active in a share of the slots only.

    Args:
        duty: `(num_cameras,)` share of slots each camera was active, [0, 1].
        profiles: `(num_cameras,)` what the cameras draw.
        idle_mode: what a camera does that is not selected.
        sending: share of the slots in which a camera is idle but its WiFi sends, [0, 1 - duty],
            one for all or one for each.
        group: of components; None for the whole device.

    Raises:
        InputError: without a camera, or with a duty outside [0, 1].
    """
    shares = np.asarray(duty, dtype=np.float64)
    if shares.ndim != 1 or len(shares) == 0 or not ((shares >= 0) & (shares <= 1)).all():
        raise InputError(f"duty: found {shares.tolist()}, expected one share in [0, 1] per camera")
    active, idle = (
        np.array([each.watts(mode, group) for each in profiles]) for mode in ("active", idle_mode)
    )
    radio_w = [each.watts("active", RADIO) - each.watts(idle_mode, RADIO) for each in profiles]
    sent_w = np.asarray(sending, dtype=np.float64) * radio_w * (group in (None, RADIO))
    return np.asarray(shares * active + (1 - shares) * idle + sent_w)


def paper_percent(
    duty: float, profile: DeviceProfile, idle_mode: Mode = "power-saving", sending: float = 0.0
) -> float:
    """Return a camera's saving as the paper counts: of CPU, GPU, WiFi and memory alone, percent.

    Arguments are those of `mean_watts`, of one camera.
    """
    parts_w = sum(
        float(mean_watts(np.array([duty]), [profile], idle_mode, sending, group)[0])
        for group in PAPER_GROUPS
    )
    return 100 * (1 - parts_w / profile.paper_watts("active"))
