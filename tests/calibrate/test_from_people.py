"""Cameras placed by people alone, all or one of them, the floor, and the films' shifts in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.calibrate.people_scenes import (
    distances,
    disturbed,
    every,
    knocked,
    standing,
    walk,
    without_calibration,
)
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.calibrate import from_people as from_people_module
from e3pose.calibrate import moved_cameras
from e3pose.calibrate.from_people import (
    FOCALS,
    NOISE_FACTORS,
    CameraFit,
    Progress,
    _finish,
    _rounds,
    _Scene,
    disagreeing,
    silent,
    solve_people,
)
from e3pose.calibrate.judge import judge
from e3pose.calibrate.matched_people import Joints, observe_people
from e3pose.calibrate.people_places import _check_far, _too_wild, from_people, place_one
from e3pose.calibrate.places import KnownLength
from e3pose.calibrate.recordings import first_seconds, last_seconds
from e3pose.calibrate.resection import PlacedPerson, resect
from e3pose.calibrate.same_people import Seen
from e3pose.calibrate.synchronise import synchronise, with_offsets
from e3pose.calibrate.tracklets import Tracklet, find_tracklets
from e3pose.model.camera import Rig
from e3pose.model.noises import detector_of, load_noise
from e3pose.model.rotations import angles_between
from e3pose.recording.record import Recording, ViewSeries

pytestmark = pytest.mark.slow

NOISE = load_noise("simulated")


@pytest.fixture(scope="module")
def two() -> Recording:
    return walk(731, people=2, fps=5.0)


def test_rough_start_is_refined_and_keeps_its_world(two: Recording) -> None:
    start = disturbed(two.rig, 5.0, 0.2, 1)
    found = from_people(two, NOISE, start, KnownLength(), silent)
    degrees, millimetres, _ = distances(found.rig, two.rig)
    assert degrees < 0.3 and millimetres < 30
    assert np.linalg.norm(found.rig.centers_m - two.rig.centers_m, axis=1).max() < 0.3


def test_a_rig_that_only_wild_keypoints_fit_is_refused_unless_forced(two: Recording) -> None:
    found = solve_people(first_seconds(two, 8.0), NOISE, two.rig)
    assert 0.005 < found.error < 0.03 and found.explains and not _too_wild(found, force=False)
    wild = replace(found, error=0.09)
    assert not wild.explains
    with pytest.raises(InputError, match=r"off by 9 % of people's size .* at most 5 %"):
        _too_wild(wild, force=False)
    assert "may be far off" in _too_wild(wild, force=True)[0]


def test_size_of_errors_is_told_by_the_longer_side_of_a_person() -> None:
    pixels = np.full((2, 6, 2), np.nan)
    pixels[0, :3] = [[10, 10], [30, 10], [20, 110]]  # 100 px tall
    pixels[1, 3:] = [[0, 0], [200, 50], [100, 50]]  # 200 px wide
    none = np.zeros(6, dtype=np.int64)
    joints = Joints(pixels, np.full((2, 6), 4.0), none, none, none)
    assert joints.share_of_size(3) == pytest.approx(0.03)  # of 4 % and 2 %
    assert np.isnan(Joints(pixels * np.nan, joints.sigma_px, none, none, none).share_of_size(3))


def test_good_rig_is_found_good_and_a_moved_camera_is_named(two: Recording) -> None:
    good = judge(two, NOISE)
    assert good.errors.expected_deg.max() < 0.5 and good.errors.expected_mm.max() < 50
    assert 5 < np.nanmedian(good.room.total_mm) < 40
    moved = disturbed(two.rig, 1.5, 0.0, 2).cameras[2]
    cameras = [moved if i == 2 else camera for i, camera in enumerate(two.rig.cameras)]
    bad = judge(replace(two, rig=Rig(tuple(cameras))), NOISE)
    assert bad.errors_px[2] > 1.5 * good.errors_px[2]
    (said,) = (words for words in bad.next_steps if "was moved" in words)
    assert said.startswith("cam2 is off by") and "--only cam2" in said
    assert np.nanmedian(bad.room.calibration_mm) > 3 * np.nanmedian(good.room.calibration_mm)


@pytest.mark.nightly
def test_result_does_not_depend_on_the_declared_noise(two: Recording) -> None:
    usual = solve_people(two, NOISE, None)
    degrees, millimetres, _ = distances(usual.solved.adjusted.rig, two.rig)
    assert degrees < 0.3 and millimetres < 30
    other = solve_people(two, replace(NOISE, sigma_px=4.0 * NOISE.sigma_px), None)
    apart = distances(other.solved.adjusted.rig, usual.solved.adjusted.rig)
    assert apart[0] < 1e-3 and apart[1] < 0.1
    assert other.noise == pytest.approx(usual.noise / 4.0, rel=1e-3)


def test_people_of_whom_one_joint_is_sure_have_no_size_and_place_nobody() -> None:
    short = walk(9, seconds=4.0)
    hip = np.arange(len(short.skeleton)) == short.skeleton.index("left_hip")
    views = tuple(replace(v, scores=np.where(hip, v.scores, 0.01)) for v in short.views)
    with pytest.raises(InputError, match="no two cameras agree"):
        solve_people(replace(short, views=views), NOISE, None)


@pytest.mark.parametrize("known", [True, False])
def test_unknown_lenses_begin_from_two_focal_lengths(
    two: Recording, known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = list[float]()

    def nothing_agrees(scene: _Scene, _progress: Progress) -> None:
        camera = scene.rig.cameras[0]
        begun.append(camera.K[0, 0] / max(camera.image_size))

    monkeypatch.setattr(from_people_module, "_from_nothing", nothing_agrees)
    with pytest.raises(InputError, match="no two cameras agree"):
        solve_people(two if known else without_calibration(two), NOISE, None)
    camera = two.rig.cameras[0]
    own = [camera.K[0, 0] / max(camera.image_size)] * len(NOISE_FACTORS)
    np.testing.assert_allclose(begun, own if known else [*FOCALS] * len(NOISE_FACTORS))


def test_two_unknown_lenses_are_refused(two: Recording) -> None:
    pair = replace(two, rig=two.rig.subset([0, 1]), views=two.views[:2])
    with pytest.raises(InputError, match="found two with unknown lenses"):
        from_people(without_calibration(pair), NOISE, None, KnownLength(), silent)


@pytest.mark.parametrize("lenses", ["known", pytest.param("unknown", marks=pytest.mark.nightly)])
def test_somebody_who_stands_in_place_is_warned_of(lenses: str) -> None:
    still = standing(734)
    recording = still if lenses == "known" else without_calibration(still)
    found = from_people(recording, load_noise(detector_of(still)), None, KnownLength(1.72), silent)
    assert any("the result may be far off" in words for words in found.notes)
    assert found.expected is not None
    degrees, millimetres = moved_cameras.distances(found.rig, still.rig)
    assert (degrees < 2 * found.expected.expected_deg).all()
    assert (millimetres < 2 * found.expected.expected_mm).all()


def test_camera_that_ends_kilometres_away_is_named(two: Recording) -> None:
    cameras = list(two.rig.cameras)
    T_world_camera = cameras[1].T_world_camera.copy()
    T_world_camera[0, 3] = 900.0
    cameras[1] = replace(cameras[1], T_world_camera=T_world_camera)
    with pytest.raises(InputError, match=r"cameras: cam1: people would put it \d+ m from the"):
        _check_far(Rig(tuple(cameras)), 8.0)
    _check_far(two.rig, 8.0)


def test_camera_that_disagrees_is_refused_unless_forced(two: Recording) -> None:
    poor = np.array([False, True, False, False])
    fit = CameraFit(np.where(poor, 0.4, 0.02), np.where(poor, 3.0, 1.0), 1.0, poor)
    with pytest.raises(InputError, match="cam1: 40 % of its keypoints disagree"):
        disagreeing(two.rig, fit, force=False)
    assert "cam1" in disagreeing(two.rig, fit, force=True)[0]


@pytest.mark.nightly
@pytest.mark.parametrize("lenses", ["known", "unknown"])
def test_camera_that_disagrees_is_placed_again_by_the_others(two: Recording, lenses: str) -> None:
    recording = two if lenses == "known" else without_calibration(two)
    scene = _Scene(recording, NOISE, observe_people(recording, NOISE), 1.0)
    good = solve_people(two, NOISE, two.rig).solved.adjusted.rig
    cameras = list(good.cameras)
    if lenses == "unknown":
        cameras = [replace(camera, lens_assumed=True) for camera in cameras]
        cameras[2] = replace(cameras[2], K=cameras[2].K * [[1.5, 1, 1], [1, 1.5, 1], [1, 1, 1]])
    cameras[2] = disturbed(Rig((cameras[2],)), 60.0, 1.0, 3).cameras[0]
    scene, everyone = scene.with_rig(Rig(tuple(cameras))), np.ones(4, dtype=bool)
    without = _rounds(scene, everyone, silent)
    assert without is not None and without.fit.poor[2]  # else there is nothing to mend
    found = _finish(scene, everyone, silent)
    assert found is not None and not found.fit.poor.any()
    degrees, millimetres, _ = distances(found.solved.adjusted.rig, two.rig)
    assert degrees < 0.5 and millimetres < 50


def test_nobody_is_an_error(two: Recording) -> None:
    empty = replace(two.views[1], scores=np.zeros_like(two.views[1].scores))
    views = (two.views[0], empty, *two.views[2:])
    with pytest.raises(InputError, match="cameras: cam1: found no track"):
        from_people(replace(two, views=views), NOISE, None, KnownLength(), silent)


@pytest.mark.parametrize("calibrated", [True, pytest.param(False, marks=pytest.mark.nightly)])
def test_films_are_brought_into_step_to_a_quarter_frame(calibrated: bool) -> None:
    begins = (0, 5, 11, 2)
    fast = walk(732, people=1, seconds=25.0, fps=48.0)
    films = every(fast, 4, begins)
    if not calibrated:
        films = without_calibration(films)
    found = synchronise(films, NOISE, 2.0)
    error_s = found.offsets_s - np.array(begins) / fast.fps
    assert np.abs(error_s * films.fps).max() < 0.25
    together = with_offsets(films, found.offsets_s)
    assert together.views[2].slots[0] == 3  # 11 of 48 seconds are 2.75 slots
    assert together.views[0].slots[0] == 0


@pytest.mark.parametrize("share", [1.0, 0.25])
def test_people_are_followed_through_the_gaps_of_a_seldom_active_camera(share: float) -> None:
    calm = walk(701, people=2)
    series = seldom(calm.views[2], share)
    found = find_tracklets(2, series, calm.fps)
    assert sum(map(len, found)) > 0.7 * len(series.scores)


def seldom(series: ViewSeries, share: float) -> ViewSeries:
    """Return a share of what a camera saw, each view at its own time."""
    kept = np.random.default_rng(0).random(len(series.slots)) < share
    slots, times_s = series.slots[kept].tolist(), series.times_s[kept].tolist()
    views = [view for view in map(series.view, slots) if view is not None]
    return ViewSeries.from_views(views, slots, times_s, 17)


@pytest.fixture(scope="module")
def calm() -> Recording:
    return walk(701, people=2, seconds=12.0, fps=5.0)


def test_knocked_camera_is_put_right_and_the_others_stay(calm: Recording) -> None:
    recording = knocked(calm, 2, 5.0, 701, 0.0)
    found = place_one(recording, NOISE, calm.rig, "cam2")
    assert found.degrees == pytest.approx(5.0, abs=0.3)
    assert found.metres < 0.04 and found.inliers > 0.9 and found.error_px < 8
    for i in (0, 1, 3):
        assert np.array_equal(
            found.rig.cameras[i].T_world_camera, calm.rig.cameras[i].T_world_camera
        )
    again = place_one(recording, NOISE, found.rig, "cam2")
    assert again.degrees < 0.1
    turned = angles_between(found.rig.cameras[2].R[None], calm.rig.cameras[2].R[None])
    assert np.degrees(turned[0]) == pytest.approx(found.degrees)


def test_too_little_to_place_it_by_is_an_error(calm: Recording) -> None:
    with pytest.raises(InputError, match="camera cam1: shares"):
        place_one(first_seconds(calm, 0.5), NOISE, calm.rig, "cam1")
    with pytest.raises(InputError, match="cam9"):
        place_one(calm, NOISE, calm.rig, "cam9")


def test_last_seconds_are_the_end(calm: Recording) -> None:
    end = last_seconds(calm, 5.0)
    assert end.num_slots == 25 and end.views[0].slots[0] == 0
    assert np.array_equal(
        end.views[0].keypoints_px[-1], calm.views[0].keypoints_px[-1], equal_nan=True
    )


@each_case("inliers", [6, 19, 60])
def test_few_joints_among_wild_ones_place_no_camera(inliers: int) -> None:
    rng, slots = np.random.default_rng(3), np.arange(60)
    joints = rng.uniform((-1, -1, 3), (1, 1, 6), (60, 1, 3))
    ideal = joints[..., :2] / joints[..., 2:] + rng.normal(0, 0.002, (60, 1, 2))
    ideal[inliers:] = rng.uniform(-0.4, 0.4, (60 - inliers, 1, 2))
    seen = Seen([Tracklet(0, slots, slots)], [ideal], [np.full((60, 1), 0.003)])
    found = resect(seen, 0, [PlacedPerson(slots, joints)])
    assert (found is not None) == (inliers == 60)
