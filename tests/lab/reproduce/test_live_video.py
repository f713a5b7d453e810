"""The item on live video: what it says of figures, its pictures, and what it does without data."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from e3pose.detectors.focus import Part
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose_lab.reproduce import sources
from e3pose_lab.reproduce.clip_feedback import WAYS, WayFigures, WholeImages
from e3pose_lab.reproduce.draw import draw
from e3pose_lab.reproduce.items import Scale
from e3pose_lab.reproduce.items.live_video import ITEM
from e3pose_lab.reproduce.job import reproduce
from e3pose_lab.reproduce.live_video import LiveAsked, LiveFigures, OverImage
from e3pose_lab.reproduce.sources import Sources
from e3pose_lab.workers import Workers


def jpeg() -> str:
    """Return a red image of 64 x 32 pixels."""
    coded: Any = cv2.imencode(".jpg", np.full((32, 64, 3), (0, 0, 255), np.uint8))
    return base64.b64encode(coded[1].tobytes()).decode()


def made(piece: Any) -> Any:
    """Return figures in which selection saves a quarter of the cameras' work."""
    if not isinstance(piece.settings, LiveAsked):
        ways = zip(WAYS, (40.0, 46.0, 43.0), strict=True)
        return {way: WayFigures(200.0, {"openpose-thin": mm}, 1.0) for way, mm in ways}
    saving = piece.settings.policy == "e3pose"
    views = [OverImage("cam1", jpeg(), (640, 320), [[[10.0, 20.0, 30.0, 40.0]]])]
    return LiveFigures(
        0.6 if saving else 0.8, 0.03, 3.0 if saving else 4.0, 3.0, 2.0, views * saving
    )


def test_saving_and_errors_are_said_and_every_view_is_shown(tmp_path: Path) -> None:
    section = ITEM.section(Scale(quick=True), made)  # type: ignore[arg-type]
    assert "25 % less" in section.ours
    assert "40 mm, 46 mm and 43 mm" in section.ours
    assert "does not lower the error (+3.0 mm)" in section.ours
    assert [panel.name for panel in section.panels] == ["live-video-cam1", "live-video-cpu"]
    assert [headline.value for headline in section.headlines] == [pytest.approx(25)]
    draw(section.panels[0], tmp_path / "view.svg")
    assert "<image" in (tmp_path / "view.svg").read_text()


def test_without_videos_or_network_it_says_how_to_get_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sources, "find_clip", lambda: None)
    monkeypatch.setattr(sources, "is_installed", lambda name: False)
    outcome = reproduce(tmp_path, Sources(), Workers(), quick=True, items=[ITEM])
    ((title, why),) = outcome.skipped
    assert title == "Live video" and not outcome.failed
    assert "`e3pose demo`" in why and "`e3pose models pull openpose-thin`" in why


def test_feedback_in_whole_images_looks_at_all_of_them() -> None:
    class Network:
        skeleton, person_px, long_side, multiple = COCO17, 200.0, 432, 16

        def detect(self, image: Any) -> Poses2D:
            raise AssertionError("nobody was expected")

        def detect_part(self, image: Any, part: Part, expected: ExpectedView | None) -> Poses2D:
            assert part == Part(0, 0, 64, 32, 432) and expected is somebody
            return Poses2D.empty(17)

    somebody = ExpectedView(np.zeros((1, 17, 2)), np.ones(1))
    image = np.zeros((32, 64, 3), np.uint8)
    WholeImages(Network()).detect_part(image, Part(5, 5, 10, 10, 160), somebody)
