from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case

from e3pose.model.camera import Camera, Rig
from e3pose.recording import Recording, Truth, ViewSeries
from e3pose.recording.description import describe
from e3pose.recording.problems import epipolar_distances_px, find_problems, truth_distances_px

Change = Callable[[Recording], Recording]


def _found(recording: Recording) -> set[tuple[str, str]]:
    return {(problem.kind, problem.where) for problem in find_problems(recording)}


def _with_series(recording: Recording, camera: int, series: ViewSeries) -> Recording:
    views = list(recording.views)
    views[camera] = series
    return replace(recording, views=tuple(views))


def _with_camera(recording: Recording, index: int, camera: Camera) -> Recording:
    cameras = list(recording.rig.cameras)
    cameras[index] = camera
    return replace(recording, rig=Rig(tuple(cameras)))


def _keeping(series: ViewSeries, slots: NDArray[np.int64]) -> ViewSeries:
    views = [series.view(int(slot)) for slot in slots]
    return ViewSeries.from_views([v for v in views if v is not None], slots.tolist(),
                                 series.times_s[slots].tolist(), 17)  # fmt: skip


def test_nothing_is_wrong_with_an_exact_scene(scene: Recording) -> None:
    assert find_problems(scene) == []
    assert np.nanmax(epipolar_distances_px(scene)) < 1e-6
    assert truth_distances_px(scene).max() < 1e-6


def test_lost_views_are_counted_and_the_longest_gap_is_placed(scene: Recording) -> None:
    slots = np.setdiff1d(np.arange(40), [3, 10, 11, 12])
    recording = _with_series(scene, 2, _keeping(scene.views[2], slots))
    (problem,) = find_problems(recording)
    assert (problem.kind, problem.where) == ("lost-views", "cam2")
    assert problem.message.startswith("4 of 40 views are lost in 2 gaps")
    assert problem.message.endswith("slots 10 to 12")


def test_views_lost_at_the_end_are_a_gap_too(scene: Recording) -> None:
    recording = _with_series(scene, 0, _keeping(scene.views[0], np.arange(30)))
    (problem,) = find_problems(recording)
    assert problem.message.endswith("slots 30 to 39")


def _no_views(recording: Recording) -> Recording:
    return _with_series(recording, 1, ViewSeries.from_views([], [], [], 17))


def _nobody(recording: Recording) -> Recording:
    series = recording.views[1]
    return _with_series(
        recording,
        1,
        replace(series, starts=np.zeros(41, dtype=np.int64), keypoints_px=np.zeros((0, 17, 2)),
                scores=np.zeros((0, 17))),
    )  # fmt: skip


def _times(change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Change:
    def apply(recording: Recording) -> Recording:
        series = recording.views[1]
        return _with_series(recording, 1, replace(series, times_s=change(series.times_s)))

    return apply


def _backwards(times_s: NDArray[np.float64]) -> NDArray[np.float64]:
    changed: NDArray[np.float64] = times_s.copy()
    changed[[5, 6]] = times_s[[6, 5]]
    return changed


def _scores(value: float, rows: slice) -> Change:
    def apply(recording: Recording) -> Recording:
        series = recording.views[1]
        scores = series.scores.copy()
        scores[rows] = value
        return _with_series(recording, 1, replace(series, scores=scores))

    return apply


def _twice(recording: Recording) -> Recording:
    return _with_series(recording, 1, recording.views[0])


def _camera(**changes: object) -> Change:
    def apply(recording: Recording) -> Recording:
        camera = recording.rig.cameras[1]
        return _with_camera(recording, 1, replace(camera, **changes))  # type: ignore[arg-type]

    return apply


def _longer_lens(recording: Recording) -> Recording:
    camera = recording.rig.cameras[1]
    K = camera.K * np.array([[1.5], [1.5], [1.0]])
    K[:2, 2] = camera.K[:2, 2]
    return _with_camera(recording, 1, replace(camera, K=K))


@each_case(
    ("change", "kind"),
    [
        (_no_views, "no-views"),
        (_nobody, "sees-nobody"),
        (_times(lambda t: t * 1.02), "rate"),
        (_times(lambda t: t + 0.4), "offset"),
        (_times(lambda t: t + 0.03 * np.resize([-1, 1], len(t))), "jitter"),
        (_times(_backwards), "time-order"),
        (_scores(1.0, slice(None)), "flat-scores"),
        (_scores(0.0, slice(7, 9)), "blank-people"),
        (_twice, "copied-views"),
        (_camera(image_size=(700, 500)), "outside-image"),
        (_longer_lens, "epipolar"),
    ],
)
def test_one_fault_is_named_with_its_camera_alone(
    scene: Recording, change: Change, kind: str
) -> None:
    found = _found(change(scene))
    assert (kind, "cam1") in found
    assert {where for _, where in found} == {"cam1"}


def test_swapped_cameras_are_named(scene: Recording) -> None:
    views = scene.views
    swapped = replace(scene, truth=None, views=(views[1], views[0], *views[2:]))
    assert {("epipolar", "cam0"), ("epipolar", "cam1")} <= _found(swapped)


def test_a_rig_that_is_upside_down_small_or_doubled(scene: Recording) -> None:
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    flipped = replace(
        scene,
        rig=Rig(
            tuple(replace(c, T_world_camera=flip @ c.T_world_camera) for c in scene.rig.cameras)
        ),
        truth=None,
    )
    assert _found(flipped) == {("not-z-up", "rig")}
    shrunk = []
    for camera in scene.rig.cameras:
        T_world_camera = camera.T_world_camera.copy()
        T_world_camera[:3, 3] *= 0.01
        shrunk.append(replace(camera, T_world_camera=T_world_camera))
    assert ("rig-span", "rig") in _found(replace(scene, rig=Rig(tuple(shrunk)), truth=None))
    doubled = _with_camera(scene, 1, replace(scene.rig.cameras[0], camera_id="cam1"))
    assert ("same-place", "cam1") in _found(doubled)
    single = replace(scene, rig=scene.rig.subset([0]), views=scene.views[:1])
    assert _found(single) == {("one-camera", "rig")}


@pytest.mark.parametrize("change_m", [lambda x: x + [2.0, 0, 0], lambda x: x[:, :, :, [0, 2, 1]]])
def test_a_truth_in_another_frame_is_named(
    scene: Recording, change_m: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> None:
    assert scene.truth is not None
    truth = replace(scene.truth, joints_m=change_m(scene.truth.joints_m))
    assert "truth-off" in {kind for kind, _ in _found(replace(scene, truth=truth))}


def test_a_person_without_annotation_is_named(scene: Recording) -> None:
    assert scene.truth is not None
    joints_m = scene.truth.joints_m.copy()
    joints_m[:, 1] = np.nan
    truth = Truth(scene.truth.skeleton, scene.truth.person_ids, joints_m)
    (problem,) = find_problems(replace(scene, truth=truth))
    assert (problem.kind, problem.message) == ("no-truth", "bob is annotated in no slot")


def test_keypoints_just_outside_the_image_accuse_nobody(scene: Recording) -> None:
    series = scene.views[1]
    for px, told in ((4.9, False), (5.1, True)):
        places = np.where(np.isfinite(series.keypoints_px), -px, np.nan)
        found = _found(_with_series(scene, 1, replace(series, keypoints_px=places)))
        assert ("outside-image" in {kind for kind, _ in found}) == told


def test_an_empty_recording_says_so_and_nothing_else(scene: Recording) -> None:
    none = ViewSeries.from_views([], [], [], 17)
    empty = replace(scene, num_slots=0, truth=None, views=(none,) * 4)
    assert _found(empty) == {("empty", "recording")}
    assert describe(empty).cameras[0].mean_people is None


def test_a_video_that_is_not_there_is_named(scene: Recording, tmp_path: Path) -> None:
    (tmp_path / "videos").mkdir()
    (tmp_path / "videos" / "a.mp4").touch()
    recording = replace(scene, videos={"cam0": "a.mp4", "cam1": "b.mp4"})
    (problem,) = find_problems(recording, tmp_path)
    assert (problem.kind, problem.where) == ("missing-video", "cam1")


def test_description_counts_what_is_there(scene: Recording) -> None:
    series = scene.views[1]
    scores = series.scores.copy()
    scores[:, :5] = 0.0
    recording = _with_series(scene, 1, replace(_keeping(series, np.arange(38)), scores=scores[:76]))
    description = describe(recording)
    camera = description.cameras[1]
    assert (camera.frames, camera.lost, camera.max_people) == (38, 2, 2)
    assert camera.mean_people == 2.0
    assert camera.missing_keypoints == pytest.approx(5 / 17)
    assert camera.center_m == pytest.approx((4 * np.cos(1.6), 4 * np.sin(1.6), 2.0))
    assert description.duration_s == 2.0
    assert description.truth is not None
    assert description.truth.slots_of_person == {"ann": 40, "bob": 40}
