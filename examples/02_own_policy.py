"""A policy of one's own: whoever can `select` decides which cameras look.

Run: python examples/02_own_policy.py
On the command line: e3pose replay RECORDING --policy examples/02_own_policy.py:PlainView
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose import replay
from e3pose.select.policies import Selection, Situation
from e3pose.simulate import SceneSettings, simulate


@dataclass(frozen=True)
class PlainView:
    """Wakes the cameras in whose images most of everybody is, where nothing hides it."""

    count: int = 2

    def select(self, situation: Situation) -> Selection:
        """Return `(num_cameras,)`: who looks in the slot that is decided for."""
        worth = situation.visibility.sum(axis=1) - situation.occlusion
        worth = np.where(situation.online, worth, -np.inf)
        chosen = np.zeros(len(worth), dtype=bool)
        chosen[np.argsort(-worth, kind="stable")[: self.count]] = True
        return chosen & situation.online


def main() -> None:
    """Print how often each camera was chosen."""
    recording = simulate(SceneSettings(people=2, seconds=4, cameras=4), seed=1)
    records = list(replay(recording, policy=PlainView(count=2)))
    duty = np.mean([record.selected for record in records[20:]], axis=0)
    for camera_id, share in zip(recording.rig.camera_ids, duty, strict=True):
        print(f"{camera_id}: awake in {share:.0%} of the slots")


if __name__ == "__main__":
    main()
