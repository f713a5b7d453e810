"""A recording without truth is found, and its replays are compared with the smoother."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from e3pose.evaluate.figures import HeldOutCamera
from e3pose.recording import Recording, save_recording
from e3pose.simulate import SceneSettings, simulate
from e3pose_lab.reproduce.items.base import Scale
from e3pose_lab.reproduce.items.pizza_table import ROWS, pieces, section
from e3pose_lab.reproduce.replays import PIZZA, Asked
from e3pose_lab.reproduce.sources import Sources, load_sources
from e3pose_lab.reproduce.without_truth import (
    JOINTS,
    LIMITS,
    HeldOutAsked,
    Likeness,
    likeness,
    outside,
    smoothed_people,
)
from e3pose_lab.reproduce.work import AnyPiece


@pytest.fixture(scope="module")
def scene() -> Recording:
    return simulate(SceneSettings("ring", people=2, seconds=4.0, fps=12.5, cameras=4), 701)


def test_smoother_is_near_the_truth(scene: Recording) -> None:
    assert scene.truth is not None
    found = smoothed_people(replace(scene, truth=None))
    true = scene.truth.joints_m[:, :, JOINTS]
    apart = np.linalg.norm(found[:, :, None] - true[:, None], axis=-1).mean(axis=-1)
    late = apart[20:]  # everybody is there by now
    assert np.nanmean(np.nanmin(late, axis=2)) < 0.05
    assert np.isfinite(found[20:]).all(axis=(2, 3)).sum(axis=1).min() >= 2


def test_fewer_cameras_find_fewer_people(scene: Recording) -> None:
    sources = Sources(pizza=replace(scene, truth=None), stamp="scene")
    every, two = (
        likeness(sources, Asked(PIZZA, p, cameras=c)) for p, c in (("all", 4), ("random", 2))
    )
    assert every.cameras == 4 and two.cameras == 2
    assert every.found["150"] > 90 and every.mpjpe_mm < two.mpjpe_mm < 150
    assert two.found["50"] < every.found["50"] and two.recall < every.recall
    for run in (every, two):
        shares = [run.found[limit] for limit in LIMITS]
        assert shares == sorted(shares) and shares[-1] <= run.recall <= 100
        assert 0 <= run.more < 100


def test_camera_that_is_held_out_judges_the_others(scene: Recording) -> None:
    sources = Sources(pizza=replace(scene, truth=None), stamp="scene")
    every = outside(sources, HeldOutAsked(Asked(PIZZA, "all"), 1))
    assert every.missed_percent is not None and every.missed_percent < 20
    assert every.median_px is not None and every.mean_px is not None and every.mean_mm is not None
    assert every.median_px < every.mean_px
    two = outside(sources, HeldOutAsked(Asked(PIZZA, "random", cameras=2), 1))
    assert two.mean_mm is not None and 5 < every.mean_mm < two.mean_mm < 200


def test_recording_is_found_and_known_by_its_keypoints(tmp_path: Path, scene: Recording) -> None:
    assert PIZZA not in load_sources(tmp_path).names
    folder = tmp_path / "pizza" / "recording"
    save_recording(scene, folder)
    sources = load_sources(tmp_path)
    assert PIZZA in sources.names and sources.pizza is not None
    (file, *_) = sorted((folder / "keypoints").iterdir())
    file.write_bytes(file.read_bytes() + b"\n")
    assert load_sources(tmp_path).stamp != sources.stamp


def test_table_has_the_papers_rows_beside_ours() -> None:
    def made(piece: AnyPiece) -> Likeness | HeldOutCamera:
        if piece.function is outside:
            return HeldOutCamera(90, 20.0, 15.0, 40.0, 30.0, missed_percent=1.0)
        shares = dict(zip(LIMITS, (20.0, 50.0, 80.0, 90.0), strict=True))
        return Likeness(shares, shares, 50.0, 95.0, 2.0, 3.0)

    scale = Scale(quick=True, data=(PIZZA,))
    found = section(scale, made)  # type: ignore[arg-type]
    held_out, table = found.tables
    assert len(table.rows) == 5 + len(ROWS) and len(held_out.rows) == len(ROWS)
    assert len(pieces(scale)) == 2 * len(ROWS)
    assert all(len(row) == len(each.columns) for each in found.tables for row in each.rows)
    assert [headline.apart for headline in found.headlines] == [
        pytest.approx(50.0 - 93.3), pytest.approx(50.0 - 98.6),
    ]  # fmt: skip
