"""Temperature of a device, from the kernel's sensors."""

from __future__ import annotations

from pathlib import Path

from e3pose.energy.meters.sysfs import number_or_none

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
