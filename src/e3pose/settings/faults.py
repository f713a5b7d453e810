"""Faults injected into a replay: camera failures, lost views, empty batteries."""

from __future__ import annotations

from dataclasses import dataclass

EACH = "each"  # of the repetitions loses another camera


@dataclass(frozen=True, slots=True)
class Kill:
    """A camera that goes for good.

    Attributes:
        camera_id: which; `each` for that at the position `phase` of the rig.
        time_s: from when on it is gone, seconds.
        slot: the same as a slot, if it was given so.
    """

    camera_id: str
    time_s: float = 0.0
    slot: int | None = None


@dataclass(frozen=True, slots=True)
class Faults:
    """Injected faults.

    Attributes:
        kills: cameras that die.
        loss: share of the selected views that never arrive, [0, 1]; their energy is spent.
        watts: what each camera draws when active, and when not; with them, the cameras for which
            the recording has a battery are gone once it is empty.
    """

    kills: tuple[Kill, ...] = ()
    loss: float = 0.0
    watts: tuple[tuple[float, ...], tuple[float, ...]] | None = None


NO_FAULTS = Faults()
