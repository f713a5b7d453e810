"""How the errors of real keypoints grow with the size of people in the image.

    E3POSE_SHARED=... python lab/benchmarks/errors_by_size.py

Shelf: distance of keypoints from its labels. Pizza, first half: distance of the keypoints of each
camera from the poses of all others. Prints the power of pixels per metre with which the median
error in pixels grows, at the same score: within cameras, and with differences between them. 0 is
an error that is a share of the image, 1 one that is a share of the body.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from e3pose.base.arrays import Floats
from e3pose.evaluate.held_out import COMPARED, turns
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.recording import Recording, load_recording
from e3pose_lab.datasets import shared_folder
from e3pose_lab.datasets.shelf import import_shelf
from filter_terms import half

SAME_M, LEAST_SCORE, EVERY = 0.3, 0.1, 5
Slots = dict[int, Floats]


def errors(recording: Recording, people: Slots, joints: list[int]) -> Floats:
    """Return `(num, 4)`: log pixels off, log pixels per metre, camera, score.

    Args:
        recording: whose keypoints are compared.
        people: by slot `(num_people, num_compared, 3)` where they are.
        joints: of the skeleton, those compared.
    """
    found: list[Any] = []
    for number, (camera, series) in enumerate(
        zip(recording.rig.cameras, recording.views, strict=True)
    ):
        focal_px = np.sqrt(camera.K[0, 0] * camera.K[1, 1])
        for slot, joints_m in people.items():
            view = series.view(slot)
            if view is None or not len(joints_m) or not len(view.scores):
                continue
            per_m = focal_px / (joints_m @ camera.R[2] + camera.t[2]).mean(axis=-1)
            scores = view.scores[:, joints]
            keypoints = np.where(
                (scores > LEAST_SCORE)[..., None], view.keypoints_px[:, joints], np.nan
            )
            off = np.linalg.norm(camera.project(joints_m)[:, None] - keypoints[None], axis=-1)
            known = np.isfinite(off)
            mean = np.where(known, off, 0).sum(axis=-1) / np.maximum(known.sum(axis=-1), 1)
            mean[~known.any(axis=-1)] = 1e6
            for who, seen in zip(*linear_sum_assignment(mean), strict=True):
                if 0 < mean[who, seen] < SAME_M * per_m[who]:
                    use = known[who, seen]
                    logs = np.log(np.maximum(off[who, seen, use], 1e-3))
                    size = np.full(use.sum(), np.log(per_m[who]))
                    found.append(np.c_[logs, size, np.full(use.sum(), number), scores[seen, use]])
    return np.concatenate(found)


def power(rows: Floats, within: bool) -> float:
    """Return the slope of a median regression of the error by size, score and, `within`, camera."""
    y, size, camera, score = rows.T
    groups = camera if within else 0 * camera
    by_camera = [(groups == one).astype(float) for one in np.unique(groups)]
    table = np.stack([size, score, score**2, *by_camera], axis=1)
    weights = np.ones(len(y))
    for _ in range(60):
        root = np.sqrt(weights)
        slopes = np.linalg.lstsq(table * root[:, None], y * root, rcond=None)[0]
        weights = 1 / np.maximum(np.abs(y - table @ slopes), 1e-3)
    return float(slopes[0])


def main() -> None:
    """Print the table."""
    shared = shared_folder()
    shelf = import_shelf(shared / "data/shelf/shelf.npz")
    assert shelf.truth is not None
    columns = [shelf.truth.skeleton.index(joint) for joint in COMPARED]
    people = {
        slot: joints[np.isfinite(joints).all(axis=(1, 2))]
        for slot, joints in enumerate(shelf.truth.joints_m[:, :, columns])
    }
    rows = errors(shelf, people, [shelf.skeleton.index(joint) for joint in COMPARED])
    print(f"Shelf, {len(rows)} keypoints: within cameras {power(rows, True):.2f}, "
          f"over all {power(rows, False):.2f}")  # fmt: skip
    pizza = half(load_recording(shared / "data/pizza/recording"), second=False)
    joints = [pizza.skeleton.index(joint) for joint in COMPARED]
    for rest, judge in turns(pizza, ["each"])[1:]:
        assert judge is not None
        records = list(replay(rest, ReplaySettings(pipeline="memory", policy="all")))
        poses = {r.slot: r.people.joints_m[:, joints] for r in records[2 * EVERY :: EVERY]}
        rows = errors(judge, poses, joints)
        print(f"pizza {judge.rig.camera_ids[0]}, {len(rows)} keypoints: {power(rows, True):.2f}")


if __name__ == "__main__":
    main()
