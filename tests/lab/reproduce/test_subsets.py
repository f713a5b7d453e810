"""Subsets of cameras, and readings of the protocol of Shelf."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import accuracy
from e3pose_lab.datasets.shelf import import_shelf
from e3pose_lab.reproduce.items.occlusion_error import relation
from e3pose_lab.reproduce.replays import Asked, pcp_readings, replayed
from e3pose_lab.reproduce.sources import Sources
from e3pose_lab.reproduce.subsets import SubsetFigures, SubsetsAsked, joined, subset_figures

RING = SubsetsAsked("ring", 5, 20, 5, seconds=2.0)


@pytest.fixture(scope="module")
def found() -> SubsetFigures:
    return subset_figures(Sources(), RING)


def test_every_subset_of_every_slot_is_there(found: SubsetFigures) -> None:
    assert found.slots == [5, 10, 15]
    assert len(found.subsets) == 31 and found.subsets[-1] == [0, 1, 2, 3, 4]
    matched = np.array(found.matched)
    assert matched.shape == (3, 31) == np.array(found.error_m).shape
    assert (matched[:, :5] == 0).all()
    assert (matched[:, -1] >= matched[:, 5:15].max(axis=1) - 1).all()
    assert (np.array(found.occlusion)[:, -1] >= np.array(found.occlusion)[:, 0]).all()


def test_parts_join(found: SubsetFigures) -> None:
    parts = [
        subset_figures(Sources(), SubsetsAsked("ring", first, first + 5, 5, seconds=2.0))
        for first in (5, 10, 15)
    ]
    assert joined(parts) == found


@pytest.mark.parametrize(("slope", "sign"), [(40.0, 1), (-40.0, -1)])
def test_a_relation_has_its_sign(slope: float, sign: int) -> None:
    rng = np.random.default_rng(0)
    hidden = rng.uniform(0, 1, (200, 1))
    error_m = (60 + slope * hidden + rng.normal(0, 5, hidden.shape)) / 1000
    ones = np.ones_like(hidden, dtype=int)
    made = SubsetFigures(
        [[0, 1]], list(range(200)), [], [], error_m.tolist(), ones.tolist(), [1] * 200,
        hidden.tolist(),
    )  # fmt: skip
    got = relation(made, 2)
    assert sign * got.rho > 0.8 and got.rho_low < got.rho < got.rho_high
    assert (np.diff(got.error_mm) * sign > 0).all()
    assert got.rising == (1.0 if sign > 0 else 0.0)
    assert max(got.missed) == 0


def test_the_true_occlusion_is_less_where_it_decides() -> None:
    asked = Asked("crossing", "e3pose", seconds=6.0, fps=12.5, quality_weight=1000.0)
    blind = replayed(Sources(), Asked("crossing", "random", seconds=6.0, fps=12.5))
    seeing = replayed(
        Sources(),
        Asked("crossing", "e3pose", seconds=6.0, fps=12.5, quality_weight=1000.0, sees_all=True),
    )
    assert seeing.occlusion < replayed(Sources(), asked).occlusion < blind.occlusion
    assert seeing.cameras == pytest.approx(blind.cameras)


@pytest.mark.shared
@pytest.mark.parity
def test_readings_of_the_table_are_in_order_and_one_is_what_is_shown(shared: Path) -> None:
    shelf = import_shelf(shared / "data" / "shelf" / "shelf.npz")
    settings = ReplaySettings(pipeline="paper", policy="random", num_selected=3)
    records = list(replay(shelf, settings))
    readings = pcp_readings(shelf, records)
    estimated, shown, skipped = (
        readings[name]["average"] for name in ("estimated", "shown", "skipped")
    )
    assert estimated + 3 < shown < skipped
    pcp = accuracy(shelf, records).pcp
    assert pcp is not None and pcp.actors == readings["shown"]
    bare = list(replay(shelf, replace(settings, fill=False)))
    plain = accuracy(shelf, bare).pcp
    assert plain is not None and plain.actors["average"] == pytest.approx(estimated)
