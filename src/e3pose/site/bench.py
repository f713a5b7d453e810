"""Benchmark a detector on this machine: milliseconds and joules per image."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from e3pose.base.errors import InputError
from e3pose.detectors import is_network, make_detector
from e3pose.energy.meters.base import Meter, MeterError, Reading
from e3pose.energy.profiles import Mode

IDLE_S = 2.0
SAMPLE_S = 0.1
LEAST_DETECTIONS = 3


@dataclass(frozen=True, slots=True)
class Cost:
    """The cost of a detection.

    Attributes:
        name: of the network.
        image_size: `(width, height)` of the images.
        detect_s: seconds per detection, the median.
        first_s: seconds of the first detection, with whatever is built for it.
        energy_j: joules per detection beyond idling; None if nothing was measured.
        how: how energy is known, or why it is not.
        provider: where it ran, as far as the detector tells.
    """

    name: str
    image_size: tuple[int, int]
    detect_s: float
    first_s: float
    energy_j: float | None
    how: str
    provider: str


def measure(
    name: str,
    image_size: tuple[int, int],
    provider: str,
    threads: int | None,
    seconds: float,
    meter: Meter,
) -> Cost:
    """Measure one network at one size of images, alone in this process.

    Args:
        name: of a detector, or a network file.
        image_size: `(width, height)` in pixels.
        provider: where to run it.
        threads: of the processor.
        seconds: for how long.
        meter: of this machine's power.

    Raises:
        InputError: when the network cannot be loaded.
    """
    path = Path(name)
    detector = make_detector(
        str(path.resolve()) if is_network(path) and path.exists() else name, None, provider, threads
    )
    width, height = image_size
    grey = np.random.default_rng(0).integers(0, 256, (height, width, 1), dtype=np.uint8)
    image = np.repeat(grey, 3, axis=2)
    begun_s = time.perf_counter()
    detector.detect(image)
    first_s = time.perf_counter() - begun_s
    idle = mean_watts(meter, "power-saving", lambda: time.sleep(IDLE_S))
    took_s: list[float] = []

    def detect() -> None:
        end_s = time.perf_counter() + seconds
        while len(took_s) < LEAST_DETECTIONS or time.perf_counter() < end_s:
            begun_s = time.perf_counter()
            detector.detect(image)
            took_s.append(time.perf_counter() - begun_s)

    active = mean_watts(meter, "active", detect)
    detect_s = float(np.median(took_s))
    energy_j = max(active.mean - idle.mean, 0.0) * detect_s if active.last.measured else None
    runs_on = getattr(detector, "provider", "")
    return Cost(name, image_size, detect_s, first_s, energy_j, active.last.how, runs_on)


@dataclass(frozen=True, slots=True)
class Watts:
    """The power during some work.

    Attributes:
        mean: of the readings.
        spread: their standard deviation.
        last: of them.
    """

    mean: float
    spread: float
    last: Reading


def mean_watts(
    meter: Meter,
    mode: Mode,
    work: Callable[[], None],
    settle_s: float = 0.0,
    show: Callable[[float], None] = lambda watts: None,
) -> Watts:
    """Return the power during some work.

    Args:
        meter: of the machine's power.
        mode: what the work is.
        work: is called.
        settle_s: seconds at its begin that do not count, as the meter lags.
        show: called with the watts of each reading.

    Raises:
        InputError: when the meter does not answer half of the time.
    """
    begun_s, done = time.monotonic(), threading.Event()
    readings, failures = list[Reading](), list[str]()

    def sample() -> None:
        while not done.wait(SAMPLE_S):
            try:
                reading = meter.read(mode)
            except MeterError as error:
                failures.append(str(error))
                continue
            show(reading.watts)
            if time.monotonic() - begun_s >= settle_s:
                readings.append(reading)

    with suppress(MeterError):
        meter.read(mode)  # what counts energy counts from here
    sampler = threading.Thread(target=sample, name="power", daemon=True)
    sampler.start()
    try:
        work()
    finally:
        done.set()
        sampler.join()
    if failures and len(failures) >= len(readings):
        raise InputError("meter", failures[-1], "one that answers until the end")
    readings = readings or [meter.read(mode)]
    watts = [reading.watts for reading in readings]
    return Watts(float(np.mean(watts)), float(np.std(watts)), readings[-1])
