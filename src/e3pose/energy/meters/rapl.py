"""Intel and AMD energy counters (RAPL): processor and memory only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from e3pose.energy.meters.base import MAX_WATTS, MeterError, Rail, Reading
from e3pose.energy.meters.sysfs import read_number, read_text
from e3pose.energy.profiles import Activity

POWERCAP = Path("sys/class/powercap")
UJ = 1e-6


@dataclass(frozen=True, slots=True)
class Zone:
    """One energy counter.

    Attributes:
        name: such as `package-0`, or `package-0 dram` for a part of it.
        folder: where its files are.
        counted: whether it is part of the total, or contained in a zone that is.
    """

    name: str
    folder: Path
    counted: bool


def find_zones(root: Path) -> list[Zone]:
    """Return the energy counters: packages and their parts, and the platform's if there is one.

    A package contains its cores and graphics; its memory is counted beside it. The platform
    (`psys`) contains all of them. Zones of `intel-rapl-mmio` repeat what others say.
    """
    zones = []
    tops = sorted((root / POWERCAP).glob("intel-rapl:[0-9]*"))
    parents: dict[str, str] = {}
    for folder in tops:
        try:
            name = read_text(folder / "name")
            read_text(folder / "energy_uj")
        except MeterError:
            continue
        number = folder.name.removeprefix("intel-rapl:")
        if ":" not in number:
            parents[number] = name
            zones.append(Zone(name, folder, name.startswith("package")))
        else:
            above = parents.get(number.split(":")[0], "package")
            zones.append(Zone(f"{above} {name}", folder, name == "dram" and above != "psys"))
    if any(zone.name == "psys" for zone in zones):
        zones = [Zone(zone.name, zone.folder, zone.name == "psys") for zone in zones]
    return zones


def counted_j(before_uj: float, now_uj: float, range_uj: float) -> float:
    """Return joules between two readings of a counter that begins again at `range_uj`."""
    passed = now_uj - before_uj
    if passed < 0:
        passed += range_uj
    return passed * UJ


class RaplMeter:
    """Reads energy counters; has to be read at least once in the minute or so they take to wrap."""

    def __init__(self, root: Path, clock_s: Callable[[], float]) -> None:
        """Find the counters below `root`; raise `MeterError` if none can be read."""
        zones = find_zones(root)
        if not any(zone.counted for zone in zones):
            folder = root / POWERCAP
            there = any(folder.glob("intel-rapl:[0-9]*"))
            why = "energy counters that may be read by root only" if there else "no energy counters"
            raise MeterError(f"{folder}: {why}")
        self._zones, self._clock_s = zones, clock_s
        names = [zone.name for zone in zones if zone.counted]
        parts = "the platform" if names == ["psys"] else "processor and memory only"
        self.how = f"measured: RAPL {' + '.join(names)} ({parts})"
        self._range_uj = {
            zone.name: read_number(zone.folder / "max_energy_range_uj") for zone in zones
        }
        self._before_s = clock_s()
        self._before_uj: dict[str, float] | None = self._counters()

    def read(self, mode: Activity) -> Reading:
        """See `Meter.read`; the time since the reading before must not be zero."""
        before_s, before_uj = self._before_s, self._before_uj
        self._before_uj = None  # if they cannot be read now, nobody knows how often they wrap
        now_s, now_uj = self._clock_s(), self._counters()
        self._before_s, self._before_uj = now_s, now_uj
        span_s = now_s - before_s
        if before_uj is None or span_s <= 0:
            raise MeterError("energy counters: nothing to compare with yet")
        rails, energy_j = [], 0.0
        for zone in self._zones:
            spent_j = counted_j(before_uj[zone.name], now_uj[zone.name], self._range_uj[zone.name])
            if not 0 <= spent_j <= MAX_WATTS * span_s:
                raise MeterError(f"{zone.name}: found {spent_j:g} J in {span_s:g} s")
            rails.append(Rail(zone.name, spent_j / span_s, zone.counted))
            energy_j += spent_j if zone.counted else 0.0
        return Reading(energy_j / span_s, energy_j, True, self.how, tuple(rails))

    def _counters(self) -> dict[str, float]:
        return {zone.name: read_number(zone.folder / "energy_uj") for zone in self._zones}
