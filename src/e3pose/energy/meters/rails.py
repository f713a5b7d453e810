"""Power rails of NVIDIA Jetson boards: INA3221 and INA238 sensors.

Layouts, as documented by the kernel and NVIDIA:

* JetPack 5 and later (hwmon): `in{1,2,3}_label`, `in{n}_input` in mV, `curr{n}_input` in mA.
  `in{4,5,6}` are voltages over the shunts and `in7` their sum, in other units: not supplies.
* JetPack 4 (iio): `rail_name_{0,1,2}`, `in_power{n}_input` in mW.
* INA238 (Thor): `power1_input` in uW, of the whole input.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from e3pose.energy.meters.base import MAX_WATTS, MeterError, Rail, Reading
from e3pose.energy.meters.sysfs import number_or_none, read_number, read_text
from e3pose.energy.profiles import Activity

DRIVERS = Path("sys/bus/i2c/drivers")
CHANNELS = 3
NOT_CONNECTED = ("NC", "")
# Where one of these is, it supplies all the others; where none is, the supplies add up.
WHOLE_INPUT = ("VIN", "VDD_IN", "POM_5V_IN")


@dataclass(frozen=True, slots=True)
class Channel:
    """One supply and the files that tell its power.

    Attributes:
        name: the label of the board.
        factors: files whose numbers, multiplied, are the power.
        to_watts: what the product is multiplied with.
    """

    name: str
    factors: tuple[Path, ...]
    to_watts: float

    def watts(self) -> float:
        """Return the power of the supply; raise `MeterError` if it cannot be read."""
        watts = self.to_watts
        for path in self.factors:
            watts *= read_number(path)
        if abs(watts) > MAX_WATTS:
            raise MeterError(f"{self.name}: found {watts:g} W, expected at most {MAX_WATTS:g} W")
        return max(watts, 0.0)  # a supply at rest reads a little below nothing


def total_channels(channels: list[Channel]) -> set[str]:
    """Return the names of the supplies that add up to the device."""
    names = {channel.name for channel in channels}
    for whole in WHOLE_INPUT:
        if whole in names:
            return {whole}
    return names


class RailMeter:
    """Reads the power rails of a board."""

    def __init__(self, root: Path = Path("/")) -> None:
        """Find the rails below `root`; raise `MeterError` if there are none."""
        drivers = root / DRIVERS
        channels = []  # the supplies that a board's sensors name, whatever buses and numbers
        for folder in sorted(drivers.glob("ina238/*-*/hwmon/hwmon*")):
            if (folder / "power1_input").exists():
                channels.append(Channel("VIN", (folder / "power1_input",), 1e-6))  # uW
        for driver in ("ina3221", "ina3221x"):
            for folder in sorted(drivers.glob(f"{driver}/*-*/hwmon/hwmon*")):
                channels += _hwmon(folder)
            for folder in sorted(drivers.glob(f"{driver}/*-*/iio:device*")):
                channels += _iio(folder)
        self._channels = channels
        if not self._channels:
            raise MeterError(f"{root / DRIVERS}: no INA3221 or INA238 with labelled supplies")
        self._counted = total_channels(self._channels)
        names = [c.name for c in self._channels if c.name in self._counted]
        self.how = f"measured: {' + '.join(names)}"

    def read(self, mode: Activity) -> Reading:
        """See `Meter.read`."""
        rails = []
        for channel in self._channels:
            counted = channel.name in self._counted
            try:
                rails.append(Rail(channel.name, channel.watts(), counted))
            except MeterError:
                if counted:  # a sum without one of its parts would be a lie
                    raise
        total = sum(rail.watts for rail in rails if rail.counted)
        return Reading(total, None, True, self.how, tuple(rails))


def _hwmon(folder: Path) -> list[Channel]:
    channels = []
    for number in range(1, CHANNELS + 1):
        label = _label(folder / f"in{number}_label")
        if label is None or number_or_none(folder / f"in{number}_enable") == 0:
            continue
        files = (folder / f"in{number}_input", folder / f"curr{number}_input")
        channels.append(Channel(label, files, 1e-6))  # mV * mA = uW
    return channels


def _iio(folder: Path) -> list[Channel]:
    channels = []
    for number in range(CHANNELS):
        label = _label(folder / f"rail_name_{number}")
        if label is not None:
            file = folder / f"in_power{number}_input"
            channels.append(Channel(label, (file,), 1e-3))  # mW
    return channels


def _label(path: Path) -> str | None:
    try:
        label = read_text(path)
    except MeterError:
        return None
    printable = "".join(char for char in label if char.isprintable())[:60]
    return None if printable.upper() in NOT_CONNECTED else printable
