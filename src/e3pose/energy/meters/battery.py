"""Battery gauge: remaining charge, charging power, discharge."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from e3pose.energy.meters.base import MAX_WATTS, MeterError, Rail, Reading
from e3pose.energy.meters.sysfs import number_or_none, read_text
from e3pose.energy.profiles import Activity

SUPPLIES = Path("sys/class/power_supply")
J_PER_UWH = 3600e-6
MICRO = 1e-6


@dataclass(frozen=True, slots=True)
class Charge:
    """A battery, or all of a device together.

    Attributes:
        energy_j: what is left.
        full_j: what it holds when full; None where the gauge does not say.
        charging_w: power that goes in.
        draining_w: power that comes out, None where unknown.
        status: `charging`, `discharging`, `full`, `not charging` or `unknown`.
    """

    energy_j: float
    full_j: float | None
    charging_w: float
    draining_w: float | None
    status: str

    @property
    def share(self) -> float | None:
        """Charge in [0, 1]."""
        return None if not self.full_j else min(max(self.energy_j / self.full_j, 0.0), 1.0)


def find_batteries(root: Path) -> list[Path]:
    """Return the folders of batteries that supply the device, not its mouse or its USB ports."""
    found = []
    for folder in sorted((root / SUPPLIES).glob("*")):
        try:
            kind = read_text(folder / "type")
        except MeterError:
            continue
        if kind == "Battery" and _word(folder / "scope") != "device":
            found.append(folder)
    return found


def read_charge(root: Path, capacity_wh: float | None = None) -> Charge:
    """Return the charge of the batteries.

    Args:
        root: above `sys`.
        capacity_wh: what they hold, for gauges that only know a percentage.

    Raises:
        MeterError: when there is none, or its gauge does not say enough.
    """
    batteries = find_batteries(root)
    if not batteries:
        raise MeterError(f"{root / SUPPLIES}: no battery")
    charges = [_charge(folder, capacity_wh) for folder in batteries]
    full = [charge.full_j for charge in charges]
    draining = [charge.draining_w for charge in charges if charge.status == "discharging"]
    known = [watts for watts in draining if watts is not None]
    states = {charge.status for charge in charges}
    status = next((s for s in ("charging", "discharging") if s in states), charges[0].status)
    return Charge(
        energy_j=sum(charge.energy_j for charge in charges),
        full_j=None if None in full else sum(value for value in full if value is not None),
        charging_w=sum(charge.charging_w for charge in charges),
        draining_w=sum(known) if draining and len(known) == len(draining) else None,
        status=status,
    )


class BatteryMeter:
    """Measures the device by the discharge of its battery, while it is not charging."""

    how = "measured: battery gauge"

    def __init__(self, root: Path = Path("/"), capacity_wh: float | None = None) -> None:
        """Find the battery below `root`; raise `MeterError` if there is none."""
        self._root, self._capacity_wh = root, capacity_wh
        read_charge(root, capacity_wh)

    def read(self, mode: Activity) -> Reading:
        """See `Meter.read`."""
        charge = read_charge(self._root, self._capacity_wh)
        if charge.status != "discharging":
            raise MeterError(
                f"battery {charge.status}: its gauge does not show what the device draws"
            )
        if charge.draining_w is None:
            raise MeterError("battery: its gauge shows no power and no current")
        rail = Rail("battery", charge.draining_w, True)
        return Reading(charge.draining_w, None, True, self.how, (rail,))


def _charge(folder: Path, capacity_wh: float | None) -> Charge:
    volts = number_or_none(folder / "voltage_now")
    # Charge in Ah becomes energy at the voltage of an average, where the battery names one.
    mean_volts = number_or_none(folder / "voltage_min_design") or volts
    energy = number_or_none(folder / "energy_now")
    full = number_or_none(folder / "energy_full")
    percent = number_or_none(folder / "capacity")
    if energy is not None:
        energy_j, full_j = energy * J_PER_UWH, None if full is None else full * J_PER_UWH
    elif (ah := number_or_none(folder / "charge_now")) is not None and mean_volts:
        factor = J_PER_UWH * mean_volts * MICRO  # uAh * V = uWh
        full = number_or_none(folder / "charge_full")
        energy_j, full_j = ah * factor, None if full is None else full * factor
    elif percent is not None and capacity_wh is not None:
        full_j = capacity_wh * 3600
        energy_j = full_j * percent / 100
    else:
        raise MeterError(
            f"{folder}: no energy_now, no charge_now with a voltage, and no capacity in percent "
            "with a known battery"
        )
    limit_j = 3600.0 * 1e6
    if not 0 <= energy_j <= limit_j:
        raise MeterError(f"{folder}: found {energy_j:g} J, expected 0 to {limit_j:g}")
    status = _word(folder / "status") or "unknown"
    watts = _watts(folder, volts)
    return Charge(
        energy_j=energy_j,
        full_j=full_j,
        charging_w=watts if status == "charging" and watts is not None else 0.0,
        draining_w=watts if status == "discharging" else None,
        status=status,
    )


def _watts(folder: Path, volts: float | None) -> float | None:
    power = number_or_none(folder / "power_now")
    current = number_or_none(folder / "current_now")
    if power is not None:
        watts = abs(power) * MICRO
    elif current is not None and volts is not None:
        # Some drivers count a current out of the battery negative: the status says which it is.
        watts = abs(current) * MICRO * volts * MICRO
    else:
        return None
    return watts if watts <= MAX_WATTS else None


def _word(path: Path) -> str:
    try:
        return read_text(path).lower()[:40]
    except MeterError:
        return ""
