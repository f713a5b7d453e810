"""Power of a rig looking, awake and asleep, and the time to fall asleep and to wake."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.energy.modes import Rest

# Standard deviations before the mean time to wake: one in 44 normal wakes is late; with 1 one in 6
# is, with 3 the margin in which a camera idles is half as long again.
LATE_SIGMAS = 2.0


Seconds = TypeVar("Seconds", float, Floats)


def alarm_s(wake_s: Seconds, wake_sd_s: Seconds) -> Seconds:
    """Return the seconds before its use at which the alarm of a slowly waking camera goes off."""
    return wake_s + LATE_SIGMAS * wake_sd_s


@dataclass(frozen=True, slots=True, eq=False)
class RestCosts:
    """The power of cameras, and the times of the rests that they may take.

    Attributes:
        look_w: `(num_cameras,)` of looking in every slot, beyond idling.
        idle_w: `(num_cameras,)` awake without a look.
        rest_w: `(num_cameras,)` asleep; `idle_w` of those that do not sleep.
        enter_s: `(num_cameras,)` until they draw that.
        wake_s: `(num_cameras,)` mean, from the alarm to the first frame.
        wake_sd_s: `(num_cameras,)` standard deviation of that.
    """

    look_w: Floats
    idle_w: Floats
    rest_w: Floats
    enter_s: Floats
    wake_s: Floats
    wake_sd_s: Floats

    @property
    def rests(self) -> Flags:
        """`(num_cameras,)` who can sleep at all."""
        return np.asarray(self.rest_w < self.idle_w)

    @property
    def alarm_s(self) -> Floats:
        """`(num_cameras,)` how long before a camera is needed its alarm goes off."""
        return alarm_s(self.wake_s, self.wake_sd_s)

    @property
    def lost_s(self) -> Floats:
        """`(num_cameras,)` of a rest that a camera spends idling: falling asleep and waking."""
        return self.enter_s + self.alarm_s

    def resting_w(self, rest_s: Floats) -> Floats:
        """Return `(num_cameras,)` the mean draw of rests of so many seconds."""
        awake = np.minimum(self.lost_s / np.maximum(rest_s, 1e-9), 1.0)
        return np.asarray(awake * self.idle_w + (1 - awake) * self.rest_w)

    def drawn_w(self, selected: Flags, asleep: Flags) -> Floats:
        """Return `(*batch, num_cameras)` the draw of slots, of the deepest of each that is given.

        Args:
            selected: `(*batch, num_cameras)` who looks.
            asleep: `(*batch, num_cameras)` who draws no more than `rest_w`.
        """
        return np.where(asleep, self.rest_w, self.idle_w + selected * self.look_w)

    def deep(self, asleep: Flags, interval_s: float) -> Flags:
        """Return `(num_slots, num_cameras)` who draws `rest_w`: not falling asleep, not waking.

        Args:
            asleep: `(num_slots, num_cameras)` who is asleep by the plan.
            interval_s: seconds per slot.
        """
        enter = np.ceil(self.enter_s / interval_s - 1e-9).astype(np.int64)
        alarm = np.ceil(self.alarm_s / interval_s - 1e-9).astype(np.int64)
        deep = np.zeros_like(asleep)
        for camera in range(asleep.shape[1]):
            edges = np.diff(np.concatenate([[0], asleep[:, camera].astype(np.int64), [0]]))
            starts, stops = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
            for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
                # A rest that the end of the slots cuts off does not wake in them.
                end = stop if stop == len(asleep) else stop - alarm[camera]
                deep[start + enter[camera] : max(end, start + enter[camera]), camera] = True
        return deep


def rest_costs(
    active_w: Sequence[float], idle_w: Sequence[float], rests: Sequence[Rest | None]
) -> RestCosts:
    """Return the costs of a rig.

    Args:
        active_w: of each camera when it looks.
        idle_w: of each when it does not.
        rests: what each may take; None for those that stay awake.
    """
    awake = np.array(idle_w, dtype=np.float64)
    watts = [np.inf if rest is None else rest.watts for rest in rests]
    return RestCosts(
        look_w=np.array(active_w, dtype=np.float64) - awake,
        idle_w=awake,
        rest_w=np.minimum(watts, awake),
        enter_s=np.array([0.0 if rest is None else rest.enter_s for rest in rests]),
        wake_s=np.array([0.0 if rest is None else rest.wake_s for rest in rests]),
        wake_sd_s=np.array([0.0 if rest is None else rest.wake_sd_s for rest in rests]),
    )
