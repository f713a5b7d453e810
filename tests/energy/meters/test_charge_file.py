"""A battery without a gauge is not full again because a program was started again."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from tests.cases import each_case
from tests.manual_clock import ManualClock

from e3pose.base.errors import InputError
from e3pose.energy.activity import ModeClock
from e3pose.energy.meters.base import Rail, Reading
from e3pose.energy.meters.charge_file import ChargeFile, load_charge, save_charge
from e3pose.energy.meters.sampler import PowerSampler
from e3pose.energy.profiles import Activity

WH = 3600.0


class Steady:
    """Draws 10 W."""

    def read(self, mode: Activity) -> Reading:
        return Reading(10.0, None, False, "modelled", (Rail("all", 10.0, True),))


CAMERA_FILE = """format = "e3pose-camera"
version = 1
site = "lab"
camera = "cam0"
source = "usb:0"
battery_wh = 1.0
"""


def written(**other: object) -> str:
    """Return the content of a file that is good but for what is given."""
    good = {"format": "e3pose-battery", "version": 1, "camera": "cam0"}
    return json.dumps({**good, "battery_wh": 1.0, "left_j": 1.0, **other})


def camera_at_work(path: Path | None, seconds: float, folder: Path) -> tuple[float, list[str]]:
    """Run a camera's sampler; return the joules left by its last heartbeat, and its messages."""
    clock, messages = ManualClock(), list[str]()
    charge = ChargeFile(path, "cam0", 1.0, messages.append)
    sampler = PowerSampler(
        Steady(), ModeClock(clock.now_ns), folder, capacity_wh=1.0, charge_file=charge
    )
    with sampler:
        sampler.sample()
        for _ in range(round(seconds)):
            clock.advance(1.0)
            sampler.sample()
        fields = sampler()
    assert fields["gauge"] is False
    return fields["battery_j"], messages


def test_restart_goes_on_with_what_was_left(tmp_path: Path) -> None:
    path = tmp_path / "cam0.battery.json"
    for run in (1, 2, 3):
        left_j, messages = camera_at_work(path, 60, tmp_path)
        assert left_j == pytest.approx(WH - run * 600, abs=1.0)
        assert not messages
    assert load_charge(path, "cam0", 1.0) == pytest.approx(WH - 1800, abs=1.0)


def test_empty_stays_empty_and_is_never_less(tmp_path: Path) -> None:
    path = tmp_path / "cam0.battery.json"
    for _ in range(2):
        assert camera_at_work(path, 400, tmp_path)[0] == 0.0


def test_without_a_file_nothing_is_remembered(tmp_path: Path) -> None:
    for _ in range(2):
        assert camera_at_work(None, 60, tmp_path)[0] == pytest.approx(WH - 600)
    assert not list(tmp_path.iterdir())


def test_gauge_is_believed_and_nothing_written(tmp_path: Path) -> None:
    folder = tmp_path / "sys/class/power_supply/BAT0"
    folder.mkdir(parents=True)
    for name, content in (("type", "Battery"), ("status", "Full"), ("energy_now", "500000")):
        (folder / name).write_text(content)
    path = tmp_path / "cam0.battery.json"
    charge = ChargeFile(path, "cam0", 1.0, lambda line: None)
    modes = ModeClock(ManualClock().now_ns)
    with PowerSampler(Steady(), modes, tmp_path, capacity_wh=1.0, charge_file=charge) as sampler:
        fields = sampler()
    assert (fields["gauge"], fields["battery_j"]) == (True, pytest.approx(WH / 2))
    assert not path.exists()


def test_deleted_file_is_a_battery_that_was_charged(tmp_path: Path) -> None:
    path, messages = tmp_path / "cam0.battery.json", list[str]()
    charge = ChargeFile(path, "cam0", 1.0, messages.append)
    charge.spend(3000)
    charge.keep()
    path.unlink()
    charge.keep()
    assert charge.left_j == WH == load_charge(path, "cam0", 1.0)
    assert len(messages) == 1 and "assuming a full battery" in messages[0]


def test_another_battery_begins_full(tmp_path: Path) -> None:
    path = tmp_path / "cam0.battery.json"
    save_charge(path, "cam0", 1.0, 5.0)
    assert load_charge(path, "cam0", 2.0) is None
    assert ChargeFile(path, "cam0", 2.0, pytest.fail).left_j == 2 * WH


@each_case(
    "content",
    [
        "", "[]", "{}", "nonsense", "9" * 4000, "[" * 4000, b"\xff".decode("latin1"),
        written(camera="cam1"),
        written(version=2),
        written(left_j=-1),
        written(left_j=4e9),
        written(left_j=math.nan),
        written(battery_wh={}),
        written(left_j=None),
        "x" * 5000,
    ],
)  # fmt: skip
def test_damaged_file_is_reported_and_the_battery_taken_to_be_full(
    content: str, tmp_path: Path
) -> None:
    path, messages = tmp_path / "cam0.battery.json", list[str]()
    path.write_text(content)
    with pytest.raises(InputError, match=r"expected (format .*|cam0|0 to 3600|at most .*)$"):
        load_charge(path, "cam0", 1.0)
    charge = ChargeFile(path, "cam0", 1.0, messages.append)
    assert charge.left_j == WH and len(messages) == 1 and "assuming a full battery" in messages[0]
    charge.keep()
    assert json.loads(path.read_text())["left_j"] == WH


def test_place_that_cannot_be_written_is_reported_once(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    messages: list[str] = []
    charge = ChargeFile(tmp_path / "file" / "b.json", "cam0", 1.0, messages.append)
    for _ in range(3):
        charge.keep()
    assert len(messages) == 1 and "cannot save the battery charge" in messages[0]


def test_place_is_beside_the_camera_file_unless_it_says_where(tmp_path: Path) -> None:
    from e3pose.settings.camera_file import NodeTable, load_node
    from e3pose.site.camera_program import open_charge_file

    node = NodeTable("e3pose-camera", 1, "lab", "cam0", "usb:0", battery_wh=1.0)
    config, messages = tmp_path / "cam0.toml", list[str]()
    for state, place in ((None, "cam0.battery.json"), ("b.json", "b.json"), ("", None)):
        config.write_text(CAMERA_FILE + ("" if state is None else f'state = "{state}"\n'))
        charge = open_charge_file(load_node(config), messages.append)
        assert charge is not None
        charge.keep()
        config.unlink()
        assert [p.name for p in tmp_path.iterdir()] == ([] if place is None else [place])
        for file in tmp_path.iterdir():
            file.unlink()
    assert not messages
    charge = open_charge_file(node, messages.append)
    assert charge is not None and charge.left_j == WH and "--state" in messages[0]
    mains = NodeTable("e3pose-camera", 1, "lab", "cam0", "usb:0")
    assert open_charge_file(replace(mains, path=config), messages.append) is None
