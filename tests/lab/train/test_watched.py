"""Captured motion before simulated detectors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.rigs import ring_rig
from e3pose.model.skeleton import CMU31, COCO17
from e3pose.recording import Recording, Truth, ViewSeries
from e3pose.simulate import DetectorSettings
from e3pose_lab.train.watched import as_coco17, watched


def standing() -> Floats:
    """Return `(1, 1, 31, 3)`: somebody who stands upright and looks along x."""
    joints = np.random.default_rng(0).normal(0, 0.1, (1, 1, len(CMU31), 3)) + [0.0, 0.0, 1.0]
    for name, place in (
        ("upper_neck", (0.0, 0.0, 1.5)),
        ("top_head", (0.0, 0.0, 1.7)),
        ("left_shoulder", (0.0, 0.2, 1.4)),
        ("right_shoulder", (0.0, -0.2, 1.4)),
    ):
        joints[..., CMU31.index(name), :] = place
    return joints


def captured(joints_m: Floats) -> Recording:
    rig = ring_rig(3, 4.0, 2.0, (640, 480), np.random.default_rng(0))
    nothing = ViewSeries.from_views([], [], [], len(CMU31))
    truth = Truth(CMU31, ("somebody",), joints_m)
    return Recording("m", rig, 10.0, len(joints_m), CMU31, (nothing,) * 3, truth=truth)


def test_heads_of_motion_capture_are_given_a_face() -> None:
    face = as_coco17(standing())[0, 0]
    nose, left_ear, right_ear = (
        face[COCO17.index(name)] for name in ("nose", "left_ear", "right_ear")
    )
    np.testing.assert_allclose(nose, [0.09, 0.0, 1.6], atol=1e-9)
    np.testing.assert_allclose(left_ear - right_ear, [0.0, 0.15, 0.0], atol=1e-9)


def test_joints_are_seen_where_they_project() -> None:
    moving = np.repeat(standing(), 5, axis=0)
    seen = watched(captured(moving), 0, detector=DetectorSettings(perfect=True))
    assert seen.truth is not None and seen.skeleton == seen.truth.skeleton == COCO17
    for number, camera in enumerate(seen.rig.cameras):
        view = seen.view(3, number)
        assert view is not None
        expected = camera.project(seen.truth.joints_m[3, 0])
        np.testing.assert_allclose(view.keypoints_px[0], expected, atol=1e-3)


def test_without_truth_there_is_nobody_to_see() -> None:
    with pytest.raises(InputError, match="truth: found none"):
        watched(replace(captured(standing()), truth=None), 0)
