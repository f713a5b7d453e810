"""Measure the looks and rests of this machine's camera, for its power profile."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from e3pose.base.errors import InputError
from e3pose.camera.base import LiveDetector, LiveFrame, LiveSource
from e3pose.camera.gate import Gate
from e3pose.energy.modes import SLOT_S, Look, Rest
from e3pose.energy.profiles import MODES, DeviceProfile, Mode, modes_of
from e3pose.site.bench import Watts

FIRST_FRAME_S = 30.0  # a source that takes longer to its first frame is broken
REOPEN_S = 5.0
LEAST_LOOKS = 3
STEPS = IDLE, LOOKING, GATED, RESTING = "idle", "looking", "unchanged image", "resting"

# Takes a step, what the camera does in it, and the work; returns the power during it.
Sample = Callable[[str, Mode, Callable[[], None]], Watts]


@dataclass(frozen=True, slots=True)
class MeasuredModes:
    """Measurements of a camera.

    Attributes:
        look_s: seconds of one look at the whole image, median.
        look_cpu_s: processor time of one.
        gate_s: seconds of one look of the motion gate at an unchanged image, mean.
        gate_cpu_s: processor time of one.
        frame_cpu_s: processor time of capturing a frame.
        wakes_s: seconds from opening the source to its first frame, each time.
        watts: by step; empty without a sensor.
        how: how watts are known, or why they are not.
    """

    look_s: float
    look_cpu_s: float
    gate_s: float
    gate_cpu_s: float
    frame_cpu_s: float
    wakes_s: tuple[float, ...]
    watts: Mapping[str, Watts]
    how: str

    @property
    def wake_s(self) -> tuple[float, float]:
        """Mean and standard deviation of `wakes_s`."""
        spread_s = statistics.stdev(self.wakes_s) if len(self.wakes_s) > 1 else 0.0
        return statistics.fmean(self.wakes_s), spread_s


def measure_modes(
    source: LiveSource, detector: LiveDetector, sample: Sample, seconds: float, wakes: int
) -> MeasuredModes:
    """Measure a camera; no other program may use it at the same time.

    Args:
        source: its frames; closed afterwards.
        detector: its network, loaded and tried.
        sample: takes the power during a step.
        seconds: for each of looking, looking through the gate, capturing and resting.
        wakes: how often the source is opened.

    Raises:
        InputError: when the source cannot be opened or gives no frame, or the watts cannot be.
    """
    wakes_s = []
    for _ in range(wakes):
        source.close()
        begun_s = time.perf_counter()
        source.open()
        _next_frame(source)
        wakes_s.append(time.perf_counter() - begun_s)
    looks_s, frames, frame_cpu_s, look_cpu_s = list[float](), 0, 0.0, 0.0
    gates, gates_s, gates_cpu_s = 0, 0.0, 0.0

    def capture() -> None:
        nonlocal frames, frame_cpu_s
        begun_s, end_s = time.process_time(), time.perf_counter() + seconds
        while time.perf_counter() < end_s:
            frames += source.read() is not None
        frame_cpu_s = time.process_time() - begun_s

    def look() -> None:
        nonlocal look_cpu_s
        end_s = time.perf_counter() + seconds
        while len(looks_s) < LEAST_LOOKS or time.perf_counter() < end_s:
            image = _next_frame(source).image()
            begun_s, cpu_s = time.perf_counter(), time.process_time()
            detector.detect(image)
            looks_s.append(time.perf_counter() - begun_s)
            look_cpu_s += time.process_time() - cpu_s

    def gate() -> None:
        nonlocal gates, gates_s, gates_cpu_s
        image = _next_frame(source).image()
        closed = Gate(detector, on=True)
        closed.look(image, None, 1)
        begun_s, cpu_s = time.perf_counter(), time.process_time()
        while gates < LEAST_LOOKS or gates_s < seconds:
            gates += closed.look(image, None, 2).unchanged_s > 0
            gates_s = time.perf_counter() - begun_s
        gates_cpu_s = time.process_time() - cpu_s

    watts = {IDLE: sample(IDLE, "power-saving", capture)}
    watts[LOOKING] = sample(LOOKING, "active", look)
    how, measured = watts[IDLE].last.how, watts[IDLE].last.measured
    if measured:
        _check_watts(watts[IDLE], watts[LOOKING])
    watts[GATED] = sample(GATED, "active", gate)
    source.close()
    resting: Mode = "aggressive-power-saving"
    watts[RESTING] = sample(RESTING, resting, lambda: time.sleep(seconds))
    return MeasuredModes(
        look_s=statistics.median(looks_s),
        look_cpu_s=look_cpu_s / len(looks_s),
        gate_s=gates_s / gates,
        gate_cpu_s=gates_cpu_s / gates,
        frame_cpu_s=frame_cpu_s / max(frames, 1),
        wakes_s=tuple(wakes_s),
        watts=watts if measured else {},
        how=how,
    )


def _check_watts(idle: Watts, looking: Watts) -> None:
    """Raise `InputError` for watts that cannot be those of this machine."""
    if idle.mean <= 0:
        found = f"{idle.mean:.2f} W when idle"
        raise InputError("meter", found, "more than 0 W: this computer has to draw from the meter")
    if looking.mean <= idle.mean:
        raise InputError(
            "meter",
            f"{looking.mean:.2f} +- {looking.spread:.2f} W when looking, no more than when idle "
            f"({idle.mean:.2f} +- {idle.spread:.2f} W)",
            "more: this computer alone has to draw from the meter, with nothing else at work",
        )


def _next_frame(source: LiveSource) -> LiveFrame:
    """Return the next frame of an open source; a film that runs away is opened again."""
    begun_s = opened_s = time.perf_counter()
    while (frame := source.read()) is None:
        now_s = time.perf_counter()
        if now_s - begun_s > FIRST_FRAME_S:
            raise InputError("source", f"no frame in {FIRST_FRAME_S:g} s", "a source that films")
        if now_s - opened_s > REOPEN_S:
            source.close()
            source.open()
            opened_s = now_s
    return frame


def measured_profile(base: DeviceProfile, found: MeasuredModes, when: str) -> DeviceProfile:
    """Return a profile with the measured rows, completed from `base`.

    Args:
        base: what the device is taken to draw where nothing is measured.
        found: what was measured.
        when: and on what, for the source of each row.
    """
    modes = modes_of(base)
    wake_s, sd_s = found.wake_s
    rests = {rest.name: rest for rest in modes.rests}
    looks = {look.name: look for look in modes.looks if look.name != "nothing"}
    whole = looks["whole"]
    by_profile = f"watts of profile {base.name}, times measured {when}"
    in_ms = f"{1000 * SLOT_S:g} ms"
    for name in ("not-capturing", "asleep"):
        if name in rests:
            rests[name] = replace(rests[name], wake_s=wake_s, wake_sd_s=sd_s, source=by_profile)
    looks["whole"] = replace(
        whole, latency_s=found.look_s, source=f"joules of profile {base.name} for {in_ms}, {when}"
    )
    gate_share = min(found.gate_cpu_s / max(found.look_cpu_s, 1e-9), 1.0)
    by_look = f"joules of a whole look by the share of its processor time, {when}"
    looks["gate"] = Look("gate", gate_share * whole.joules, found.gate_s, by_look)
    if found.watts:
        idle_w, active_w, gate_w, off_w = (found.watts[step].mean for step in STEPS)
        how = f"measured {when}: {found.how}"
        off_w = min(off_w, idle_w)
        base = _shared_out(base, (active_w, idle_w, off_w), how)
        rests["idle"] = Rest("idle", idle_w, source=how)
        rests["not-capturing"] = Rest("not-capturing", off_w, 0.0, wake_s, sd_s, how)
        rests["asleep"] = Rest("asleep", off_w, 0.0, wake_s, sd_s, how)
        look_j = max(active_w - idle_w, 0.0) * found.look_s
        looks["whole"] = Look("whole", look_j, found.look_s, how)
        gate_j = max(gate_w - idle_w, 0.0) * found.gate_s
        looks["gate"] = Look("gate", gate_j, found.gate_s, how)
        if "suspended" in rests and rests["suspended"].watts > off_w:
            del rests["suspended"]  # of another device
    return replace(
        base,
        name=f"{base.name}-measured"[:100],
        title=f"{base.title}; rows measured {when}",
        rests=tuple(rests.values()),
        looks=tuple(looks.values()),
    )


def _shared_out(
    base: DeviceProfile, device_w: tuple[float, float, float], how: str
) -> DeviceProfile:
    """Return a profile whose components share the measured power in proportion."""
    parts = []
    for part in base.components:
        shares = {m: part.watts[m] / base.watts(m) if base.watts(m) else 0.0 for m in MODES}
        watts = {m: shares[m] * whole for m, whole in zip(MODES, device_w, strict=True)}
        source = f"its share in profile {base.name} of what was {how}"
        parts.append(replace(part, watts=watts, sources=dict.fromkeys(MODES, source)))
    return replace(base, components=tuple(parts))
