"""Motion capture as the simulated detectors of several cameras see it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

EARS_M, EYES_M, FACE_M = 0.075, 0.03, 0.09  # of a head, from its middle


def as_coco17(joints_m: Floats) -> Floats:
    """Return `(num_slots, 17, 3)` of CMU-31, with a face put on the head."""
    from e3pose.model.skeleton import CMU31, COCO17, convert

    coco, _ = convert(joints_m, np.ones(joints_m.shape[:2]), CMU31, COCO17)
    head = 0.5 * (joints_m[:, CMU31.index("upper_neck")] + joints_m[:, CMU31.index("top_head")])
    left = joints_m[:, CMU31.index("left_shoulder")] - joints_m[:, CMU31.index("right_shoulder")]
    left /= np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), 1e-6)
    front = np.cross(left, [0.0, 0.0, 1.0])
    for name, forward, aside in (
        ("nose", FACE_M, 0.0), ("left_eye", FACE_M, EYES_M), ("right_eye", FACE_M, -EYES_M),
        ("left_ear", 0.0, EARS_M), ("right_ear", 0.0, -EARS_M),
    ):  # fmt: skip
        coco[:, COCO17.index(name)] = head + forward * front + aside * left
    return coco


def watched(recording: Any, people_m: Floats, seed: int, focus_m: float) -> Any:
    """Return a recording of `(num_slots, num_persons, 17, 3)` as simulated detectors see it."""
    from e3pose.model.skeleton import COCO17
    from e3pose.recording import Truth
    from e3pose.simulate.detections import detect_people
    from e3pose.simulate.place import Habits, Scene
    from e3pose.simulate.settings import DetectorSettings

    scene = Scene("motion capture", people_m.shape[1], 5.0, Habits())
    children = np.random.SeedSequence(seed).spawn(len(recording.rig))
    views = tuple(
        detect_people(
            camera, people_m, np.zeros(3), scene, focus_m, recording.fps, DetectorSettings(), child
        )
        for camera, child in zip(recording.rig.cameras, children, strict=True)
    )
    names = tuple(f"person{number + 1}" for number in range(people_m.shape[1]))
    return replace(
        recording, num_slots=len(people_m), skeleton=COCO17, views=views, detector="simulated",
        truth=Truth(COCO17, names, people_m), truth_complete=True,
    )  # fmt: skip
