from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run

from e3pose.model.camera import Camera, Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording, ViewSeries, save_recording


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two cameras side by side; one sees a person in all three slots, one loses the last view."""
    K = [[900, 0, 640], [0, 900, 360], [0, 0, 1]]
    R = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    cameras = tuple(
        Camera.from_world_to_camera(name, (1280, 720), K, R, [0.5 * n, 1.0, 3])
        for n, name in enumerate(("left", "right"))
    )
    person = Poses2D(np.full((1, 17, 2), 300.0), np.full((1, 17), 0.75))
    views = (
        ViewSeries.from_views([person] * 3, range(3), [0.0, 0.1, 0.2], 17),
        ViewSeries.from_views([Poses2D.empty(17)] * 2, range(2), [0.0, 0.1], 17),
    )
    recording = Recording("a [bold]test[/bold]", Rig(cameras), 10, 3, COCO17, views)
    save_recording(recording, tmp_path / "rec")
    return tmp_path / "rec"


def test_tables_say_what_is_there_and_what_is_wrong(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("info", folder) == 0
    lines = capsys.readouterr().out.splitlines()
    text = "\n".join(lines)
    assert "a [bold]test[/bold]" in text
    assert "3 slots at 10 fps, 0.30 s" in text
    left = next(line.split() for line in lines if line.startswith("left"))
    assert left == ["left", "1280", "x", "720", "none", "0.00", "-3.00", "1.00", "3", "0",
                    "1.00", "1", "0.0%", "0.75", "-"]  # fmt: skip
    assert "2 problems:" in text
    assert "  right: 1 of 3 views are lost in 1 gap; the longest is slots 2 to 2" in lines
    assert "  right: detects nobody in any of its views" in lines


def test_json_holds_the_same(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("info", folder, "--json", "-") == 0
    content = json.loads(capsys.readouterr().out)
    assert content["num_slots"] == 3
    assert [camera["lost"] for camera in content["cameras"]] == [0, 1]
    assert content["cameras"][1]["median_score"] is None
    assert content["truth"] is None
    kinds = [(problem["kind"], problem["where"]) for problem in content["problems"]]
    assert kinds == [("lost-views", "right"), ("sees-nobody", "right")]
