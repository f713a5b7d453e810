"""What a camera finds on its own machine: source, network, and whether it can be suspended."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.camera.orientation import Orientation
from e3pose.camera.probe import Probe, probe
from e3pose.camera.sleep import SUSPEND, open_suspend
from e3pose.detectors.timing import DEFAULT_SIZE, Workload, time_detections
from e3pose.settings.camera_file import NodeTable
from e3pose.settings.sources import is_recorded

STATES = Path("/sys/power/state")
RAM = "mem"  # how the kernel calls suspend to RAM


@dataclass(frozen=True, slots=True)
class Machine:
    """What was found; an `InputError` says why something is not there.

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
        seen = probe(node.source, node.camera, node.fps)
        size = seen.image_size
    except InputError as error:
        seen, size = error, DEFAULT_SIZE
    return Machine(seen, suspend, known, _detect_s(node, size))


def _detect_s(node: NodeTable, size: tuple[int, int]) -> float | InputError | None:
    if is_recorded(node.source):
        return None
    upright = Orientation.from_degrees(node.rotation).size(*size)
    workload = Workload(node.detector, node.model, node.provider, node.threads, upright)
    try:
        return float(time_detections([workload]).alone_s[0])
    except InputError as error:
        return error
