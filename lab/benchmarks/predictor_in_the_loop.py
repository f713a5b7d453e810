"""Motion capture that the shipped weights never saw, before a ring of simulated cameras."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CLIPS = ("01_06", "01_14", "02_02", "02_07")  # held out of training, as the model card says
PARTS = ((1878, 2347), (4036, 4456))  # of the Panoptic sequence, likewise


def with_face(joints_m: Floats, capture_m: Floats) -> Floats:
    """Return COCO-17 joints whose face is made up from neck and head of CMU-31."""
    from e3pose.model.skeleton import CMU31
    from e3pose_lab.datasets.bvh import face_of

    top, below = (capture_m[..., CMU31.index(n), :] for n in ("top_head", "upper_neck"))
    face = joints_m.copy()
    face[..., :5, :] = face_of(below, top, joints_m[..., 5, :] - joints_m[..., 6, :])
    return np.asarray(face)


def captured(shared: Path) -> Iterator[tuple[str, Floats]]:
    """Yield names and `(num_slots, 17, 3)` motion at 30 Hz."""
    from e3pose.model.skeleton import CMU31, COCO17, PANOPTIC19, convert
    from e3pose_lab.datasets.motion import import_cmu

    for clip in CLIPS:
        truth = import_cmu(shared / "data/cmu_mocap/cmu_mocap_train_30fps.npz", clip).truth
        assert truth is not None
        bones = truth.joints_m[:, 0]
        joints, _ = convert(bones, np.ones(bones.shape[:2]), CMU31, COCO17)
        yield "CMU", with_face(joints, bones)
    with np.load(shared / "data/panoptic/171026_pose3_train.npz") as file:
        whole = file["joints19_cm"].astype(np.float64)[..., [0, 2, 1]] * [0.01, 0.01, -0.01]
    for first, end in PARTS:
        part = whole[first:end]
        joints, _ = convert(part, np.ones(part.shape[:2]), PANOPTIC19, COCO17)
        yield "Panoptic", joints


def seen(joints_m: Floats, fps: float, detector: Any = None) -> Any:
    """Return a recording of one person who moves so, before a ring of cameras."""
    from e3pose.model.skeleton import COCO17
    from e3pose.recording import Recording, Truth
    from e3pose.simulate import DetectorSettings
    from e3pose.simulate.detections import detect_people
    from e3pose.simulate.guesses import OUTPUTS
    from e3pose.simulate.scenes import SCENES
    from e3pose.simulate.situations import draw_fields
    from e3pose_lab.datasets.motion import default_ring

    hips = joints_m[:, 11]
    rig = default_ring(hips)
    middle = np.append((hips[:, :2].min(axis=0) + hips[:, :2].max(axis=0)) / 2, 0.0)
    seeds = np.random.SeedSequence(len(joints_m)).spawn(len(rig))
    fields = draw_fields(np.random.default_rng(len(joints_m)), 1, OUTPUTS)
    views = tuple(
        detect_people(
            camera, (joints_m - middle)[:, None], middle, SCENES["ring"], 4.2, fps,
            detector or DetectorSettings(), seed, fields,
        )
        for camera, seed in zip(rig.cameras, seeds, strict=True)
    )  # fmt: skip
    truth = Truth(COCO17, ("person1",), joints_m[:, None])
    return Recording("motion", rig, fps, len(joints_m), COCO17, views, truth=truth)
