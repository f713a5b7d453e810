"""Read one frame of a source, and count those of live ones."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.base.clock import WallClock
from e3pose.base.errors import InputError
from e3pose.base.masking import masked
from e3pose.base.threads import OtherThread
from e3pose.camera.base import AskedSource, LiveSource
from e3pose.camera.frame_rate import rate_hz, rounded_hz
from e3pose.camera.live_source import make_source
from e3pose.camera.orientation import Orientation
from e3pose.camera.sleep import SUSPEND, open_suspend
from e3pose.camera.source import open_video
from e3pose.detectors.timing import DEFAULT_SIZE, Workload, time_detections
from e3pose.settings.camera_file import NodeTable
from e3pose.settings.sources import detects, is_live

COUNT_S = 3.0  # in which the frames of a live source are counted
SETTLE_S = 0.5  # after the first frame: a stream may begin with a burst
FRAME_S = 10.0  # for a device to open and give its first frame
MORE_S = 30.0  # for the rest: a library may never answer
DARK = 8.0  # mean of 0..255 below which a picture shows nothing


@dataclass(frozen=True, slots=True)
class Probe:
    """Properties of a source.

    Attributes:
        source: its name.
        image_size: `(width, height)` in pixels.
        fps: frames per second: counted if it is live, nominal if it was recorded.
        dark: whether the first frame shows nothing.
        nominal_fps: the rate that it announces; None if it is `fps`.
        note: what it gives other than asked for; empty for nothing.
    """

    source: str
    image_size: tuple[int, int]
    fps: float
    dark: bool
    nominal_fps: float | None = None
    note: str = ""

    def doubts(self) -> list[str]:
        """Return warnings about a source, a line each."""
        found = [self.note] if self.note else []
        found += ["its picture is dark; is the lens covered?"] if self.dark else []
        if self.nominal_fps is not None and self.fps < self.nominal_fps:
            found.append(
                f"its source announces {self.nominal_fps:.3g} frames per second and brings "
                f"{self.fps:.3g}: the site gets no more slots per second"
            )
        return found

    def rate_words(self) -> str:
        """Return its rate in words, and that it announces another one if it does."""
        announced = f" ({self.nominal_fps:.3g} announced)" if self.nominal_fps else ""
        return f"{self.fps:.3g} frames per second{announced}"


def probe(
    source: str,
    camera_id: str = "",
    fps: float | None = None,
    timeout_s: float = FRAME_S,
    size: tuple[int, int] | None = None,
) -> Probe:
    """Open a source, read its first frame, count its frames if it is live, and close it.

    Args:
        source: see `camera.live_source`.
        camera_id: of the camera, for recordings of several.
        fps: frames per second to ask for.
        timeout_s: how long to wait for the frame.
        size: `(width, height)` to ask for, pixels.

    Raises:
        InputError: when there is no such source, or no frame comes in time.
    """
    thread, limit_s = OtherThread(), timeout_s + MORE_S
    try:
        return thread.call(partial(_probe, source, camera_id, fps, timeout_s, size), limit_s)
    except TimeoutError:
        found = f"no answer of {masked(source)[:80]} in {limit_s:g} s"
        raise InputError("source", found, "one that films") from None
    finally:
        thread.end()


def _probe(
    source: str,
    camera_id: str,
    fps: float | None,
    timeout_s: float,
    size: tuple[int, int] | None,
) -> Probe:
    if Path(source).is_file():
        video = open_video(Path(source))
        first = next(iter(video.frames()))
        return Probe(source, video.image_size, video.rate, _dark(first.image))
    opened = make_source(source, camera_id, WallClock(), fps, size=size)
    opened.open()
    try:
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            if (frame := opened.read()) is not None:
                dark, nominal_hz = _dark(frame.image()), opened.fps
                counted = _counted_hz(opened) if is_live(source) else None
                fps = rounded_hz(counted, nominal_hz)
                announced = None if fps == nominal_hz else nominal_hz
                note = opened.note if isinstance(opened, AskedSource) else ""
                return Probe(source, frame.image_size, fps, dark, announced, note)
    finally:
        opened.close()
    raise InputError(
        "source", f"no frame of {masked(source)[:80]} in {timeout_s:g} s", "one that films"
    )


def _counted_hz(opened: LiveSource) -> float | None:
    """Return the rate at which an open source brings frames; None if it brings almost none."""
    begin_s, times_ns = time.monotonic() + SETTLE_S, list[int]()
    while time.monotonic() < begin_s + COUNT_S:
        frame = opened.read()
        if frame is not None and time.monotonic() >= begin_s:
            times_ns.append(frame.captured_ns)
    return rate_hz(times_ns)


def probe_all(
    asked: Mapping[str, Callable[[], Probe]], progress: Callable[[int, int], None]
) -> dict[str, Probe | InputError]:
    """Probe all cameras at once; return the findings of each, or why there are none.

    Args:
        asked: by camera, what probes it.
        progress: called with how many are done, and of how many, on this thread.
    """

    def found(ask: Callable[[], Probe]) -> Probe | InputError:
        try:
            return ask()
        except InputError as error:
            return error

    progress(0, len(asked))
    with ThreadPoolExecutor(max(len(asked), 1)) as pool:
        work = {pool.submit(found, ask): name for name, ask in asked.items()}
        results = {}
        for done, future in enumerate(as_completed(work), 1):
            results[work[future]] = future.result()
            progress(done, len(asked))
    return {name: results[name] for name in asked}


def _dark(shown: Any) -> bool:
    return isinstance(shown, np.ndarray) and bool(shown.mean() < DARK)


STATES = Path("/sys/power/state")
RAM = "mem"  # how the kernel calls suspend to RAM


@dataclass(frozen=True, slots=True)
class Machine:
    """The findings on a machine; an `InputError` gives the reason for a missing one.

    Attributes:
        seen: of its source.
        suspend: words of the command that suspends it.
        states: in which the kernel can suspend it; () where it does not say.
        detect_s: seconds that a detection takes; None for a source that needs none.
    """

    seen: Probe | InputError
    suspend: tuple[str, ...] | InputError
    states: tuple[str, ...]
    detect_s: float | InputError | None


def examine(node: NodeTable, states: Path = STATES) -> Machine:
    """Open the source of a camera, run its network, and look whether the machine can sleep.

    Args:
        node: its file.
        states: where the kernel lists in which states it can suspend the machine.
    """
    suspend: tuple[str, ...] | InputError
    try:
        found = open_suspend(node.sleep, node.suspend_command)
        suspend = SUSPEND if found is None else found.command
    except InputError as error:
        suspend = error
    try:
        known = tuple(states.read_text(encoding="utf-8").split())
    except OSError:
        known = ()
    seen: Probe | InputError
    try:
        seen = probe(node.source, node.camera, node.fps, size=node.size)
        size = seen.image_size
    except InputError as error:
        seen, size = error, DEFAULT_SIZE
    return Machine(seen, suspend, known, _detect_s(node, size))


def _detect_s(node: NodeTable, size: tuple[int, int]) -> float | InputError | None:
    if detects(node.source):
        return None
    upright = Orientation.from_degrees(node.rotation).size(*size)
    workload = Workload(node.detector, node.model, node.provider, node.threads, upright)
    try:
        return float(time_detections([workload]).alone_s[0])
    except InputError as error:
        return error
