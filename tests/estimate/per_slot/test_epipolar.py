"""The paper's matcher on people whose epipolar lines are known."""

from __future__ import annotations

import numpy as np
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.estimate.per_slot.epipolar import fundamental_matrices
from e3pose.estimate.per_slot.fuse import Fuser, FusionSettings
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.model.rigs import ring_rig

EPIPOLAR = FusionSettings(refine_steps=0, matcher="epipolar", max_epipolar_px=20.0)
BODY = np.random.default_rng(3).uniform((-0.25, -0.25, 0.1), (0.25, 0.25, 1.7), (17, 3))


def rig(num_cameras: int = 4) -> Rig:
    return ring_rig(num_cameras, 4.0, 2.0, (1000, 800), np.random.default_rng(0))


def seen(cameras: Rig, people: Floats) -> dict[int, Poses2D]:
    return {
        index: Poses2D(camera.project(people), np.full(people.shape[:2], 0.9))
        for index, camera in enumerate(cameras.cameras)
    }


def shifted(view: Poses2D, by_px: tuple[float, float]) -> Poses2D:
    return Poses2D(view.keypoints_px + np.array(by_px), view.scores)


def test_points_lie_on_the_epipolar_lines_of_what_they_show() -> None:
    cameras = rig()
    matrices = fundamental_matrices(cameras)
    pixels = np.stack([camera.project(BODY) for camera in cameras.cameras])
    pixels = np.concatenate([pixels, np.ones((4, 17, 1))], axis=-1)
    for first in range(4):
        for second in range(4):
            if first == second:
                assert not matrices[first, second].any()
                continue
            lines = pixels[first] @ matrices[first, second].T
            distance = (lines * pixels[second]).sum(axis=-1) / np.hypot(lines[:, 0], lines[:, 1])
            assert np.abs(distance).max() < 1e-6


def test_people_are_found_where_they_are() -> None:
    cameras, people = rig(), np.stack([BODY, BODY + [1.0, 0.3, 0.0], BODY - [0.2, 1.1, 0.0]])
    fusion = Fuser(cameras, 17, EPIPOLAR).fuse(seen(cameras, people))
    assert len(fusion.people) == 3
    assert (np.sort(fusion.members, axis=0) == np.arange(3)[:, None]).all()
    assert (fusion.members == fusion.members[:, :1]).all()
    apart = fusion.people.joints_m[:, None] - people[None]
    assert np.linalg.norm(apart, axis=-1).mean(axis=-1).min(axis=0).max() < 1e-6


def test_distance_is_in_pixels_and_the_mean_of_both_directions() -> None:
    cameras = rig(2)
    views = seen(cameras, BODY[None])
    views[1] = shifted(views[1], (3.0, 25.0))
    matrices = fundamental_matrices(cameras)
    pixels = [np.append(views[i].keypoints_px[0], np.ones((17, 1)), axis=-1) for i in (0, 1)]
    apart = []
    for own, other in ((0, 1), (1, 0)):
        lines = pixels[own] @ matrices[own, other].T
        along = np.abs((lines * pixels[other]).sum(axis=-1))
        apart.append((along / np.hypot(lines[:, 0], lines[:, 1])).mean())
    expected = float(np.mean(apart))
    assert 5 < expected < 40
    for factor, people in ((0.99, 0), (1.01, 1)):
        settings = FusionSettings(
            refine_steps=0, matcher="epipolar", max_epipolar_px=factor * expected
        )
        assert len(Fuser(cameras, 17, settings).fuse(views).people) == people


def test_cameras_are_taken_in_order_and_the_closest_pose_first() -> None:
    cameras = rig(3)
    views = seen(cameras, BODY[None])
    near, far = shifted(views[1], (0.0, 4.0)), shifted(views[1], (0.0, 12.0))
    views[1] = Poses2D(np.concatenate([far.keypoints_px, near.keypoints_px]), np.full((2, 17), 0.9))
    fusion = Fuser(cameras, 17, EPIPOLAR).fuse(views)
    assert fusion.members.tolist() == [[0, 1, 0]]


def test_pose_beyond_the_threshold_begins_a_candidate_that_later_views_join() -> None:
    cameras = rig(4)
    first, second = seen(cameras, BODY[None]), seen(cameras, BODY[None] + [0.0, 0.0, 0.8])
    fusion = Fuser(cameras, 17, EPIPOLAR).fuse({0: first[0], 1: second[1], 2: second[2]})
    assert fusion.members.tolist() == [[-1, 0, 0, -1]]
    scores = np.full((2, 1, 17), 0.9)
    scores[0, :, :9] = scores[1, :, 9:] = 0.0  # without a shared joint nothing is joined
    some = {i: Poses2D(first[i].keypoints_px, scores[i]) for i in (0, 1)}
    assert len(Fuser(cameras, 17, EPIPOLAR).fuse(some).people) == 0


TANKE_GALL = FusionSettings(refine_steps=0, matcher="tanke-gall")


def test_tanke_gall_drops_poses_of_a_low_mean_score() -> None:
    cameras = rig()
    views = seen(cameras, BODY[None])
    views[2] = Poses2D(views[2].keypoints_px, np.full((1, 17), 0.3))
    (members,) = Fuser(cameras, 17, TANKE_GALL).fuse(views).members
    assert members.tolist() == [0, 0, -1, 0]
    (members,) = Fuser(cameras, 17, EPIPOLAR).fuse(views).members
    assert members.tolist() == [0, 0, 0, 0]


@each_case(("score", "people"), [(0.9, 0), (0.4, 1)])
def test_tanke_gall_lets_strong_members_alone_refuse(score: float, people: int) -> None:
    cameras = rig(2)
    views = seen(cameras, BODY[None])
    views[0] = Poses2D(views[0].keypoints_px, np.full((1, 17), score))
    views[1] = shifted(views[1], (3.0, 90.0))
    assert len(Fuser(cameras, 17, TANKE_GALL).fuse(views).people) == people
    assert len(Fuser(cameras, 17, EPIPOLAR).fuse(views).people) == 0


def test_tanke_gall_assigns_at_the_least_total_cost() -> None:
    """The greedy matcher takes the nearest first, and leaves a pair that is too far apart."""
    cameras = rig(2)
    people = np.stack([BODY, BODY + [0.0, 0.0, 0.10]])
    views = seen(cameras, people)
    # The second view shows both higher: the lower one is nearest to where the upper one was.
    higher = shifted(views[1], (0.0, -16.0))
    views[1] = Poses2D(higher.keypoints_px[::-1], higher.scores)
    found = Fuser(cameras, 17, TANKE_GALL).fuse(views).members
    assert sorted(found.tolist()) == [[0, 1], [1, 0]]
