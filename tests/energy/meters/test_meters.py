"""Meters of every kind, smart plugs among them: what each says, and what is no meter."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from tests.cli.commands import refused, run
from tests.energy.meters.trees import AGX_ORIN, GENERIC, ORIN_NX, XAVIER_NX, battery, lay_out, rapl
from tests.manual_clock import ManualClock

from e3pose.base.errors import InputError
from e3pose.energy.activity import ModeClock
from e3pose.energy.meters import plug
from e3pose.energy.meters.base import Meter, MeterError, Reading
from e3pose.energy.meters.battery import BatteryMeter, read_charge
from e3pose.energy.meters.choose import choose_meter
from e3pose.energy.meters.plug import open_plug
from e3pose.energy.meters.rails import RailMeter
from e3pose.energy.meters.rapl import RaplMeter
from e3pose.energy.meters.sampler import PowerSampler, open_sampler


def test_energy_counters_of_packages_and_their_memory(tmp_path: Path) -> None:
    now_s = [100.0]
    zones = {"0": ("package-0", 5e6), "0_0": ("core", 3e6), "0_1": ("dram", 1e6)}
    lay_out(tmp_path, rapl(**zones))
    lay_out(
        tmp_path,
        {
            "sys/class/powercap/intel-rapl-mmio:0/name": "package-0",
            "sys/class/powercap/intel-rapl-mmio:0/energy_uj": 5_000_000,
        },
    )
    meter = RaplMeter(tmp_path, lambda: now_s[0])
    now_s[0] += 2.0
    after = {"0": ("package-0", 35e6), "0_0": ("core", 15e6), "0_1": ("dram", 5e6)}
    lay_out(tmp_path, rapl(**after))
    reading = meter.read("active")
    assert reading.energy_j == pytest.approx(30 + 4), "a package and its memory, not its cores"
    assert reading.watts == pytest.approx(17.0)
    watts = {rail.name: rail.watts for rail in reading.rails}
    assert watts == pytest.approx({"package-0": 15.0, "package-0 core": 6.0, "package-0 dram": 2.0})
    assert "processor and memory only" in reading.how


def test_platform_counter_contains_the_others(tmp_path: Path) -> None:
    now_s = [0.0]
    tree = {"0": ("package-0", 0.0), "0_0": ("dram", 0.0), "1": ("psys", 0.0)}
    lay_out(tmp_path, rapl(**tree))
    meter = RaplMeter(tmp_path, lambda: now_s[0])
    now_s[0] = 1.0
    lay_out(tmp_path, rapl(**{"0": ("package-0", 7e6), "0_0": ("dram", 2e6), "1": ("psys", 13e6)}))
    reading = meter.read("active")
    assert reading.energy_j == pytest.approx(13.0)
    assert "RAPL psys (the platform)" in reading.how


def test_counter_is_believed_up_to_ten_kilowatts_and_goes_on_where_it_wraps(tmp_path: Path) -> None:
    now_s = [0.0]
    lay_out(tmp_path, rapl(**{"0": ("package-0", 262_140_000_000)}))
    meter = RaplMeter(tmp_path, lambda: now_s[0])
    now_s[0] += 4.0
    lay_out(tmp_path, rapl(**{"0": ("package-0", 6_671_150)}))
    assert meter.read("active").energy_j == pytest.approx(10.0)
    now_s[0] += 4.0
    lay_out(tmp_path, rapl(**{"0": ("package-0", 36e9 + 6_671_150)}))
    assert meter.read("active").watts == pytest.approx(9000)
    now_s[0] += 4.0
    lay_out(tmp_path, rapl(**{"0": ("package-0", 80e9 + 6_671_150)}))
    with pytest.raises(MeterError, match="package-0: found 44000 J in 4 s"):
        meter.read("active")


def test_counters_that_were_away_are_begun_again(tmp_path: Path) -> None:
    now_s = [0.0]
    lay_out(tmp_path, rapl(**{"0": ("package-0", 1e6)}))
    meter = RaplMeter(tmp_path, lambda: now_s[0])
    file = tmp_path / "sys/class/powercap/intel-rapl:0/energy_uj"
    for content, energy_j in (("gone", None), ("900000000", None), ("903000000", 3.0)):
        now_s[0] += 1.0
        file.write_text(content)
        if energy_j is None:
            with pytest.raises(MeterError):
                meter.read("active")
        else:
            assert meter.read("active").energy_j == pytest.approx(energy_j)


def test_gauge_in_watt_hours(tmp_path: Path) -> None:
    tree = battery(
        status="Discharging",
        energy_now=31_000_000,  # uWh
        energy_full=50_000_000,
        power_now=8_250_000,  # uW
        capacity=62,
        voltage_now=11_400_000,
    )
    charge = read_charge(lay_out(tmp_path, tree))
    assert charge.energy_j == pytest.approx(31.0 * 3600)
    assert charge.full_j == pytest.approx(50.0 * 3600)
    assert charge.share == pytest.approx(0.62)
    assert (charge.status, charge.charging_w) == ("discharging", 0.0)
    reading = BatteryMeter(tmp_path).read("active")
    assert reading.watts == pytest.approx(8.25)
    assert reading.measured


def test_gauge_in_ampere_hours(tmp_path: Path) -> None:
    tree = battery(
        status="Discharging",
        charge_now=2_500_000,  # uAh
        charge_full=4_000_000,
        current_now=-900_000,  # uA, out of the battery
        voltage_now=12_300_000,  # uV
        voltage_min_design=11_100_000,
    )
    charge = read_charge(lay_out(tmp_path, tree))
    assert charge.energy_j == pytest.approx(2.5 * 11.1 * 3600)
    assert charge.full_j == pytest.approx(4.0 * 11.1 * 3600)
    assert charge.draining_w == pytest.approx(0.9 * 12.3)


def test_charging_battery_says_what_goes_in_and_not_what_is_drawn(tmp_path: Path) -> None:
    tree = battery(status="Charging", energy_now=20_000_000, power_now=15_500_000)
    charge = read_charge(lay_out(tmp_path, tree))
    assert charge.charging_w == pytest.approx(15.5)
    assert charge.share is None
    with pytest.raises(MeterError, match="charging"):
        BatteryMeter(tmp_path).read("active")
    reading = choose_meter(GENERIC, tmp_path).read("active")
    assert not reading.measured
    assert "battery charging" in reading.how


def test_gauge_of_a_percentage_needs_to_know_the_battery(tmp_path: Path) -> None:
    lay_out(tmp_path, battery(status="Discharging", capacity=80))
    with pytest.raises(MeterError, match="known battery"):
        read_charge(tmp_path)
    charge = read_charge(tmp_path, capacity_wh=40.0)
    assert charge.energy_j == pytest.approx(0.8 * 40 * 3600)
    assert charge.share == pytest.approx(0.8)


def test_two_batteries_add_up(tmp_path: Path) -> None:
    tree = battery(
        status="Discharging", energy_now=10_000_000, energy_full=20_000_000, power_now=3_000_000
    )
    other = {k.replace("BAT0", "BAT1"): v for k, v in tree.items() if "BAT0" in k}
    other["sys/class/power_supply/BAT1/power_now"] = 4_000_000
    charge = read_charge(lay_out(tmp_path, tree | other))
    assert charge.energy_j == pytest.approx(20 * 3600)
    assert charge.draining_w == pytest.approx(7.0)
    (tmp_path / "sys/class/power_supply/BAT1/power_now").unlink()
    assert read_charge(tmp_path).draining_w is None, "half of what is drawn is not all of it"


def test_rails_are_preferred_to_gauge_and_counters(tmp_path: Path) -> None:
    gauge = battery(status="Discharging", energy_now=31_000_000, power_now=8_250_000)
    counters = rapl(**{"0": ("package-0", 0.0)})
    lay_out(tmp_path, counters)
    assert "RAPL" in getattr(choose_meter(GENERIC, tmp_path), "_meter").how  # noqa: B009
    lay_out(tmp_path, gauge | battery(status="Charging"))  # which says nothing of what is drawn
    assert "RAPL" in getattr(choose_meter(GENERIC, tmp_path), "_meter").how  # noqa: B009
    lay_out(tmp_path, gauge)
    assert choose_meter(GENERIC, tmp_path).read("active").how == "measured: battery gauge"
    lay_out(tmp_path, ORIN_NX)
    assert choose_meter(GENERIC, tmp_path).read("active").how == "measured: VDD_IN"


def test_nothing_to_measure_is_modelled_by_mode(tmp_path: Path) -> None:
    meter = choose_meter(GENERIC, tmp_path)
    for mode in ("active", "power-saving", "aggressive-power-saving"):
        reading = meter.read(mode)
        assert not reading.measured
        assert reading.watts == pytest.approx(GENERIC.watts(mode))
        assert reading.watts == pytest.approx(sum(r.watts for r in reading.rails if r.counted))
        assert all(word in reading.how for word in ("INA3221", "no battery", "counters"))


def test_sampler_adds_up_watts_and_states_what_is_measured(tmp_path: Path) -> None:
    lay_out(tmp_path, XAVIER_NX)
    lay_out(tmp_path, battery(status="Charging", energy_now=20_000_000, power_now=2_500_000))
    current = tmp_path / "sys/bus/i2c/drivers/ina3221/7-0040/hwmon/hwmon3/curr1_input"
    clock = ManualClock()
    meter: Meter = choose_meter(GENERIC, tmp_path)
    sampler = PowerSampler(meter, ModeClock(clock.now_ns), tmp_path)
    sampler.sample()
    for milliamps in (2000, 2000, 1000):  # 10, 10, 5 W
        clock.advance(2.0)
        current.write_text(str(milliamps))
        sampler.sample()
    fields = sampler()
    expected_j = 2 * (11.05 + 10) / 2 + 2 * 10 + 2 * (10 + 5) / 2
    assert fields["energy_j"] == pytest.approx(expected_j)
    assert fields["power_w"] == pytest.approx(5.0)
    assert fields["measured"] is True
    assert fields["battery_j"] == pytest.approx(72_000)
    assert fields["charging_w"] == pytest.approx(2.5)
    clock.advance(1.0)
    current.unlink()
    assert sampler()["measured"] is False
    clock.advance(1.0)
    current.write_text("1000")
    assert sampler()["measured"] is True, "of the time since it was asked"
    clock.advance(3600.0)  # the machine slept
    assert sampler()["energy_j"] < expected_j + 30


class Looking:
    """A meter that says what a test wants."""

    watts = 8.0

    def read(self, mode: object) -> Reading:
        return Reading(self.watts, None, True, "measured: a test")


def test_watts_of_heartbeats_which_fall_between_looks_are_not_added_up(tmp_path: Path) -> None:
    clock, meter = ManualClock(), Looking()
    sampler = PowerSampler(meter, ModeClock(clock.now_ns), tmp_path)
    sampler.sample()
    for _ in range(10):
        clock.advance(0.1)
        sampler.sample()
        clock.advance(0.1)
        meter.watts = 3.0
        assert sampler()["measured"]
        meter.watts = 8.0
    assert sampler()["energy_j"] == pytest.approx(8.0 * 2)


def test_meter_that_fails_for_hours_counts_nothing_and_goes_on(tmp_path: Path) -> None:
    lay_out(tmp_path, XAVIER_NX)  # alone, without a model to stand in for it
    current = tmp_path / "sys/bus/i2c/drivers/ina3221/7-0040/hwmon/hwmon3/curr1_input"
    clock = ManualClock()
    sampler = PowerSampler(RailMeter(tmp_path), ModeClock(clock.now_ns), tmp_path)

    def found_j(seconds: float, milliamps: int | None) -> float:
        if milliamps is None:
            current.unlink(missing_ok=True)
        else:
            current.write_text(str(milliamps))
        clock.advance(seconds)
        fields = sampler()
        assert fields["measured"] is (milliamps is not None)
        return float(fields["energy_j"])

    before_j = found_j(1.0, 1000)
    before_j, spent_j = found_j(1.0, 1000), found_j(1.0, 1000) - before_j
    assert spent_j == pytest.approx(2 * 5.0)
    for _ in range(200):
        assert found_j(60.0, None) == pytest.approx(before_j + 5.0)
    assert found_j(1.0, 1000) - before_j < 15.1, "hours without a reading are not made up"


def test_only_known_meters_are_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = ManualClock()
    modes = ModeClock(clock.now_ns)
    with pytest.raises(InputError, match=r"meter: found 'watt', expected auto or model"):
        open_sampler(GENERIC, modes, "watt")
    monkeypatch.setattr("e3pose.energy.meters.sampler.choose_meter", lambda *_, **__: Looking())
    for how, watts in (("auto", 8.0), ("model", GENERIC.watts("power-saving"))):
        sampler = open_sampler(GENERIC, modes, how)
        sampler.sample()
        clock.advance(1.0)
        fields = sampler()
        assert fields["power_w"] == pytest.approx(watts) and fields["measured"] is (how == "auto")


def test_what_runs_beside_the_modes_is_added_to_models_alone(tmp_path: Path) -> None:
    clock, extra_j = ManualClock(), [0.0]
    for measured in (False, True):
        if measured:
            lay_out(tmp_path, XAVIER_NX)
        meter: Meter = choose_meter(GENERIC, tmp_path)
        sampler = PowerSampler(meter, ModeClock(clock.now_ns), tmp_path)
        sampler.extra_j = lambda: extra_j[0]
        before_j = float(sampler()["energy_j"])
        clock.advance(1.0)
        extra_j[0] += 100.0
        fields = sampler()
        assert fields["measured"] is measured
        assert (float(fields["energy_j"]) - before_j > 100.0) is not measured


def test_sampler_thread_adds_up_by_itself(tmp_path: Path) -> None:
    modes = ModeClock(time.monotonic_ns)
    with PowerSampler(choose_meter(GENERIC, tmp_path), modes, tmp_path) as sampler:
        begin_s = time.monotonic()
        while (energy_j := sampler.sample().energy_j) < 2.0:
            assert time.monotonic() - begin_s < 60
            time.sleep(0.05)
        assert energy_j < GENERIC.watts("active") * (time.monotonic() - begin_s + 0.1)


def test_command_prints_rails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lay_out(tmp_path, AGX_ORIN)
    assert run("power", "--root", str(tmp_path), "--seconds", "0.1") == 0
    out = capsys.readouterr().out
    assert "VDD_GPU_SOC" in out
    assert "9.008" in out
    assert "measured" in out
    assert run("power", "--root", str(tmp_path), "--seconds", "0.1", "--json", "-") == 0
    content = json.loads(capsys.readouterr().out)
    assert content["reading"]["watts"] == pytest.approx(9.00832)
    assert content["charge"] is None


def test_command_says_when_it_is_modelled(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("power", "--root", str(tmp_path), "--seconds", "0.1", "--profile", "tx2") == 0
    assert "modelled: profile tx2" in capsys.readouterr().out
    for options in (["--seconds", "0"], ["--profile", "toaster"], ["--root", "/nowhere"]):
        refused(capsys, "power", *options)


ANSWERS: dict[str, object] = {}


@pytest.fixture
def host() -> Iterator[str]:
    class Plug(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            found = ANSWERS.get(self.path)
            self.send_response(404 if found is None else 200)
            self.end_headers()
            self.wfile.write(found if isinstance(found, bytes) else json.dumps(found).encode())

        def log_message(self, format: str, *args: object) -> None: ...

    server = HTTPServer(("127.0.0.1", 0), Plug)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    ANSWERS.clear()
    yield f"127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()
    thread.join()


# As the makers document them: Shelly of the second and of the first generation, Tasmota.
GEN2 = {"id": 0, "output": True, "apower": 5.3, "voltage": 230.1, "aenergy": {"total": 12.5}}
GEN1 = {"power": 4.25, "is_valid": True, "total": 1234}
TASMOTA = {"StatusSNS": {"Time": "2026-11-29T12:00:00", "ENERGY": {"Total": 0.1, "Power": 6}}}


@pytest.mark.parametrize(
    ("kind", "path", "answer", "watts"),
    [
        ("shelly", "/rpc/Switch.GetStatus?id=0", GEN2, 5.3),
        ("shelly", "/meter/0", GEN1, 4.25),
        ("tasmota", "/cm?cmnd=Status%208", TASMOTA, 6.0),
    ],
)
def test_a_plug_says_watts(
    kind: str, path: str, answer: object, watts: float, host: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ANSWERS[path] = answer
    meter = open_plug(f"{kind}:{host}")
    reading = meter.read("active")
    assert reading.watts == watts and reading.measured and kind in reading.how
    ANSWERS.clear()
    assert meter.read("active").watts == watts, "it is asked twice a second at most"
    monkeypatch.setattr(plug, "FRESH_S", -1.0)
    with pytest.raises(MeterError, match=f"{kind} plug {host}: "):
        meter.read("active")


@pytest.mark.parametrize(
    "answer", [{}, {"apower": None}, {"apower": -4}, {"apower": 1e9}, [], b"<html>", b"", b"NaN"]
)
def test_what_is_no_meter_is_refused(answer: object, host: str) -> None:
    ANSWERS["/rpc/Switch.GetStatus?id=0"] = answer
    with pytest.raises(InputError, match="expected a plug with a meter"):
        open_plug(f"shelly:{host}")


@pytest.mark.parametrize("name", ["shelly", "shelly:", "um25c:1", "shelly:a/b", "tasmota:me@x"])
def test_other_names_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="expected shelly:HOST or tasmota:HOST"):
        open_plug(name)
