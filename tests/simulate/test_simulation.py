"""The simulator as a whole: exactness, seeds, rigs, sizes, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.model.rigs import ring_rig, watched_area
from e3pose.recording import Recording
from e3pose.simulate import SCENES, DetectorSettings, SceneSettings, simulate

pytestmark = pytest.mark.slow

PERFECT = DetectorSettings(perfect=True)


def same(a: Recording, b: Recording) -> bool:
    assert a.truth is not None and b.truth is not None
    return np.array_equal(a.truth.joints_m, b.truth.joints_m, equal_nan=True) and all(
        np.array_equal(x.keypoints_px, y.keypoints_px, equal_nan=True)
        and np.array_equal(x.scores, y.scores)
        and np.array_equal(x.starts, y.starts)
        for x, y in zip(a.views, b.views, strict=True)
    )


def behind_walls(scene: str, camera: Camera, joints_m: Floats) -> NDArray[np.bool_]:
    start = np.broadcast_to(camera.center_m, joints_m.shape)
    hidden = np.zeros(joints_m.shape[:-1], dtype=bool)
    for wall in SCENES[scene].walls:
        hidden |= wall.blocks(start, joints_m)
    return hidden


@each_case("scene", sorted(SCENES))
def test_exact_keypoints_are_where_the_truth_projects(scene: str) -> None:
    recording = simulate(SceneSettings(scene=scene, seconds=0.2, detector=PERFECT), 1)
    assert recording.truth is not None and recording.truth_complete
    for camera, series in zip(recording.rig.cameras, recording.views, strict=True):
        dies_at = recording.dies_at_s.get(camera.camera_id, np.inf) * recording.fps
        for slot in range(recording.num_slots):
            view = series.view(slot)
            if slot >= dies_at:
                assert view is None
                continue
            assert view is not None
            pixels = camera.project(recording.truth.joints_m[slot])
            inside = camera.sees(recording.truth.joints_m[slot])
            inside &= ~behind_walls(scene, camera, recording.truth.joints_m[slot])
            expected = np.where(inside[..., None], pixels, np.nan)[inside.any(axis=1)]
            assert len(view) == len(expected)
            assert set(view.scores.ravel()) <= {0.0, 1.0}
            # The order of people is shuffled: compare as sets of rows.
            rows = sorted(
                map(tuple, np.nan_to_num(view.keypoints_px, nan=-1).reshape(len(view), 34))
            )
            wanted = sorted(map(tuple, np.nan_to_num(expected, nan=-1).reshape(len(view), 34)))
            assert np.array(rows) == pytest.approx(np.array(wanted), abs=1e-9)


def test_order_of_people_is_shuffled_in_every_view() -> None:
    recording = simulate(SceneSettings(scene="crossing", seconds=20, people=2, detector=PERFECT), 0)
    assert recording.truth is not None
    firsts = []
    for slot in range(recording.num_slots):
        view = recording.view(slot, 0)
        assert view is not None
        if len(view) == 2:
            pixels = recording.rig.cameras[0].project(recording.truth.joints_m[slot, 0])
            firsts.append(bool(np.nanmax(np.abs(view.keypoints_px[0] - pixels)) < 1e-6))
    assert 0.35 < np.mean(firsts) < 0.65
    assert 0.35 < np.mean(np.diff(np.array(firsts).astype(int)) != 0) < 0.65


def test_seed_reproduces_another_differs_and_none_is_negative() -> None:
    settings = SceneSettings(seconds=2, people=3)
    assert same(simulate(settings, 4), simulate(settings, 4))
    assert not same(simulate(settings, 4), simulate(settings, 5))
    with pytest.raises(InputError, match="seed: found -1"):
        simulate(SceneSettings(seconds=1), -1)


def test_lives_do_not_depend_on_cameras_detectors_or_frame_rate() -> None:
    truths = []
    for settings in (
        SceneSettings(seconds=10, fps=25, cameras=5),
        SceneSettings(seconds=10, fps=12.5, cameras=3, detector=PERFECT),
    ):
        recording = simulate(settings, 2)
        assert recording.truth is not None
        truths.append(recording.truth.joints_m)
    assert np.array_equal(truths[0][::2], truths[1], equal_nan=True)


def test_noise_of_one_kind_leaves_the_others_as_they_are() -> None:
    quiet = simulate(SceneSettings(seconds=6, detector=DetectorSettings(ghosts=0, noise=0)), 1)
    noisy = simulate(SceneSettings(seconds=6, detector=DetectorSettings(ghosts=0, noise=0.1)), 1)
    for a, b in zip(quiet.views, noisy.views, strict=True):
        assert len(a.scores) == pytest.approx(len(b.scores), abs=3)
        assert np.median(a.scores) == pytest.approx(np.median(b.scores), abs=0.01)


@each_case(
    "people, seconds, fps, slots",
    [(0, 2, 25, 50), (12, 1, 25, 25), (1, 0.04, 25, 1), (2, 20, 0.5, 10)],
)
def test_any_number_of_people_and_slots(
    people: int, seconds: float, fps: float, slots: int
) -> None:
    recording = simulate(SceneSettings(seconds=seconds, fps=fps, people=people), 0)
    assert recording.truth is not None
    assert recording.truth.joints_m.shape == (slots, people, 17, 3)


def test_progress_rises_to_one() -> None:
    shares: list[float] = []
    simulate(SceneSettings(seconds=10), 0, shares.append)
    assert shares == sorted(shares) and shares[-1] == pytest.approx(1) and len(shares) > 5


def far_rig() -> Rig:
    """Three cameras on one side, looking at the floor around (40, -20)."""
    middle, size = np.array([40.0, -20.0, 1.0]), (1280, 720)
    cameras = []
    for index, angle in enumerate((0.2, 1.2, 2.0)):
        ring = ring_rig(1, 6.0, 2.5, size, np.random.default_rng(0)).cameras[0]
        turn = np.eye(4)
        turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        turn[:2, 3] = middle[:2]
        distortion = np.array([-0.1, 0.02, 0.0, 0.0, 0.0])
        cameras.append(Camera(f"own{index}", size, ring.K, turn @ ring.T_world_camera, distortion))
    return Rig(tuple(cameras))


def test_people_walk_where_a_users_cameras_look() -> None:
    rig = far_rig()
    centre, area = watched_area(rig)
    assert centre == pytest.approx([40.0, -20.0], abs=0.5) and 2 < area < 4
    recording = simulate(SceneSettings(rig=rig, seconds=20, detector=PERFECT), 0)
    assert recording.rig.camera_ids == ("own0", "own1", "own2")
    assert recording.truth is not None
    joints = recording.truth.joints_m
    seen = np.mean(
        [camera.sees(joints)[np.isfinite(joints[..., 0])].mean() for camera in rig.cameras]
    )
    assert seen > 0.8


def test_pillars_hide_people() -> None:
    clear = DetectorSettings(
        noise=0, joint_miss=0, self_occluded_miss=0, behind_head_miss=0, person_miss=0, swap=0,
        merge=0, ghosts=0, occluded_miss=1.0,
    )  # fmt: skip
    settings = SceneSettings(scene="pillar", people=1, seconds=20, fps=12.5, detector=clear)
    recording = simulate(settings, 3)
    assert recording.truth is not None
    joints = recording.truth.joints_m
    things = SCENES["pillar"].occluders
    hidden_keypoints = 0
    for camera, series in zip(recording.rig.cameras, recording.views, strict=True):
        for slot in range(recording.num_slots):
            view = series.view(slot)
            assert view is not None
            ends = joints[slot, 0]
            start = np.broadcast_to(camera.center_m, ends.shape)
            hidden = np.any([thing.blocks(start, ends) for thing in things], axis=0)
            hidden_keypoints += int(hidden.sum())
            if len(view):
                assert not (view.scores[0, hidden] > 0).any()
    assert hidden_keypoints > 1000


@each_case(
    ("options", "message"),
    [
        ({"scene": "moon"}, "scene: found 'moon', expected one of ring"),
        ({"people": -1}, "people: found -1"),
        ({"people": 1000}, "people: found 1000"),
        ({"people": 1.5}, "people: found 1.5, expected a whole number"),
        ({"cameras": 0}, "cameras: found 0"),
        ({"fps": 0.0}, "fps: found 0"),
        ({"fps": float("nan")}, "fps: found nan"),
        ({"seconds": -3.0}, "seconds: found -3"),
        ({"seconds": float("inf")}, "seconds: found inf"),
        ({"seconds": 0.0}, "slots"),
        ({"seconds": 14400.0, "cameras": 64}, "slots x cameras x people"),
        ({"radius_m": 0.0}, "radius: found 0"),
        ({"height_m": -1.0}, "height: found -1"),
        ({"image_size": (0, 700)}, "image width: found 0"),
    ],
)
def test_bad_settings_are_named(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=r"^simulate: ") as caught:
        simulate(SceneSettings(**options), 0)  # type: ignore[arg-type]
    assert message in str(caught.value) and "\n" not in str(caught.value)


@each_case("name", ["noise", "swap", "merge", "ghosts", "joint_miss"])
@each_case("value", [-0.1, 1000.0, float("nan")])
def test_bad_detector_settings_are_named(name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"detector {name}: found"):
        DetectorSettings(**{name: value})  # type: ignore[arg-type]
