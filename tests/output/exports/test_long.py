"""Exports of long takes: what they hold does not grow by much, and their bones are the same."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.output.exports.takes import take

from e3pose.model.take import Motion, Take
from e3pose.output.exports import ExportSettings, bones, export, source, table
from e3pose.output.exports.bones import bones_of, stretches_of
from e3pose.output.exports.source import Asked, take_from_table

PERSON = 17 * (3 + 1 + 1) * 8 + 17  # bytes of a person in a slot: places, sigma, scores, origin
SIZES = ((table, "CHUNK", 50), (bones, "STRETCH", 50), (source, "BATCH", 999))


def long(repeats: int) -> Take:
    """Return somebody who does the same again and again."""
    one = take().motions[0]
    names = ("joints_m", "sigma_m", "scores", "origin")
    again = [np.concatenate([getattr(one, name)] * repeats) for name in names]
    return replace(take(), motions=(Motion(3, 0, *again),), started_ns=None)


def written(name: str, **settings: bool) -> Callable[[Take, Path], object]:
    return lambda walk, path: [
        *export(walk, path.with_suffix(f".{name}"), format_of(name), ExportSettings(**settings))  # type: ignore[arg-type]
    ]


def format_of(suffix: str) -> str:
    return {"glb": "gltf"}.get(suffix, suffix)


def read(walk: Take, path: Path) -> Take:
    return take_from_table(path.with_suffix(".parquet"), Asked())


@pytest.mark.parametrize(
    ("work", "people"),
    [
        (written("parquet"), 1.0), (written("csv", angles=True), 1.0), (written("c3d"), 1.0),
        (written("trc"), 4.0), (written("mot"), 4.0), (written("glb"), 4.0), (read, 1.5),
    ],
    ids=["table", "angles", "c3d", "trc", "mot", "glb", "read"],
)  # fmt: skip
def test_a_slot_more_takes_few_times_its_poses(
    work: Callable[[Take, Path], object],
    people: float,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for module, name, size in SIZES:
        monkeypatch.setattr(module, name, size)
    peaks = []
    for repeats in (5, 5, 25):  # the first time modules are imported
        walk, path = long(repeats), tmp_path / f"{repeats}.x"
        if work is read:
            written("parquet")(walk, path)
        tracemalloc.start()
        work(walk, path)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    slots = 20 * len(take().motions[0])
    assert (peaks[2] - peaks[1]) / slots < people * PERSON


def test_bones_of_stretches_are_those_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    walk = long(3)
    (motion,) = walk.motions
    motion.joints_m[45:75, [11, 12]] = np.nan  # no hips at the begin of a stretch and in a whole
    motion.origin[45:75, [11, 12]] = 0
    whole = bones_of(motion, walk.skeleton)
    monkeypatch.setattr(bones, "STRETCH", 25)
    monkeypatch.setattr(bones, "FRAMES_OF_A_JOINT", len(motion))  # rest is that of all frames
    parts = [*stretches_of(motion, walk.skeleton)]
    assert [begin for begin, _ in parts] == [*range(0, 120, 25)]
    for begin, part in parts:
        rows = slice(begin, begin + len(part.root_m))
        assert part.names == whole.names
        np.testing.assert_allclose(part.offsets_m, whole.offsets_m)
        np.testing.assert_array_equal(part.measured, whole.measured[rows])
        np.testing.assert_allclose(part.root_m, whole.root_m[rows], equal_nan=True)
        np.testing.assert_allclose(part.rotations, whole.rotations[rows], atol=1e-12)
        for node, places_m in part.moved_m.items():
            there = np.isfinite(part.root_m).all(axis=1)
            np.testing.assert_allclose(places_m[there], whole.moved_m[node][rows][there])


def test_hips_that_are_seldom_together_are_in_the_sample(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    walk = long(50)
    (motion,) = walk.motions
    gone = np.zeros(motion.origin.shape, dtype=bool)
    gone[::2, 12] = gone[1::2, 11] = True
    gone[[503, 1003, 1507]] = False
    motion.joints_m[gone], motion.origin[gone] = np.nan, 0
    monkeypatch.setattr(bones, "STRETCH", 500)
    whole = bones_of(motion, walk.skeleton)
    for _, part in stretches_of(motion, walk.skeleton):
        assert part.names == whole.names
        hips = [part.names.index(name) for name in ("left_hip", "right_hip")]
        np.testing.assert_allclose(part.offsets_m[hips], whole.offsets_m[hips])
