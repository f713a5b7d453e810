"""Films of simulated people and their feet; the detector `drawn` reads back what was drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.simulate.filmed import film

from e3pose.base.errors import InputError
from e3pose.camera.source import open_video
from e3pose.detectors import make_detector
from e3pose.detectors.drawn import draw
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17, convert
from e3pose.recording import Recording, load_recording
from e3pose.simulate import SceneSettings, simulate
from e3pose.simulate.feet import FOOT_M, with_skeleton
from e3pose.simulate.films import check_people, frames, room

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return film(tmp_path_factory.mktemp("films") / "films", cameras=2, seconds=1, seed=701)


@pytest.fixture(scope="module")
def recording(films: Path) -> Recording:
    return load_recording(films)


def nearest(view: Poses2D, keypoints_px: np.ndarray) -> float:
    """Return the median distance of keypoints from those of the nearest person of a view."""
    off = np.linalg.norm(view.keypoints_px - keypoints_px, axis=-1)
    return float(min(np.nanmedian(one) for one in off if np.isfinite(one).any()))


def test_detector_finds_in_the_film_what_was_drawn(films: Path, recording: Recording) -> None:
    detector = make_detector("drawn")
    assert set(recording.videos) == {"cam0", "cam1"}
    people = 0
    for index, name in enumerate(recording.videos.values()):
        for frame in open_video(films / "videos" / name).frames():
            view = recording.view(frame.index, index)
            found = detector.detect(frame.image)
            assert view is not None and len(found) <= max(len(view), 2)
            for keypoints_px in found.keypoints_px:
                assert nearest(view, keypoints_px) < 1.5
            people += len(found)
    assert people > 25  # of 40


def test_joints_of_up_to_three_people_are_distinguished() -> None:
    xs, ys = np.meshgrid(np.arange(17) * 36.0 + 20, [40.0, 120.0, 200.0])
    people = list(np.stack([xs, ys], axis=-1))
    empty = np.full((240, 640, 3), 24, dtype=np.uint8)
    found = make_detector("drawn").detect(draw(empty, people))
    assert len(found) == 3
    assert np.abs(found.keypoints_px - np.array(people)).max() < 0.6
    assert len(make_detector("drawn").detect(empty)) == 0


def test_film_says_that_it_is_simulated(recording: Recording) -> None:
    image = next(frames(recording, 0))
    assert image.shape == (480, 640, 3)
    corner = room(recording.rig.cameras[0])[:30, :200]
    assert (corner > 120).any() and (image[:30, :200] == corner).all()


@pytest.mark.parametrize("people", [4, -1])
def test_more_people_than_shades_are_refused(people: int) -> None:
    with pytest.raises(InputError, match="at most 3: --people 2"):
        check_people(people)


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
