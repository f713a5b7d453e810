"""A predictor of one's own: whoever can `predict` says where people will be.

Run: python examples/03_own_predictor.py
On the command line: e3pose replay RECORDING --predictor examples/03_own_predictor.py:Halfway
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose import ReplaySettings, replay
from e3pose.predict import Prediction
from e3pose.simulate import SceneSettings, simulate


class Halfway:
    """People go on with half of the step that they just took."""

    def predict(
        self, history_m: NDArray[np.float64], interval_s: float, lead_slots: int
    ) -> Prediction:
        """Return the joints of the next slots.

        Args:
            history_m: `(num_slots, num_tracks, num_joints, 3)` metres, oldest first; NaN where
                nobody was.
            interval_s: seconds per slot.
            lead_slots: how many slots to look ahead.
        """
        step = np.nan_to_num(history_m[-1] - history_m[-2])
        ahead = np.arange(1, lead_slots + 1)[:, None, None, None]
        return Prediction.of_unknown_error(history_m[-1] + 0.5 * ahead * step)


def main() -> None:
    """Print what was shown of a scene that is chosen for with this predictor."""
    recording = simulate(SceneSettings(people=2, seconds=4, cameras=4), seed=1)
    settings = ReplaySettings(policy="e3pose", lead_slots=3)
    records = list(replay(recording, settings, predictor=Halfway()))
    shown = np.mean([len(record.people) for record in records[20:]])
    print(f"{shown:.1f} people shown a slot, chosen for 3 slots ahead")


if __name__ == "__main__":
    main()
