"""Trees of files laid out as the kernel documents them, in its units.

Every number is another one, so that a rail, a unit or a factor that is mistaken shows.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from e3pose.energy.profiles import load_profile

GENERIC = load_profile("generic")


def lay_out(root: Path, files: Mapping[str, object]) -> Path:
    for name, content in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{content}\n")
    return root


def hwmon(chip: str, **rails: tuple[int, int]) -> dict[str, object]:
    """Return an INA3221 of JetPack 5 and later: label to mV and mA, and what else is there."""
    folder = f"sys/bus/i2c/drivers/ina3221/{chip}/hwmon/hwmon3"
    files: dict[str, object] = {f"{folder}/name": "ina3221"}
    for number, (label, (millivolts, milliamps)) in enumerate(rails.items(), start=1):
        files |= {
            f"{folder}/in{number}_label": label,
            f"{folder}/in{number}_input": millivolts,
            f"{folder}/curr{number}_input": milliamps,
            f"{folder}/in{number}_enable": 1,
            f"{folder}/in{number + 3}_input": 77777,  # voltage over the shunt
        }
    return files | {
        f"{folder}/in7_label": "sum of shunt voltages",
        f"{folder}/in7_input": 99999,
        f"{folder}/curr4_input": 88888,
    }


def iio(chip: str, **rails: int) -> dict[str, object]:
    """Return an INA3221 of JetPack 4: label to mW."""
    folder = f"sys/bus/i2c/drivers/ina3221x/{chip}/iio:device{chip[-1]}"
    files: dict[str, object] = {}
    for number, (label, milliwatts) in enumerate(rails.items()):
        files |= {
            f"{folder}/rail_name_{number}": label,
            f"{folder}/in_power{number}_input": milliwatts,
            f"{folder}/in_voltage{number}_input": 4711,
            f"{folder}/in_current{number}_input": 1234,
        }
    return files


def rapl(**zones: tuple[str, float]) -> dict[str, object]:
    """Return energy counters: zone number to name and uJ."""
    files: dict[str, object] = {}
    for number, (name, energy_uj) in zones.items():
        folder = f"sys/class/powercap/intel-rapl:{number.replace('_', ':')}"
        files |= {
            f"{folder}/name": name,
            f"{folder}/energy_uj": round(energy_uj),
            f"{folder}/max_energy_range_uj": 262_143_328_850,
        }
    return files


def battery(**files: object) -> dict[str, object]:
    folder = "sys/class/power_supply/BAT0"
    tree: dict[str, object] = {f"{folder}/{name}": content for name, content in files.items()}
    return tree | {
        f"{folder}/type": "Battery",
        "sys/class/power_supply/AC/type": "Mains",
        "sys/class/power_supply/AC/online": 0,
        "sys/class/power_supply/mouse/type": "Battery",
        "sys/class/power_supply/mouse/scope": "Device",
        "sys/class/power_supply/mouse/capacity": 3,
        "sys/class/power_supply/ucsi-source/type": "USB",
        "sys/class/power_supply/ucsi-source/current_now": 3_000_000,
    }


XAVIER_NX = hwmon("7-0040", VDD_IN=(5000, 2210), VDD_CPU_GPU_CV=(4980, 1030), VDD_SOC=(4960, 310))

ORIN_NX = hwmon("1-0040", VDD_IN=(4912, 1480), VDD_CPU_GPU_CV=(4912, 520), VDD_SOC=(4904, 270))

AGX_ORIN = hwmon(
    "1-0040", VDD_GPU_SOC=(19952, 160), VDD_CPU_CV=(19944, 80), VIN_SYS_5V0=(5032, 680)
) | hwmon("1-0041", NC=(0, 0), VDDQ_VDD2_1V8AO=(19968, 40))
