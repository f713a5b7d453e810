"""Films of simulated people, from which the detector `drawn` reads back what was drawn."""

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
from e3pose.recording import Recording, load_recording
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
