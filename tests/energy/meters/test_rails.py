"""Power rails and temperatures of boards, against trees of files as the kernel lays them out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest
from tests.cases import each_case
from tests.energy.meters.trees import AGX_ORIN, GENERIC, ORIN_NX, XAVIER_NX, hwmon, iio, lay_out

from e3pose.energy.meters.choose import choose_meter
from e3pose.energy.meters.rails import RailMeter
from e3pose.energy.meters.sampler import read_temperature_c

TX2 = iio("0-0040", VDD_SYS_GPU=152, VDD_SYS_SOC=457, VDD_4V0_WIFI=19) | iio(
    "0-0041", VDD_IN=3431, VDD_SYS_CPU=533, VDD_SYS_DDR=681
)

NANO = iio("6-0040", POM_5V_IN=1854, POM_5V_GPU=41, POM_5V_CPU=287)

THOR = hwmon("2-0040", VDD_GPU=(19800, 900), VDD_CPU_SOC_MSS=(19800, 700)) | {
    "sys/bus/i2c/drivers/ina238/2-0044/hwmon/hwmon5/power1_input": 43_210_000,  # uW
    "sys/bus/i2c/drivers/ina238/2-0044/hwmon/hwmon5/in1_input": 19900,
    "sys/bus/i2c/drivers/ina238/2-0044/hwmon/hwmon5/curr1_input": 2171,
}


@each_case(
    ("tree", "device_w", "rails_w"),
    [
        (XAVIER_NX, 11.05, {"VDD_IN": 11.05, "VDD_CPU_GPU_CV": 5.1294, "VDD_SOC": 1.5376}),
        (ORIN_NX, 7.26976, {"VDD_IN": 7.26976, "VDD_CPU_GPU_CV": 2.55424, "VDD_SOC": 1.32408}),
        (
            AGX_ORIN,
            3.19232 + 1.59552 + 3.42176 + 0.79872,
            {
                "VDD_GPU_SOC": 3.19232,
                "VDD_CPU_CV": 1.59552,
                "VIN_SYS_5V0": 3.42176,
                "VDDQ_VDD2_1V8AO": 0.79872,
            },
        ),
        (
            TX2,
            3.431,
            {
                "VDD_SYS_GPU": 0.152,
                "VDD_SYS_SOC": 0.457,
                "VDD_4V0_WIFI": 0.019,
                "VDD_IN": 3.431,
                "VDD_SYS_CPU": 0.533,
                "VDD_SYS_DDR": 0.681,
            },
        ),
        (NANO, 1.854, {"POM_5V_IN": 1.854, "POM_5V_GPU": 0.041, "POM_5V_CPU": 0.287}),
        (THOR, 43.21, {"VIN": 43.21, "VDD_GPU": 17.82, "VDD_CPU_SOC_MSS": 13.86}),
    ],
    ids=["xavier-nx", "orin-nx", "agx-orin", "tx2", "nano", "thor"],
)
def test_rails_of_boards(
    tmp_path: Path, tree: Mapping[str, object], device_w: float, rails_w: dict[str, float]
) -> None:
    reading = RailMeter(lay_out(tmp_path, tree)).read("active")
    assert reading.measured
    assert reading.energy_j is None
    assert reading.watts == pytest.approx(device_w)
    assert {rail.name: rail.watts for rail in reading.rails} == pytest.approx(rails_w)
    assert sum(rail.watts for rail in reading.rails if rail.counted) == pytest.approx(device_w)


def test_rails_are_found_by_label_wherever_they_are(tmp_path: Path) -> None:
    """The same supplies on other buses, other device numbers, other channels."""
    tree = iio("3-0045", VDD_SYS_CPU=533, VDD_IN=3431, VDD_SYS_DDR=681)
    reading = RailMeter(lay_out(tmp_path, tree)).read("active")
    assert reading.watts == pytest.approx(3.431)
    assert reading.how == "measured: VDD_IN"


def test_disabled_and_unconnected_channels_are_left_out(tmp_path: Path) -> None:
    tree = hwmon("1-0040", VDD_GPU_SOC=(20000, 100), NC=(20000, 500), VDD_CPU_CV=(20000, 7000))
    lay_out(tmp_path, tree)
    (tmp_path / "sys/bus/i2c/drivers/ina3221/1-0040/hwmon/hwmon3/in3_enable").write_text("0")
    reading = RailMeter(tmp_path).read("active")
    assert [rail.name for rail in reading.rails] == ["VDD_GPU_SOC"]
    assert reading.watts == pytest.approx(2.0)


@each_case("content", ["nan", "inf", "", "N/A", "9" * 40])
def test_total_that_cannot_be_read_is_modelled_and_says_why(tmp_path: Path, content: str) -> None:
    lay_out(tmp_path, XAVIER_NX)
    meter = choose_meter(GENERIC, tmp_path)
    assert meter.read("active").measured
    file = tmp_path / "sys/bus/i2c/drivers/ina3221/7-0040/hwmon/hwmon3/curr1_input"
    file.write_text(content)
    reading = meter.read("power-saving")
    assert not reading.measured
    assert reading.watts == pytest.approx(GENERIC.watts("power-saving"))
    assert reading.how.startswith("modelled: profile generic (")
    assert "curr1_input" in reading.how or "VDD_IN" in reading.how
    file.unlink()
    assert "no such file" in meter.read("active").how
    file.write_text("1000")
    assert meter.read("active").watts == pytest.approx(5.0), "measured again by itself"


def test_part_that_cannot_be_read_is_left_out(tmp_path: Path) -> None:
    lay_out(tmp_path, TX2)
    (tmp_path / "sys/bus/i2c/drivers/ina3221x/0-0040/iio:device0/in_power0_input").unlink()
    reading = RailMeter(tmp_path).read("active")
    assert reading.watts == pytest.approx(3.431)
    assert "VDD_SYS_GPU" not in {rail.name for rail in reading.rails}


def zone(root: Path, number: int, text: str) -> None:
    folder = root / "sys" / "class" / "thermal" / f"thermal_zone{number}"
    folder.mkdir(parents=True)
    (folder / "temp").write_text(text)


def test_hottest_zone_counts_and_what_makes_no_sense_does_not(tmp_path: Path) -> None:
    assert read_temperature_c(tmp_path) is None
    for number, text in enumerate(
        ("45500\n", "-256000\n", "no number\n", "61000\n", "2147483647\n")
    ):
        zone(tmp_path, number, text)
    assert read_temperature_c(tmp_path) == 61.0
