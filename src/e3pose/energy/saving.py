"""The two savings that pages, tables, files and messages state, and their words. Pure functions.

*Whole camera* and *processor time*, defined in `docs/explanation/energy.md`: what cameras spent
against what all of them would have spent had they been active in every slot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from e3pose.base.arrays import Flags, Floats

Basis = Literal["measured", "modelled"]
WHOLE_CAMERA, PROCESSOR_TIME = "whole camera", "processor time"
AGAINST = "Saved, compared with all cameras active in every slot"
LEAST = 5  # looks and frames from which the time of one is known
MOST_ASLEEP = 0.999  # of the time; of one that slept longer too little is known
UNGATED = 0.9  # of the dearest slot: a look at an unchanged image is charged less


def whole(percent: float) -> int:
    """Return a percentage as it is shown: a half goes up, as in scripts of pages."""
    return math.floor(round(percent, 6) + 0.5)


@dataclass(frozen=True, slots=True)
class Saving:
    """One of the two savings.

    Attributes:
        spent: joules, or seconds of processor time, of all cameras together.
        always: likewise, had all cameras been active in every slot.
        percent: what `spent` is less than `always`.
        basis: whether both come from measurements of this run, or from a model.
    """

    spent: float
    always: float
    percent: float
    basis: Basis

    def __str__(self) -> str:
        """Return the figure as every page and terminal shows it."""
        return f"{whole(self.percent)} % ({self.basis})"


@dataclass(frozen=True, slots=True)
class Savings:
    """Both savings of a run; None where one is not known."""

    whole_camera: Saving | None = None
    processor_time: Saving | None = None

    def named(self) -> tuple[tuple[str, Saving | None], ...]:
        """Return both with their names."""
        return (WHOLE_CAMERA, self.whole_camera), (PROCESSOR_TIME, self.processor_time)

    def sentence(self) -> str:
        """Return both figures in a sentence, without its full stop."""
        said = [f"{name} {one or 'not measured'}" for name, one in self.named()]
        return f"{AGAINST}: {', '.join(said)}"


NO_SAVINGS = Savings()


def saving(spent: ArrayLike, always: ArrayLike, measured: bool) -> Saving | None:
    """Return the saving of cameras; None without any, or if they would have spent nothing.

    Args:
        spent: `(num_cameras,)` joules or seconds of processor time, or their sum.
        always: the same had all cameras been active in every slot.
        measured: whether both come from measurements of this run.
    """
    spent_sum, always_sum = float(np.sum(spent)), float(np.sum(always))
    percent = 100 * (1 - spent_sum / always_sum) if always_sum > 0 else np.nan
    if not np.isfinite([spent_sum, always_sum, percent]).all():
        return None
    return Saving(spent_sum, always_sum, percent, "measured" if measured else "modelled")


def charged(
    selected: Flags, charged_j: Floats, active_j: Floats, counts: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return the charges of cameras for slots, and for being active in all of them.

    An active slot costs a camera the mean of its dearest ones in which it was selected, those
    within a tenth of the dearest: so a cost that was learned counts, and a look that its motion
    gate made cheaper does not.

    Args:
        selected: `(num_rows, num_cameras)` who was active.
        charged_j: `(num_rows, num_cameras)` joules that a slot is charged with.
        active_j: `(num_cameras,)` of an active slot, of a camera that was active in none.
        counts: `(num_rows,)` slots that a row stands for; None: one each.

    Returns:
        Two arrays of `(num_cameras,)` joules.
    """
    times = np.ones(len(selected)) if counts is None else np.asarray(counts, dtype=np.float64)
    looked_j = np.where(selected, charged_j, 0.0)
    dear = selected & (looked_j >= UNGATED * looked_j.max(axis=0, initial=0.0))
    dear_slots = times @ dear
    mean_j = times @ (looked_j * dear) / np.maximum(dear_slots, 1)
    return times @ charged_j, times.sum() * np.where(dear_slots > 0, mean_j, active_j)


def every_slot_cpu_s(
    cpu_s: float,
    look_cpu_s: float,
    looks: int,
    frames: int,
    slots: float,
    asleep_share: float = 0.0,
) -> float | None:
    """Return the processor time that looking in every slot would take a camera program.

    It is put together of the camera's own measured time of a look, and of a frame with all else
    that the program does: exact where these do not depend on how often it looks.

    Args:
        cpu_s: processor time of the program.
        look_cpu_s: part of it that looking took.
        looks: that it took.
        frames: that it captured.
        slots: that it could have looked in.
        asleep_share: of the time in which it captured nothing, as it slept, [0, 1].

    Returns:
        Seconds, at least `cpu_s`; None while looks or frames are too few.
    """
    if min(looks, frames) < LEAST or cpu_s <= 0:
        return None
    look_s = look_cpu_s / looks
    frames_cpu_s = max(cpu_s - look_cpu_s, 0.0) / (1 - min(asleep_share, MOST_ASLEEP))
    return max(max(slots, looks) * look_s + frames_cpu_s, cpu_s)
