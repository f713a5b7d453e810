"""Comparisons: which replays are run, what is averaged, what the table shows."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from e3pose.energy.queues import load_profile
from e3pose.evaluate.figures import Duration, Summary
from e3pose.evaluate.replay import ReplaySettings
from e3pose.model.camera import Camera, Rig
from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording, Truth, ViewSeries
from e3pose_lab.evaluate.compare import compare, rows, tasks
from e3pose_lab.evaluate.table import print_comparison

BODY = np.random.default_rng(1).normal(size=(17, 3))


def recording() -> Recording:
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    camera = Camera.from_world_to_camera("only", (640, 480), K, np.eye(3), [0, 0, 5])
    lost = ViewSeries.from_views([], [], [], 17)
    truth = Truth(COCO17, ("anna",), np.stack([BODY[None]] * 2))
    return Recording("test", Rig((camera,)), 10.0, 2, COCO17, (lost,), truth=truth)


def off_by_seed(source: Recording, settings: ReplaySettings) -> Iterator[SlotRecord]:
    """Stand in for a replay: wrong by 10 mm times the seed, nobody found at seed 2."""
    for slot in range(source.num_slots):
        joints = BODY[None] + [0.01 * settings.seed, 0, 0]
        joints = joints[: 0 if settings.seed == 2 else 1]
        people, on, zero = People(np.arange(len(joints)), joints), np.ones(1, bool), np.zeros(1)
        yield SlotRecord(slot, 0.1 * slot, on, on, people, zero, zero, on, stage_s={"fuse": 0.001})


def summaries(seeds: int) -> list[Summary]:
    settings = tasks(ReplaySettings(num_selected=1), ["random"], seeds)
    profile = load_profile("tx2")
    return list(compare(recording(), settings, profile, jobs=1, run=off_by_seed))


def test_every_policy_has_every_seed_and_phase() -> None:
    base = ReplaySettings(seed=5, lead_slots=2, num_selected=1.5)
    settings = tasks(base, ["all", "e3pose"], 2)
    assert [(s.policy, s.seed, s.phase) for s in settings] == [
        ("all", 5, 0), ("all", 6, 1), ("e3pose", 5, 0), ("e3pose", 6, 1),
    ]  # fmt: skip
    assert all(s.lead_slots == 2 and s.num_selected == 1.5 for s in settings)


def test_every_lead_has_rows_of_its_own_and_a_column() -> None:
    settings = tasks(ReplaySettings(), ["random"], 2, leads=[1, 4])
    assert [(s.lead_slots, s.seed) for s in settings] == [(1, 0), (1, 1), (4, 0), (4, 1)]
    found = list(compare(recording(), settings, load_profile("tx2"), jobs=1, run=off_by_seed))
    table = rows(
        [
            replace(each, stage_ms={**each.stage_ms, "predict": Duration(float(lead), 9.0)})
            for each, lead in zip(found, (1, 1, 4, 4), strict=True)
        ]
    )
    assert [(row["lead"], row["seeds"]) for row in table] == [(1, 2), (4, 2)]
    shown, alone = (_printed(part) for part in (table, table[:1]))
    assert "lead" in shown
    assert "4.000" in shown
    assert "lead" not in alone
    assert "predict ms" not in alone


def test_mean_and_sample_deviation_over_seeds() -> None:
    (row,) = rows(summaries(2))
    assert row["policy"] == "random"
    assert row["cameras"] == 1
    assert row["seeds"] == 2
    assert row["metrics"]["mpjpe_mm"]["mean"] == pytest.approx(5.0)
    assert row["metrics"]["mpjpe_mm"]["sd"] == pytest.approx(10 / np.sqrt(2))
    assert row["selection"]["duty"]["only"] == {"mean": 1.0, "sd": 0.0}
    assert row["energy"]["profile"] == "tx2"
    assert row["slots"] == {"mean": 2.0, "sd": 0.0}
    assert "settings" not in row
    text = _printed([row])
    assert "5.0 +- 7.1" in text and "random" in text and "MPJPE" in text
    assert "PCP" not in text, "only what there is"


def test_figure_that_some_seeds_lack_tells_how_many_have_it() -> None:
    (row,) = rows(summaries(3))
    assert row["metrics"]["mpjpe_mm"]["mean"] == pytest.approx(5.0)
    assert row["metrics"]["mpjpe_mm"]["count"] == 2
    assert row["metrics"]["recall_500mm"]["mean"] == pytest.approx(2 / 3)
    assert "count" not in row["metrics"]["recall_500mm"]
    (row,) = rows(summaries(1))
    assert row["metrics"]["mpjpe_mm"] == {"mean": pytest.approx(0.0), "sd": 0.0}


def test_rows_are_apart_by_policy_and_camera_count() -> None:
    one = summaries(1)[0]
    settings = one.settings
    other = replace(one, policy="all", settings=replace(settings, policy="all"))
    more = replace(one, settings=replace(settings, num_selected=2))
    table = rows([one, other, more, one])
    assert [(r["policy"], r["cameras"], r["seeds"]) for r in table] == [
        ("random", 1, 2), ("all", None, 1), ("random", 2, 1),
    ]  # fmt: skip
    aimed = replace(one, settings=replace(settings, target_error_m=0.04))
    (row,) = rows([aimed])
    assert (row["cameras"], row["target_mm"]) == (None, 40)


def _printed(table: list[dict[str, Any]]) -> str:
    console = Console(file=io.StringIO(), width=240)
    print_comparison(table, console)
    return str(console.file.getvalue())  # type: ignore[attr-defined]


@pytest.mark.parametrize("width", [80, 200])
def test_comparison_shows_its_figures_at_80_columns(width: int) -> None:
    spread = {"mean": 96.9, "sd": 0.2}
    devices = {
        key: spread
        for key in (
            "saving_percent",
            "times_paper",
            "aggressive_saving_percent",
            "aggressive_times_paper",
        )
    }
    row: dict[str, Any] = {
        "policy": "information",
        "cameras": 2,
        "lead": 4,
        "seeds": 5,
        "selection": {"mean_cameras": spread},
        "metrics": {"pcp": {"average": spread}, "mpjpe_mm": spread, "recall_500mm": spread},
        "identities": spread,
        "expected": {"error_mm": spread, "coverage_90": spread},
        "savings": {"whole_camera": {"percent": spread}},
        "energy": {"devices": {"xavier-nx": devices, "tx2": devices}},
        "stage_ms": {"slot": {"median": spread}},
    }
    out = io.StringIO()
    print_comparison([row], Console(file=out, width=width))
    text = out.getvalue()
    assert max(map(len, text.splitlines())) <= width and "\u2026" not in text
    for heading in ("PCP avg %", "MPJPE mm", "expected mm", "ms/slot", "tx2 saved %"):
        assert heading in text
    assert text.count("96.9 +- 0.2") >= 8
    assert "whole camera saved %" in text and "processor time saved: not measured" in text
