"""Motion that was captured, as the simulated detectors of several cameras see it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.skeleton import CMU31, COCO17, Skeleton, convert
from e3pose.recording import Recording
from e3pose.simulate.detections import detect_people
from e3pose.simulate.guesses import DECLARED, OUTPUTS
from e3pose.simulate.place import Habits, Scene
from e3pose.simulate.settings import DetectorSettings
from e3pose.simulate.situations import draw_fields

EARS_M, EYES_M, FACE_M = 0.075, 0.03, 0.09  # of a head, from its middle
FOCUS_M = 4.0


def as_coco17(joints_m: Floats, skeleton: Skeleton = CMU31) -> Floats:
    """Return `(*batch, 17, 3)` of `(*batch, num_joints, 3)`; heads of CMU-31 are given a face."""
    coco, _ = convert(joints_m, np.ones(joints_m.shape[:-1]), skeleton, COCO17)
    if skeleton != CMU31:
        return coco
    neck, top, left, right = (
        joints_m[..., CMU31.index(name), :]
        for name in ("upper_neck", "top_head", "left_shoulder", "right_shoulder")
    )
    head, across = 0.5 * (neck + top), left - right
    across = across / np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-6)
    front = np.cross(across, [0.0, 0.0, 1.0])
    for name, forward, aside in (
        ("nose", FACE_M, 0.0), ("left_eye", FACE_M, EYES_M), ("right_eye", FACE_M, -EYES_M),
        ("left_ear", 0.0, EARS_M), ("right_ear", 0.0, -EARS_M),
    ):  # fmt: skip
        coco[..., COCO17.index(name), :] = head + forward * front + aside * across
    return coco


def watched(
    recording: Recording,
    seed: int,
    focus_m: float = FOCUS_M,
    detector: DetectorSettings | None = None,
) -> Recording:
    """Return the recording as simulated detectors of its cameras see the people of its truth.

    Args:
        recording: with truth; its views are not used.
        seed: of the detectors' errors.
        focus_m: distance at which the lenses are sharp.
        detector: how they err.

    Raises:
        InputError: when the recording has no truth.
    """
    if recording.truth is None:
        raise InputError(f"recording {recording.name}: truth: found none, expected 3D poses")
    people_m = as_coco17(recording.truth.joints_m, recording.truth.skeleton)
    scene = Scene("motion capture", people_m.shape[1], 5.0, Habits())
    detector = detector or DetectorSettings()
    *children, field_seed = np.random.SeedSequence(seed).spawn(len(recording.rig) + 1)
    fields = draw_fields(np.random.default_rng(field_seed), people_m.shape[1], OUTPUTS)
    views = tuple(
        detect_people(
            camera, people_m, np.zeros(3), scene, focus_m, recording.fps,
            detector, child, fields,
        )
        for camera, child in zip(recording.rig.cameras, children, strict=True)
    )  # fmt: skip
    return replace(
        recording, num_slots=len(people_m), skeleton=COCO17, views=views,
        detector=DECLARED if detector.guessing and not detector.perfect else "simulated",
        truth=replace(recording.truth, skeleton=COCO17, joints_m=people_m), truth_complete=True,
    )  # fmt: skip
