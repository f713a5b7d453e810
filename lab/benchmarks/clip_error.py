"""Reference poses of a recording without truth: the offline smoother over all its cameras.

The reference is the offline smoother over every view of every camera (`e3pose_lab.noise.smoother`).
It has the joints that at least two cameras saw within 0.12 s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from e3pose.base.arrays import Floats
from e3pose.estimate.filter import Noise
from e3pose.estimate.filter.bones import proportions_of
from e3pose.estimate.filter.tree import grow
from e3pose.model.noise import LEAST_SCORE
from e3pose.recording import Recording
from e3pose_lab.noise.calibrate import all_camera_tracks
from e3pose_lab.noise.residuals import (
    SUPPORT_S,
    SUPPORT_VIEWS,
    assign_detections,
)
from e3pose_lab.noise.smoother import smooth


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """One person as all cameras saw them.

    Attributes:
        first_slot: of the person.
        joints_m: `(num_slots, num_joints, 3)` metres, NaN where too few cameras saw the joint.
    """

    first_slot: int
    joints_m: Floats

    def at(self, slot: float) -> Floats:
        """Return `(num_joints, 3)` between slots; NaN outside the person's time."""
        place = slot - self.first_slot
        if not 0 <= place <= len(self.joints_m) - 1:
            return np.full(self.joints_m.shape[1:], np.nan)
        low = min(int(place), len(self.joints_m) - 2) if len(self.joints_m) > 1 else 0
        share = place - low
        if share == 0:
            return np.asarray(self.joints_m[low])
        return np.asarray((1 - share) * self.joints_m[low] + share * self.joints_m[low + 1])


def references(recording: Recording, noise: Noise) -> list[Reference]:
    """Return everybody as the smoother over all views sees them; limbs of one length each."""
    body = proportions_of(recording.skeleton, grow(recording.skeleton))
    tracks, _ = all_camera_tracks(recording, recording.num_slots)
    scales = np.array([max(c.image_size) for c in recording.rig.cameras]) / noise.image_px
    reach = 2 * max(1, round(SUPPORT_S / recording.interval_s)) + 1
    found = []
    for person in assign_detections(recording, tracks, recording.num_slots):
        seen = person.scores > LEAST_SCORE
        sigma = np.where(seen, noise.of(person.scores, scales[:, None]), np.inf)
        path = smooth(
            person.keypoints_px,
            sigma,
            recording.rig.projections,
            person.joints_m,
            recording.interval_s,
            rigid=body,
        )
        near = maximum_filter1d(seen.astype(np.int8), reach, axis=0, mode="constant").sum(axis=1)
        found.append(
            Reference(person.first_slot, np.where((near >= SUPPORT_VIEWS)[..., None], path, np.nan))
        )
    return found
