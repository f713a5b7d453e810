"""Pictures beside the report's player: of the cameras that looked most, at the slots they show."""

from __future__ import annotations

import base64
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.cli.commands import run as verb
from tests.output.report.test_report import bare, record, recording

from e3pose.output.report import page as films
from e3pose.output.report.page import film, render
from e3pose.recording import load_recording

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("filmed") / "walk"
    asks = ("--people", 1, "--cameras", 2, "--seconds", 2, "--videos")
    assert verb("simulate", folder, *asks) == 0
    return folder


def test_pictures_are_of_the_cameras_that_looked_most(
    filmed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(films, "MOST_IMAGES", 20)
    source = load_recording(filmed)
    shown = [record(slot, selected=np.array([slot % 2 == 0, True])) for slot in range(40)]
    found = film(source, shown, filmed)
    assert found is not None
    assert found["cameras"] == list(reversed(source.rig.camera_ids))
    assert len(found["at"]) == 10 and found["at"][0] == 0 and found["at"][-1] == 39
    for pictures in found["jpeg"]:
        assert len(pictures) == len(found["at"])
        data = np.frombuffer(base64.b64decode(pictures[0]), np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_COLOR)
        assert image is not None and max(image.shape) == films.LONG_SIDE_PX


def test_page_shows_pictures_where_there_are_some(filmed: Path) -> None:
    source = load_recording(filmed)
    shown = [record(slot, selected=np.ones(2, dtype=bool)) for slot in range(10)]
    page = render(source, shown, bare(), folder=filmed)
    assert "<img id='film'" in page and '"jpeg":[["/9j/' in page
    nothing = render(recording(2), [record(0), record(1)], bare())
    assert "<img id='film'" not in nothing
    assert '<script type="application/json" id="film-data">null</script>' in nothing


def test_videos_that_are_gone_are_named_without_their_folder(filmed: Path) -> None:
    source = load_recording(filmed)
    name = source.rig.camera_ids[0]
    moved = replace(source, videos={name: "/srv/films/secret-place/gone.mp4"})
    shown = [record(slot, selected=np.ones(2, dtype=bool)) for slot in range(3)]
    found = film(moved, shown, filmed)
    assert found is not None and set(found) == {"why"}
    assert "secret-place" not in found["why"]
    assert "No pictures: " in render(moved, shown, bare(), folder=filmed)
