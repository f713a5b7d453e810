"""Table 1 has the row with semantic feedback where there are detections made with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from e3pose.recording import load_recording, save_recording
from e3pose.reproduce.items.base import Scale
from e3pose.reproduce.items.shelf_table import SEMANTIC, pieces, section
from e3pose.reproduce.replays import Run, recording_of
from e3pose.reproduce.sources import TOLD, load_sources
from e3pose.simulate import SceneSettings, simulate


def made(piece: Any) -> Run:
    """Return figures of a replay that nobody ran; those with feedback are better."""
    average = 97.0 if piece.settings.recording == TOLD else 94.0
    pcp = {"actor1": average, "actor2": average, "actor3": average, "average": average}
    return Run(pcp, {}, 50.0, 1.0, (1.0,), 5.0, 0.1, 1.0, 1.0, 0, ((0,),))


@pytest.mark.parametrize("data", [("shelf",), ("shelf", TOLD)])
def test_row_is_measured_or_the_table_says_why_not(data: tuple[str, ...]) -> None:
    scale = Scale(quick=True, data=data)
    found = section(scale, made)  # type: ignore[arg-type]
    (row,) = [row for row in found.tables[0].rows if str(row[0]).startswith(SEMANTIC.name)]
    asked = [piece.settings for piece in pieces(scale)]
    if TOLD in data:
        assert SEMANTIC.asked in asked and getattr(row[5], "mean", None) == 97.0
    else:
        assert SEMANTIC.asked not in asked and row[5] is None
        assert "not measured" in str(row[0]) and "images of Shelf" in found.how


def test_detections_with_feedback_are_read_where_they_are(tmp_path: Path) -> None:
    assert TOLD not in load_sources(tmp_path).names
    scene = simulate(SceneSettings("ring", people=1, seconds=0.4, fps=10, cameras=2), 701)
    save_recording(scene, tmp_path / TOLD)
    sources = load_sources(tmp_path)
    assert sources.names == (TOLD,)
    assert recording_of(sources, SEMANTIC.asked).num_slots == scene.num_slots
    assert load_recording(tmp_path / TOLD).num_slots == scene.num_slots
