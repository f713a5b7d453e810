"""An estimator of one's own: the views of a slot and a memory in, people and a memory out.

Run: python examples/05_own_estimator.py
On the command line: e3pose replay RECORDING --pipeline examples/05_own_estimator.py:smoothed
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from e3pose import Poses2D, ReplaySettings, replay
from e3pose.estimate import Estimate, Estimator, EstimatorSettings, Outlook, estimator_maker
from e3pose.predict import Predictor
from e3pose.simulate import SceneSettings, simulate

SLOTS = 3


@dataclass(frozen=True)
class Smoothed:
    """Shows the mean of everybody's last slots, and leaves the rest to another estimator."""

    inner: Estimator[Any]

    def begin(self) -> Any:
        """Return the memory before the first slot."""
        return self.inner.begin()

    def estimate(
        self,
        memory: Any,
        views: Mapping[int, Poses2D],
        time_s: float,
        clock: Callable[[], float],
    ) -> tuple[Any, Estimate]:
        """Take in one slot."""
        memory, estimate = self.inner.estimate(memory, views, time_s, clock)
        people, history = estimate.people, estimate.history
        where = {track: index for index, track in enumerate(history.track_ids.tolist())}
        tracks = [where[track] for track in people.track_ids.tolist()]
        recent_m = history.joints_m[-SLOTS:, tracks]
        there = np.isfinite(recent_m).all(axis=-1, keepdims=True)
        sums = np.where(there, recent_m, 0.0).sum(axis=0)
        mean_m = sums / np.maximum(there.sum(axis=0), 1)
        shown_m = np.where(np.isfinite(people.joints_m), mean_m, np.nan)
        return memory, replace(estimate, people=replace(people, joints_m=shown_m))

    def steer(self, memory: Any, predictor: Predictor, interval_s: float) -> Any:
        """Let a predictor steer the memory."""
        return self.inner.steer(memory, predictor, interval_s)

    def leave_out_ids(self, memory: Any, count: int) -> Any:
        """Return the memory with some identities never to be given."""
        return self.inner.leave_out_ids(memory, count)

    def forget_people(self, memory: Any) -> Any:
        """Return the memory with nobody in it."""
        return self.inner.forget_people(memory)

    def outlook(self, memory: Any, ahead_s: float) -> Outlook:
        """Return what is expected if nothing is seen."""
        return self.inner.outlook(memory, ahead_s)


def smoothed(settings: EstimatorSettings) -> Smoothed:
    """Make the estimator for a rig, as a name on the command line or in a site file does."""
    return Smoothed(estimator_maker("paper")(settings))


def main() -> None:
    """Print what was shown of a scene."""
    recording = simulate(SceneSettings(people=2, seconds=4, cameras=4), seed=1)
    settings = ReplaySettings(pipeline=f"{__file__}:smoothed", policy="round-robin", num_selected=3)
    records = list(replay(recording, settings))
    shown = np.mean([len(record.people) for record in records[20:]])
    print(f"{shown:.1f} people shown a slot, each as the mean of {SLOTS} slots")


if __name__ == "__main__":
    main()
