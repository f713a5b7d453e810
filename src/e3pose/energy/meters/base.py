"""The Protocol of a meter: a power reading, and whether it is measured or modelled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from e3pose.energy.profiles import Activity

MAX_WATTS = 10_000.0  # beyond it is a broken sensor, not a camera


class MeterError(Exception):
    """A meter cannot be read now; the message says why. Callers continue with a model."""


@dataclass(frozen=True, slots=True)
class Rail:
    """One supply inside a device.

    Attributes:
        name: the label that the board gives it.
        watts: what it draws.
        counted: whether it is part of the device's total, or contained in another rail that is.
    """

    name: str
    watts: float
    counted: bool


@dataclass(frozen=True, slots=True)
class Reading:
    """The power of a device at a moment.

    Attributes:
        watts: now, or since the reading before where the meter counts energy.
        energy_j: counted since the reading before; None where the meter only knows watts.
        measured: False where a model says it.
        how: what was measured, or which model and why, for people.
        rails: by supply, as far as known.
        by_mode: watts in each mode, where a model says them; empty where they are measured.
    """

    watts: float
    energy_j: float | None
    measured: bool
    how: str
    rails: tuple[Rail, ...] = ()
    by_mode: Mapping[Activity, float] = field(default_factory=dict)


class Meter(Protocol):
    """Say what the device draws."""

    def read(self, mode: Activity) -> Reading:
        """Return the present power; only a model needs `mode`, the mode of the camera.

        Raises:
            MeterError: when it cannot be read now.
        """
        ...
