"""Table 1 has the row with semantic feedback where there are detections made with it; citations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.commands import run
from tests.lab.datasets.test_published import NOBODY, write_published

from e3pose.model.skeleton import COCO17, SHELF14, convert
from e3pose.simulate import SceneSettings, simulate
from e3pose.simulate.films import frames
from e3pose_lab.reproduce.items.base import Scale
from e3pose_lab.reproduce.items.shelf_table import ACTORS, ROWS, SEMANTIC, pieces, section
from e3pose_lab.reproduce.replays import Run, replayed
from e3pose_lab.reproduce.sources import SHELF_FEEDBACK, load_sources


def made(piece: Any) -> Run:
    """Return figures of a replay that nobody ran; those with feedback are better."""
    average = 97.0 if piece.settings.recording == SHELF_FEEDBACK else 94.0
    pcp = {
        reading: dict.fromkeys(ACTORS, average + more)
        for reading, more in (("estimated", -2.0), ("shown", 0.0), ("skipped", 1.0))
    }
    return Run(pcp, {}, {}, 50.0, 1.0, (1.0,), 5.0, 0.1, 1.0, 1.0, 0, ((0,),))


@pytest.mark.parametrize("data", [("shelf",), ("shelf", SHELF_FEEDBACK)])
def test_row_is_measured_or_the_table_says_why_not(data: tuple[str, ...]) -> None:
    scale = Scale(quick=True, data=data)
    found = section(scale, made)  # type: ignore[arg-type]
    (row,) = [row for row in found.tables[0].rows if str(row[0]).startswith(SEMANTIC.name)]
    asked = [piece.settings for piece in pieces(scale)]
    if SHELF_FEEDBACK in data:
        assert SEMANTIC.asked in asked and getattr(row[3], "mean", None) == 97.0
    else:
        assert SEMANTIC.asked not in asked and row[3] is None
        assert "not measured" in str(row[0]) and "images of Shelf" in found.how


def test_every_row_says_what_found_its_keypoints() -> None:
    found = section(Scale(quick=True, data=("shelf", SHELF_FEEDBACK)), made)  # type: ignore[arg-type]
    table = found.tables[0]
    column = table.columns.index("2D detector")
    named = {str(row[0]): str(row[column]) for row in table.rows}
    assert all(len(row) == len(table.columns) for row in table.rows) and all(named.values())
    assert "Cascaded Pyramid" in named["CVPR 2019, Dong et al. (published)"]
    assert named["RSS 2021, Bultmann and Behnke (published)"] == "not stated"


def test_three_readings_stand_side_by_side_and_actors_beside_the_papers() -> None:
    found = section(Scale(quick=True, data=("shelf",)), made)  # type: ignore[arg-type]
    readings, actors = found.tables
    (row,) = [row for row in readings.rows if row[0] == "E3Pose"]
    assert [getattr(cell, "mean", cell) for cell in row[2:6]] == [92.0, 94.0, 95.0, 97.1]
    (row,) = [row for row in actors.rows if row[0] == "RS: random"]
    assert [getattr(cell, "mean", cell) for cell in row[1:]] == [
        94.0, 95.8, 94.0, 83.2, 94.0, 95.5, 94.0, 91.5,
    ]  # fmt: skip
    assert "95.0 at V = 100" in found.ours


FIRST, SLOTS = 300, 14  # images and labels; the protocol of Shelf begins here


def publish(folder: Path) -> None:
    """Write drawn people as Shelf is published: labels, projection matrices, folders of images."""
    import cv2

    settings = SceneSettings("crossing", people=3, seconds=SLOTS / 25, fps=25, cameras=5)
    scene = simulate(settings, 701)
    assert scene.truth is not None and scene.num_slots == SLOTS
    joints_m = scene.truth.joints_m
    found = np.isfinite(joints_m).all(axis=-1).astype(float)
    labels_m, _ = convert(joints_m, found, COCO17, SHELF14)
    labels = [
        [NOBODY] * FIRST + [m if np.isfinite(m).all() else NOBODY for m in labels_m[:, actor]]
        for actor in range(labels_m.shape[1])
    ]
    write_published(folder, (camera.projection for camera in scene.rig.cameras), labels)
    for number in range(len(scene.rig)):
        for slot, image in enumerate(frames(scene, number)):
            path = folder / f"Camera{number}" / f"img_{FIRST + slot:06d}.jpg"
            assert cv2.imwrite(str(path), image[..., ::-1])


@pytest.mark.slow
def test_images_of_shelf_give_the_row_with_feedback(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    publish(Path("Shelf"))
    frames_asked = ("--frames", f"{FIRST}-{FIRST + SLOTS - 1}")
    images = sorted(Path("Shelf").glob("Camera*"))
    assert run("import", "shelf", "Shelf", "rig", *frames_asked) == 0
    looks = ("--fps", 25, "--calibration", "rig/calibration.toml", "--model", "drawn")
    for name, more in (("shelf", ()), (SHELF_FEEDBACK, ("--feedback",))):
        assert run("detect", *images, f"found-{name}", *looks, *more) == 0
        detections = ("--detections", f"found-{name}")
        assert run("import", "shelf", "Shelf", f"data/{name}", *frames_asked, *detections) == 0
    sources = load_sources(tmp_path / "data")
    assert sources.names[:2] == ("shelf", SHELF_FEEDBACK)
    runs = [replayed(sources, row.asked) for row in (SEMANTIC, ROWS[0])]
    found = [(run.cameras, run.recall, run.error_mm) for run in runs]
    assert all(c == 5 and r == 1.0 and mm < 36 for c, r, mm in found), found
    assert runs[1].average > 75 and abs(runs[0].average - runs[1].average) < 5
