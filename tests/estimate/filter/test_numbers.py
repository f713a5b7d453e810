"""The numbers that people get: from 1, and none for a track that nobody was shown."""

from __future__ import annotations

import numpy as np
from tests.estimate.filter.room import MODEL, see, standing

from e3pose.estimate.filter.estimator import Filtered
from e3pose.estimate.filter.step import StepKernel


def test_a_false_start_takes_no_number() -> None:
    estimator = Filtered(MODEL, StepKernel())
    memory, first, ghost = estimator.begin(), standing((0.0, 0.0)), standing((1.2, 0.8))
    second = standing((-1.2, 0.9))
    slots = [see(first)] * 10
    for _ in range(3):  # two cameras agree on somebody whom no other confirms
        slots += [{**see(first), **see(np.concatenate([first, ghost]), (0, 2))}, *[see(first)] * 20]
    slots += [see(np.concatenate([first, second]))] * 10
    started, shown = 0, []
    for slot, views in enumerate(slots):
        memory, estimate = estimator.estimate(memory, views, slot / 25, lambda: 0.0)
        started = max(started, memory.belief.next_id - 1)
        shown.append(estimate.people.track_ids.tolist())
    assert started == 2 and len(memory.belief) == 2
    assert shown[5] == [1] and shown[-1] == [1, 2]
    assert max(map(len, shown)) == 2
