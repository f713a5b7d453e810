"""Simulated people with feet: where they stand, and what cameras see of them."""

from __future__ import annotations

import numpy as np
import pytest

from e3pose.base.errors import InputError
from e3pose.model.skeleton import COCO17, convert
from e3pose.recording import Recording
from e3pose.simulate import SceneSettings, simulate
from e3pose.simulate.feet import FOOT_M, with_skeleton


@pytest.fixture(scope="module")
def walk() -> Recording:
    return simulate(SceneSettings("ring", people=2, seconds=2.0, fps=10, cameras=3), 701)


@pytest.mark.parametrize("name", ["body25", "halpe26"])
def test_people_are_the_same_and_have_feet_on_the_floor(walk: Recording, name: str) -> None:
    found = with_skeleton(walk, name, 1)
    assert found.truth is not None and walk.truth is not None
    joints_m, skeleton = found.truth.joints_m, found.truth.skeleton
    assert skeleton.name == name == found.skeleton.name
    back, _ = convert(joints_m, np.ones(joints_m.shape[:-1]), skeleton, COCO17)
    np.testing.assert_allclose(back, walk.truth.joints_m)
    for side in ("left", "right"):
        ankle, toe, small, heel = (
            joints_m[..., skeleton.index(f"{side}_{part}"), :]
            for part in ("ankle", "big_toe", "small_toe", "heel")
        )
        assert np.nanmin(heel[..., 2]) > -0.03 and np.nanmin(toe[..., 2]) > -0.03
        length = np.linalg.norm(toe - heel, axis=-1)
        known = np.isfinite(length)
        np.testing.assert_allclose(length[known], length[known][0])
        np.testing.assert_allclose((ankle - heel)[known][:, 2], -FOOT_M["heel"][2])
        # The small toe is on the outer side.
        other = joints_m[..., skeleton.index(f"{'right' if side == 'left' else 'left'}_hip"), :]
        own = joints_m[..., skeleton.index(f"{side}_hip"), :]
        assert (((small - toe) * (own - other)).sum(axis=-1)[known] > 0).all()


def test_a_camera_sees_a_foot_where_it_sees_the_ankle(walk: Recording) -> None:
    found = with_skeleton(walk, "body25", 1)
    assert found.truth is not None
    toe, ankle = (found.skeleton.index(f"left_{part}") for part in ("big_toe", "ankle"))
    near, count = [], 0
    for camera, series in enumerate(found.views):
        seen = series.scores[:, ankle] > 0
        assert (series.scores[~seen][:, toe] == 0).all()
        count += int(seen.sum())
        lens = found.rig.cameras[camera]
        slots = np.repeat(series.slots, np.diff(series.starts))
        places = lens.project(found.truth.joints_m[slots][:, :, toe])
        off = np.linalg.norm(series.keypoints_px[:, None, toe] - places, axis=-1)
        near += np.nanmin(off[np.isfinite(off).any(axis=1)], axis=1).tolist()
    assert count > 30 and np.median(near) < 12


def test_another_skeleton_is_refused(walk: Recording) -> None:
    assert with_skeleton(walk, "coco17", 1) is walk
    with pytest.raises(
        InputError, match="skeleton: found cmu31 with lower_back, expected joints of coco17"
    ):
        with_skeleton(walk, "cmu31", 1)
