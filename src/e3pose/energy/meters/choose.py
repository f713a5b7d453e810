"""Choose the best meter of this machine, or the model of its power profile."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from e3pose.energy.meters.base import Meter, MeterError, Rail, Reading
from e3pose.energy.meters.battery import BatteryMeter
from e3pose.energy.meters.rails import RailMeter
from e3pose.energy.meters.rapl import RaplMeter
from e3pose.energy.modes import RESTING
from e3pose.energy.profiles import MODES, Activity, DeviceProfile

ROOT = Path("/")


class ModelMeter:
    """Says what the profile says of the mode; measures nothing."""

    def __init__(self, profile: DeviceProfile, why: str) -> None:
        """Take a profile; `why` is why nothing is measured."""
        self._profile = profile
        self.how = f"modelled: profile {profile.name} ({why})"
        self._watts: dict[Activity, float] = {mode: profile.watts(mode) for mode in MODES}
        rests = {rest.name: rest.watts for rest in profile.rests}
        for mode in RESTING:
            self._watts[mode] = rests.get(mode, self._watts["aggressive-power-saving"])

    def read(self, mode: Activity) -> Reading:
        """See `Meter.read`."""
        rails: tuple[Rail, ...] = ()
        if mode != "asleep" and mode != "suspended":  # which components do not know
            rails = tuple(Rail(c.name, c.watts[mode], True) for c in self._profile.components)
        return Reading(self._watts[mode], None, False, self.how, rails, self._watts)


class FallingBackMeter:
    """Reads a meter, and the model while the meter cannot be read."""

    def __init__(self, meter: Meter, profile: DeviceProfile) -> None:
        """Take the meter and the profile of the device."""
        self._meter, self._profile = meter, profile

    def read(self, mode: Activity) -> Reading:
        """See `Meter.read`; never raises."""
        try:
            return self._meter.read(mode)
        except MeterError as error:
            return ModelMeter(self._profile, str(error)).read(mode)


def choose_meter(
    profile: DeviceProfile,
    root: Path = ROOT,
    capacity_wh: float | None = None,
) -> Meter:
    """Return the first of rails, battery gauge, energy counters that can be read, or the model.

    Rails and the gauge are of the whole device; energy counters are of processor and memory. A
    gauge counts only while the battery is being drained.

    Args:
        profile: what the device is taken to draw where nothing is measured.
        root: above `sys`.
        capacity_wh: of the battery, for gauges that only know a percentage.
    """
    reasons = []
    candidates: tuple[Callable[[], Meter], ...] = (
        lambda: RailMeter(root),
        lambda: BatteryMeter(root, capacity_wh),
        lambda: RaplMeter(root, time.monotonic),
    )
    for make in candidates:
        try:
            meter = make()
            if not isinstance(meter, RaplMeter):  # which was read when it was made
                meter.read("active")
            return FallingBackMeter(meter, profile)
        except MeterError as error:
            reasons.append(str(error))
    return ModelMeter(profile, "; ".join(reasons))
