"""Simulate a scene, fuse its views into 3D people, and compare them with the truth.

Run: python examples/01_triangulate.py
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.per_slot.fuse import Fuser
from e3pose.model.pose import Poses2D
from e3pose.simulate import SceneSettings, simulate

NEAR_M = 0.5  # a fused person this close to a true one is that person


def main() -> None:
    """Print how many people were found, and how well."""
    recording = simulate(SceneSettings(scene="crossing", people=4, seconds=10), seed=1)
    assert recording.truth is not None
    fuser = Fuser(recording.rig, len(recording.skeleton))
    errors_mm: list[float] = []
    people = found = 0
    for slot in range(0, recording.num_slots, 5):
        views: dict[int, Poses2D] = {}
        for camera in range(len(recording.rig)):
            view = recording.view(slot, camera)
            if view is not None:
                views[camera] = view
        fused = fuser.fuse(views).people.joints_m
        truth = recording.truth.joints_m[slot]
        for person in truth[np.isfinite(truth).all(axis=(1, 2))]:
            people += 1
            distance = [mean_distance_m(person, other) for other in fused]
            if distance and min(distance) < NEAR_M:
                found += 1
                errors_mm.append(1000 * min(distance))
    print(f"found {found} of {people} people, mean joint error {np.mean(errors_mm):.0f} mm")


def mean_distance_m(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Return the mean distance of the joints that both `(num_joints, 3)` people have."""
    both = np.isfinite(a).all(axis=-1) & np.isfinite(b).all(axis=-1)
    return float(np.linalg.norm(a[both] - b[both], axis=-1).mean()) if both.any() else np.inf


if __name__ == "__main__":
    main()
