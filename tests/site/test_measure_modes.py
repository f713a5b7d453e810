"""What a camera can do, measured with a source and a network whose times are known."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from e3pose.base.errors import InputError
from e3pose.camera.base import LiveFrame
from e3pose.energy.meters.base import Reading
from e3pose.energy.profiles import PROFILES, Activity, load_profile, modes_of, profile_text
from e3pose.model.pose import Poses2D
from e3pose.site import measure_modes as measuring
from e3pose.site.bench import mean_watts
from e3pose.site.measure_modes import measure_modes, measured_profile

OPEN_S, LOOK_S, FRAME_S = 0.05, 0.03, 0.01
WATTS: dict[str, float] = {"active": 9.0, "power-saving": 5.0, "aggressive-power-saving": 2.0}


class Source:
    """Takes a known time to open."""

    fps = 1 / FRAME_S

    def __init__(self, films: bool = True) -> None:
        self.films, self.opened, self.closed = films, 0, 0

    def open(self) -> None:
        self.opened += 1
        time.sleep(OPEN_S)

    def read(self) -> LiveFrame | None:
        time.sleep(FRAME_S)
        image = np.zeros((4, 4, 3), np.uint8)
        return LiveFrame(time.time_ns(), (4, 4), lambda: image) if self.films else None

    def close(self) -> None:
        self.closed += 1


class Network:
    """Takes a known time to look, and works all of it."""

    def detect(self, image: object) -> Poses2D:
        end_s = time.perf_counter() + LOOK_S
        while time.perf_counter() < end_s:
            pass
        return Poses2D.empty(17)


class Meter:
    """Says what every mode draws."""

    def __init__(self, measured: bool) -> None:
        self.measured = measured

    def read(self, mode: Activity) -> Reading:
        return Reading(WATTS[mode], None, self.measured, "a sensor")


def sample(meter: Meter) -> measuring.Sample:
    return lambda step, mode, work: mean_watts(meter, mode, work)


def found(measured: bool) -> measuring.MeasuredModes:
    source = Source()
    result = measure_modes(source, Network(), sample(Meter(measured)), 0.2, 3)
    assert source.opened >= 3 and source.closed >= 4  # the device is free again
    return result


def test_times_are_measured_without_a_sensor_and_watts_stay_the_profiles() -> None:
    result = found(measured=False)
    assert result.watts == {} and len(result.wakes_s) == 3
    assert OPEN_S <= result.wake_s[0] < 20 * OPEN_S and result.look_s >= LOOK_S
    assert result.look_cpu_s > result.frame_cpu_s
    modes = modes_of(measured_profile(load_profile("xavier-nx"), result, "today"))
    idle, closed, whole = modes.rest("idle"), modes.rest("not-capturing"), modes.look("whole")
    assert idle is not None and idle.watts == pytest.approx(6.25)
    assert closed is not None and closed.wake_s == pytest.approx(result.wake_s[0])
    assert "times measured today" in closed.source
    gate = modes.look("gate")
    assert whole is not None and whole.latency_s == result.look_s
    assert gate is not None and gate.latency_s == result.gate_s
    assert 0 < gate.joules < whole.joules and "share of its processor time" in gate.source


def test_sensor_gives_rests_their_watts_and_looks_their_joules() -> None:
    result = found(measured=True)
    watts = {step: (each.mean, each.spread) for step, each in result.watts.items()}
    assert watts == {
        "idle": (5, 0), "looking": (9, 0), "unchanged image": (9, 0), "resting": (2, 0)
    }  # fmt: skip
    modes = modes_of(measured_profile(load_profile("xavier-nx"), result, "today"))
    assert [(rest.name, rest.watts) for rest in modes.rests] == [
        ("idle", 5.0),
        ("not-capturing", 2.0),
        ("asleep", 2.0),
    ]
    whole = modes.look("whole")
    assert whole is not None and whole.joules == pytest.approx(4.0 * result.look_s)
    gate = modes.look("gate")
    assert gate is not None and gate.joules == pytest.approx(4.0 * result.gate_s)
    assert result.gate_s < result.look_s and "a sensor" in gate.source
    assert all("a sensor" in rest.source for rest in modes.rests)


def test_source_that_films_nothing_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measuring, "FIRST_FRAME_S", 0.05)
    with pytest.raises(InputError, match="no frame"):
        measure_modes(Source(films=False), Network(), sample(Meter(True)), 0.1, 1)


@pytest.mark.parametrize(
    "change", [lambda p: p, lambda p: measured_profile(p, found(True), 'a "b"')]
)
def test_written_profile_is_read_as_it_was(tmp_path: Path, change: Callable[..., object]) -> None:
    for name in PROFILES:
        profile = change(load_profile(name))
        file = tmp_path / "board.toml"
        file.write_text(profile_text(profile))  # type: ignore[arg-type]
        assert load_profile(file) == profile
