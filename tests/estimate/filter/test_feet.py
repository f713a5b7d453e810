"""Feet stay near the ankles, however few cameras show them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.recording import Recording, ViewSeries
from e3pose.simulate import SceneSettings, simulate
from e3pose.simulate.feet import with_skeleton

FEET = ("toe", "heel")


def feet_of(recording: Recording) -> list[int]:
    names = enumerate(recording.skeleton.joints)
    return [joint for joint, name in names if name.endswith(FEET)]


def without_feet(recording: Recording, views: ViewSeries) -> ViewSeries:
    keypoints_px, scores = views.keypoints_px.copy(), views.scores.copy()
    feet = feet_of(recording)
    keypoints_px[:, feet], scores[:, feet] = np.nan, 0.0
    return replace(views, keypoints_px=keypoints_px, scores=scores)


def test_feet_that_one_camera_shows_stay_near_their_ankles() -> None:
    scene = SceneSettings("ring", people=1, seconds=4.0, fps=12.5, cameras=3)
    whole = with_skeleton(simulate(scene, 701), "halpe26", 701)
    recording = replace(
        whole, views=(whole.views[0], *(without_feet(whole, each) for each in whole.views[1:]))
    )
    names = recording.skeleton.joints
    ankles = [names.index("left_ankle"), names.index("right_ankle")]
    feet = feet_of(recording)
    away_m = [
        np.linalg.norm(joints_m[feet][:, None] - joints_m[ankles], axis=-1).min(axis=1)
        for record in replay(recording, ReplaySettings(num_selected=3, policy="round-robin"))
        for joints_m in record.people.joints_m
        if record.slot >= 25
    ]
    assert len(away_m) >= 20
    assert np.median(away_m) < 0.25 and np.max(away_m) < 0.5
