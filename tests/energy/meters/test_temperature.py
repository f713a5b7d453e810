"""The temperature of a device, read from a tree like the kernel's."""

from __future__ import annotations

from pathlib import Path

from e3pose.energy.meters.sampler import read_temperature_c


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
