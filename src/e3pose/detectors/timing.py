"""Latency of networks on this machine, alone and all at once, in processes of their own."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import _ConnectionBase as Connection  # Windows has its own
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.detectors import make_detector

MEASURE_S = 1.5  # of detecting, each of the two times
LEAST_DETECTIONS = 3
LOAD_S = 300.0  # TensorRT builds its engine the first time
DEFAULT_SIZE = (1280, 720)


@dataclass(frozen=True, slots=True)
class Workload:
    """A process that detects people in images, as a camera does.

    Attributes:
        detector: its name, or a network file.
        model: a network file in place of the cached one.
        provider: where it runs.
        threads: of the processor; None for all cores.
        image_size: `(width, height)` in pixels of its images.
    """

    detector: str
    model: Path | None = None
    provider: str = "auto"
    threads: int | None = None
    image_size: tuple[int, int] = DEFAULT_SIZE

    @property
    def aspect(self) -> float:
        """Width by height of its images, which says how many pixels a network makes of them."""
        return self.image_size[0] / self.image_size[1]


@dataclass(frozen=True, slots=True, eq=False)
class DetectionTimes:
    """Durations of detections.

    Attributes:
        alone_s: `(num_workloads,)` seconds per detection, one process at a time; the median.
        together_s: `(num_workloads,)` seconds per detection, all processes at once; the median.
        aspects: of the images, see `Workload`; empty for times that nobody keeps.
    """

    alone_s: NDArray[np.float64]
    together_s: NDArray[np.float64]
    aspects: tuple[float, ...] = ()

    @property
    def rate(self) -> float:
        """Detections per second of all processes together."""
        return float((1 / self.together_s).sum())

    def reach_fps(self, num_selected: float) -> float:
        """Return how many slots per second are possible with so many active cameras.

        A camera that is selected slot after slot must finish before the next one, and all active
        cameras share the machine.
        """
        selected = max(min(num_selected, len(self.together_s)), 1e-3)
        return float(min(self.rate / selected, (1 / self.alone_s).min()))


def time_detections(workloads: Sequence[Workload], seconds: float = MEASURE_S) -> DetectionTimes:
    """Measure how long detections take, each in its own process.

    Images of grey noise stand in for frames: the work of a network does not depend on its input.

    Args:
        workloads: the processes.
        seconds: duration of each of the two measurements.

    Raises:
        InputError: when a network cannot be loaded.
    """
    with _at_work(workloads) as pipes:
        alone: dict[Workload, float] = {}
        for workload, pipe in zip(workloads, pipes, strict=True):
            if workload not in alone:
                alone[workload] = _measured([pipe], seconds)[0]
        same = len(workloads) == 1
        together = list(alone.values()) if same else _measured(pipes, seconds)
    aspects = tuple(each.aspect for each in workloads)
    return DetectionTimes(np.array([alone[w] for w in workloads]), np.array(together), aspects)


def _measured(pipes: Sequence[Connection], seconds: float) -> list[float]:
    for pipe in pipes:
        pipe.send(seconds)
    return [float(_answer(pipe, LOAD_S)) for pipe in pipes]


@contextmanager
def _at_work(workloads: Sequence[Workload]) -> Iterator[Sequence[Connection]]:
    """Yield a pipe to each process, whose network is loaded and tried."""
    context = multiprocessing.get_context("spawn")  # threads of ours would not survive a fork
    processes, pipes = [], []
    try:
        for workload in workloads:
            ours, theirs = context.Pipe()
            process = context.Process(target=_detect, args=(theirs, workload), daemon=True)
            process.start()
            theirs.close()  # so that the end of the process ends the pipe
            processes.append(process)
            pipes.append(ours)
        for pipe in pipes:
            _answer(pipe, LOAD_S)
        yield pipes
    finally:
        for pipe in pipes:
            pipe.close()
        for process in processes:
            process.join(timeout=5.0)
            process.kill()


def _answer(pipe: Connection, timeout_s: float) -> float:
    try:
        answer = pipe.recv() if pipe.poll(timeout_s) else "no answer"
    except (EOFError, OSError):
        answer = "its process ended"
    if isinstance(answer, str):
        raise InputError(f"detector: {answer}")
    return float(answer)


def _detect(pipe: Connection, workload: Workload) -> None:
    """Load a network, then detect for the seconds received, until the pipe ends."""
    width, height = workload.image_size
    grey = np.random.default_rng(0).integers(0, 256, (height, width, 1), dtype=np.uint8)
    image = np.repeat(grey, 3, axis=2)
    try:
        detector = make_detector(
            workload.detector, workload.model, workload.provider, workload.threads
        )
        begun_s = time.perf_counter()
        detector.detect(image)  # the first detection is slow
        pipe.send(time.perf_counter() - begun_s)
    except (InputError, ImportError) as error:
        pipe.send(str(error))
        return
    while True:
        try:
            seconds = float(pipe.recv())
        except (EOFError, OSError):
            return
        took_s: list[float] = []
        end_s = time.perf_counter() + seconds
        while len(took_s) < LEAST_DETECTIONS or time.perf_counter() < end_s:
            begun_s = time.perf_counter()
            detector.detect(image)
            took_s.append(time.perf_counter() - begun_s)
        pipe.send(float(np.median(took_s)))
