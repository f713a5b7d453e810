"""Benchmark a detector on this machine: milliseconds and joules per image."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from e3pose.detectors import is_network, make_detector
from e3pose.energy.meters.base import Meter, Reading
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
    idle_w, _ = mean_watts(meter, "power-saving", lambda: time.sleep(IDLE_S))
    took_s: list[float] = []

    def detect() -> None:
        end_s = time.perf_counter() + seconds
        while len(took_s) < LEAST_DETECTIONS or time.perf_counter() < end_s:
            begun_s = time.perf_counter()
            detector.detect(image)
            took_s.append(time.perf_counter() - begun_s)

    active_w, reading = mean_watts(meter, "active", detect)
    detect_s = float(np.median(took_s))
    energy_j = max(active_w - idle_w, 0.0) * detect_s if reading.measured else None
    runs_on = getattr(detector, "provider", "")
    return Cost(name, image_size, detect_s, first_s, energy_j, reading.how, runs_on)


def mean_watts(meter: Meter, mode: Mode, work: Callable[[], None]) -> tuple[float, Reading]:
    """Return the mean power during some work, and its last reading."""
    meter.read(mode)  # what counts energy counts from here
    done, readings = threading.Event(), list[Reading]()

    def sample() -> None:
        while not done.wait(SAMPLE_S):
            readings.append(meter.read(mode))

    sampler = threading.Thread(target=sample, name="power", daemon=True)
    sampler.start()
    work()
    done.set()
    sampler.join()
    readings = readings or [meter.read(mode)]
    return float(np.mean([reading.watts for reading in readings])), readings[-1]
