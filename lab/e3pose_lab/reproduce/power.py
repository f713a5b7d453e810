"""Camera power from duty cycles, by the profiles of the paper's two devices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from e3pose.energy.profiles import PAPER_GROUPS, DeviceProfile, Mode, load_profile
from e3pose_lab.reproduce.replays import Run

XAVIER, TX2 = "xavier-nx", "tx2"
DEVICES = {XAVIER: "Xavier NX", TX2: "TX2"}
MIXED = (XAVIER, XAVIER, TX2, TX2, TX2)  # the paper's testbed
# What the paper saves with 3 of 5 cameras, percent of CPU, GPU, WiFi and memory.
PAPER_SAVING = {XAVIER: (20.66, 31.21), TX2: (17.72, 28.67)}
WAKE_S = 0.5  # a camera needs it from aggressive power-saving to its first frame


def profiles(names: Sequence[str] = MIXED) -> list[DeviceProfile]:
    """Return the power profiles of a testbed."""
    return [load_profile(name) for name in names]


def compared_watts(profile: DeviceProfile, duty: float, idle: Mode = "power-saving") -> float:
    """Return the mean power of what the paper compares: CPU, GPU, WiFi, memory."""
    active, saving = profile.paper_watts("active"), profile.paper_watts(idle)
    return duty * active + (1 - duty) * saving


def group_watts(profile: DeviceProfile, duty: float) -> dict[str, float]:
    """Return the mean power of each component that the paper compares."""
    return {
        part.name: duty * part.watts["active"] + (1 - duty) * part.watts["power-saving"]
        for part in profile.components
        if part.group in PAPER_GROUPS
    }


def saving_percent(profile: DeviceProfile, duty: float) -> float:
    """Return the percent of power that a camera saves against one that is always active."""
    return 100 * (1 - compared_watts(profile, duty) / compared_watts(profile, 1.0))


def asleep(run: Run, interval_s: float, wake_s: float = WAKE_S) -> float:
    """Return the share of the idle slots in which a camera can stop capturing.

    A camera that sleeps must wake `wake_s` before its next slot, and it knows of that slot in time.

    Args:
        run: whose times without work are measured.
        interval_s: of a slot.
        wake_s: from sleep to the first frame.
    """
    wake = wake_s / interval_s
    lengths = np.array([length for camera in run.idle for length in camera], dtype=np.float64)
    idle = lengths.sum()
    return float(np.maximum(lengths - wake, 0.0).sum() / idle) if idle else 0.0


def sleeps(run: Run, interval_s: float, wake_s: float = WAKE_S) -> tuple[int, int]:
    """Return how many of the times without work are long enough to sleep in, and how many all."""
    lengths = [length for camera in run.idle for length in camera]
    return sum(length * interval_s > wake_s for length in lengths), len(lengths)
