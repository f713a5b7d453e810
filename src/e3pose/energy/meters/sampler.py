"""Sample a meter on a thread and integrate energy for heartbeats."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from e3pose.base.errors import InputError
from e3pose.energy.activity import ModeClock, ModeTimes
from e3pose.energy.meters.base import Meter, MeterError, Reading
from e3pose.energy.meters.battery import Charge, read_charge
from e3pose.energy.meters.charge_file import ChargeFile
from e3pose.energy.meters.choose import ModelMeter, choose_meter
from e3pose.energy.meters.sysfs import number_or_none
from e3pose.energy.modes import RESTING
from e3pose.energy.profiles import Activity, DeviceProfile

PLAUSIBLE_C = (-40.0, 150.0)  # unconnected zones show 0 K or the largest number there is


def read_temperature_c(root: Path = Path("/")) -> float | None:
    """Return the temperature of the hottest thermal zone in degrees Celsius; None without one.

    Args:
        root: above `sys`.
    """
    zones = (root / "sys" / "class" / "thermal").glob("thermal_zone*/temp")
    found = [number_or_none(zone) for zone in sorted(zones)]
    celsius = [value / 1000 for value in found if value is not None]  # the kernel's millidegrees
    low, high = PLAUSIBLE_C
    return max((value for value in celsius if low < value < high), default=None)


PERIOD_S = 0.1  # on average: readings at equal distances would meet every slot at the same place
CHARGE_PERIOD_S = 2.0  # gauges say something new every few seconds
KEEP_S = 60.0  # at most so much of what was drawn is forgotten when the program is killed
MAX_GAP_S = 5.0  # a longer one is a machine that slept, and drew nothing that we know of


@dataclass(frozen=True, slots=True)
class Total:
    """Energy so far.

    Attributes:
        energy_j: since the start.
        span_s: time that it covers.
        watts: of the newest reading.
        measured: whether all of it since the last heartbeat was measured.
        how: of the newest reading.
        times: of the newest reading: the time, and that in each mode; None before the first.
    """

    energy_j: float = 0.0
    span_s: float = 0.0
    watts: float = 0.0
    measured: bool = True
    how: str = ""
    times: ModeTimes | None = None


def add_reading(total: Total, reading: Reading, times: ModeTimes) -> Total:
    """Add the energy drawn since the reading before.

    That is what a meter counted, what a model says of the time in each mode, or the mean of the
    watts at both ends.
    """
    before = times if total.times is None else total.times
    gap_s = (times.at_ns - before.at_ns) / 1e9
    gap_s = gap_s if 0 < gap_s <= MAX_GAP_S else 0.0
    if reading.energy_j is not None:
        spent_j = reading.energy_j if gap_s else 0.0
    elif reading.by_mode:
        passed_s = times.seconds_since(before)
        spent_j = sum(reading.by_mode[mode] * passed_s[mode] for mode in passed_s)
    else:
        spent_j = 0.5 * (total.watts + reading.watts) * gap_s
    return Total(
        energy_j=total.energy_j + spent_j,
        span_s=total.span_s + gap_s,
        watts=reading.watts,
        measured=total.measured and reading.measured,
        how=reading.how,
        times=times,
    )


def _told_watts(before: Total, now: Total) -> float:
    """Return the power to tell: of a model, the mean since `before`, unless it sleeps from now on.

    What a model says of the moment of a heartbeat is that between two slots.
    """
    if now.measured or before.times is None or now.times is None or now.times.mode in RESTING:
        return now.watts
    gap_s = (now.times.at_ns - before.times.at_ns) / 1e9
    return (now.energy_j - before.energy_j) / gap_s if gap_s > 0 else now.watts


class PowerSampler:
    """Adds up what the device draws. Call it for the fields of a heartbeat on time and power.

    Attributes:
        extra_j: joules so far beside the modes, such as of recording video; not modelled.
    """

    def __init__(
        self,
        meter: Meter,
        modes: ModeClock,
        root: Path = Path("/"),
        capacity_wh: float | None = None,
        charge_file: ChargeFile | None = None,
    ) -> None:
        """Take a meter that never fails, such as that of `choose_meter`; starts with `with`.

        Args:
            meter: what is read.
            modes: what the camera does, and the time.
            root: above `sys`, for the battery.
            capacity_wh: of the battery, for gauges that only know a percentage; where there is no
                gauge it is taken to lose what is drawn.
            charge_file: what is in a battery without a gauge; full at the start by default.
        """
        if charge_file is None and capacity_wh is not None:
            charge_file = ChargeFile(None, "", capacity_wh, lambda line: None)
        self._charge_file, self._modes = charge_file, modes
        self._keep_s = modes.times().at_ns / 1e9
        self.extra_j: Callable[[], float] = lambda: 0.0
        self._extra_j = 0.0
        self._meter, self._root, self._capacity_wh = meter, root, capacity_wh
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._total = self._told = Total()
        self._charge: Charge | None = None
        self._temperature_c: float | None = None
        self._charge_s = -CHARGE_PERIOD_S
        self._thread = threading.Thread(target=self._work, name="power", daemon=True)

    def __enter__(self) -> PowerSampler:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(2.0)
        self._keep()

    def sample(self) -> Total:
        """Read the meter once and add it up."""
        with self._lock:
            return self._sample()

    def _sample(self, between_slots: bool = False) -> Total:
        times = self._modes.times()
        try:
            reading = self._meter.read(times.mode)
        except MeterError:  # a meter without a model behind it
            self._total = replace(self._total, times=times, measured=False)
            return self._total
        counts = reading.energy_j is not None or bool(reading.by_mode)
        if between_slots and self._total.how and not counts:  # watts of no look: none to add up
            reading = replace(reading, watts=self._total.watts)
        before_j, self._total = self._total.energy_j, add_reading(self._total, reading, times)
        extra_j = self.extra_j()
        if not reading.measured:
            spent_j = self._total.energy_j + extra_j - self._extra_j
            self._total = replace(self._total, energy_j=spent_j)
        self._extra_j = extra_j
        if self._charge_file is not None:
            self._charge_file.spend(self._total.energy_j - before_j)
        if times.at_ns / 1e9 - self._charge_s >= CHARGE_PERIOD_S:
            self._charge_s = times.at_ns / 1e9
            self._temperature_c = read_temperature_c(self._root)
            try:
                self._charge = read_charge(self._root, self._capacity_wh)
            except MeterError:
                self._charge = None
        return self._total

    def __call__(self, _mode: Activity | None = None) -> dict[str, Any]:
        """Return the fields of a heartbeat on time and power, all of one moment.

        These are `mode`, `active_s`, `idle_s`, `asleep_s`, `power_w`, `energy_j`, `measured`,
        `battery_j`, `charging_w`, `gauge` and `temperature_c`. `measured` is of the time since it
        was asked for the last time.
        """
        with self._lock:
            before, total = self._told, self._sample(between_slots=True)
            self._told = total
            charge = None if self._charge is None else self._charge.energy_j
            charging_w = 0.0 if self._charge is None else self._charge.charging_w
            self._total = replace(self._total, measured=True)
            gauge = charge is not None
            if charge is None and self._charge_file is not None:
                charge = self._charge_file.left_j
        return {
            **(total.times or self._modes.times()).fields(),
            "power_w": _told_watts(before, total),
            "energy_j": total.energy_j,
            "measured": total.measured and bool(total.how),
            "battery_j": charge,
            "charging_w": charging_w,
            "gauge": gauge,
            "temperature_c": self._temperature_c,
        }

    def _work(self) -> None:
        while not self._stop.wait(PERIOD_S * random.uniform(0.5, 1.5)):
            self.sample()
            if self._modes.times().at_ns / 1e9 - self._keep_s >= KEEP_S:
                self._keep()

    def _keep(self) -> None:
        self._keep_s = self._modes.times().at_ns / 1e9
        if self._charge_file is not None and self._charge is None:
            self._charge_file.keep()


def open_sampler(
    profile: DeviceProfile,
    modes: ModeClock,
    how: str = "auto",
    capacity_wh: float | None = None,
    charge_file: ChargeFile | None = None,
) -> PowerSampler:
    """Return the sampler of a camera's power, for its heartbeats, to be used with `with`.

    Args:
        profile: what the camera is taken to draw where nothing is measured.
        modes: what the camera does, and the time.
        how: `auto` measures what can be, `model` nothing.
        capacity_wh: of the battery, for gauges that only know a percentage.
        charge_file: what is in a battery without a gauge; full at the start by default.

    Raises:
        InputError: for another `how`.
    """
    if how not in ("auto", "model"):
        raise InputError("meter", repr(how[:40]), "auto or model")
    meter: Meter = (
        choose_meter(profile, capacity_wh=capacity_wh)
        if how == "auto"
        else ModelMeter(profile, "as asked for")
    )
    return PowerSampler(meter, modes, capacity_wh=capacity_wh, charge_file=charge_file)
