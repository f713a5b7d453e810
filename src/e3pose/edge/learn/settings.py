"""Settings of online learning."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.quantities import check_within
from e3pose.predict.attention_lstm import SHIPPED

LONGEST_S = 1e8  # three years


@dataclass(frozen=True, slots=True)
class LearningSettings:
    """Settings for learning in a running system: choices, not measurements.

    Attributes:
        interval_s: seconds per slot.
        leads: slots ahead at which a new network must be better.
        margin: share by which its error must be lower, at each of these leads.
        least_windows: held-back windows without which nothing is decided.
        held_back_s: seconds with people in them, the newest, that are never trained on.
        least_s: seconds with people in them that must have been collected to begin.
        every_s: seconds from one training to the next.
        train_s: seconds that a training may learn for; it is killed when it takes twice as long
            and a minute.
        steps: batches at most.
        learning_rate: a tenth of what teaches a network from nothing, so that it forgets little.
        memory_bytes: that a training may allocate.
        back_off_s: seconds to wait after a training that failed, doubled with every failure.
        longest_back_off_s: at which doubling ends.
        chunk_s: seconds of poses in a file.
        ring_bytes: of all these files together; the oldest go first.
        keep_versions: besides the one that runs and the one before it.
        seed: of windows.
        base: weights of version 0, to begin with.
    """

    interval_s: float
    leads: tuple[int, ...] = (1, 2, 3, 5, 8, 10)
    margin: float = 0.02
    least_windows: int = 100
    held_back_s: float = 300.0
    least_s: float = 1200.0
    every_s: float = 1800.0
    train_s: float = 300.0
    steps: int = 2000
    learning_rate: float = 2e-4
    memory_bytes: int = 4 * 2**30
    back_off_s: float = 60.0
    longest_back_off_s: float = 6 * 3600.0
    chunk_s: float = 30.0
    ring_bytes: int = 256 * 2**20
    keep_versions: int = 5
    seed: int = 0
    base: Path = field(default=SHIPPED)

    def __post_init__(self) -> None:
        if not self.leads or any(not 1 <= lead <= 60 for lead in self.leads):
            raise InputError(f"learning: leads: found {self.leads}, expected slots from 1 to 60")
        for name, low, high in (
            ("interval_s", 1e-3, 10.0),
            ("margin", 0.0, 0.9),
            ("held_back_s", 1.0, LONGEST_S),
            ("least_s", 0.0, LONGEST_S),
            ("every_s", 0.0, LONGEST_S),
            ("train_s", 0.1, LONGEST_S),
            ("chunk_s", 0.1, 600.0),
            ("keep_versions", 1, 1000),
            ("least_windows", 1, math.inf),
            ("steps", 1, math.inf),
            ("ring_bytes", 2**16, math.inf),
        ):
            check_within(f"learning: {name}", getattr(self, name), low, high)
