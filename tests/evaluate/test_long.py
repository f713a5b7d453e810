"""Nothing that looks at a replay holds the people of all its slots: hours must fit into memory."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.one_person import one_person

from e3pose.base import disk_list
from e3pose.energy.profiles import load_profile
from e3pose.evaluate import poses_table
from e3pose.evaluate.held_out import judge
from e3pose.evaluate.poses_table import write_poses
from e3pose.evaluate.replay import ReplaySettings
from e3pose.evaluate.smoothed import keep_people
from e3pose.evaluate.summary import summarise
from e3pose.model.people import People
from e3pose.model.slot_record import SlotRecord
from e3pose.output.report import scene
from e3pose.output.report.page import render

NUM_SLOTS, SHOWN = 600, 40
SCENE = one_person([0.2, 1.7, 3.4], NUM_SLOTS)


class Made(Sequence[SlotRecord]):
    """Records that are made when they are asked for, as a file gives them.

    Attributes:
        most: how many had their people in memory at once.
    """

    def __init__(self) -> None:
        self.most = self._now = 0

    def __len__(self) -> int:
        return NUM_SLOTS

    def __getitem__(self, at: Any) -> Any:
        if isinstance(at, slice):
            return [self[row] for row in range(*at.indices(NUM_SLOTS))]
        if not -NUM_SLOTS <= at < NUM_SLOTS:
            raise IndexError
        at %= NUM_SLOTS
        assert SCENE.truth is not None
        joints_m = SCENE.truth.joints_m[at] + 0.01
        covariance_m2 = np.tile(1e-4 * np.eye(3), (*joints_m.shape[:2], 1, 1))
        people = People(np.array([4]), joints_m, full_covariance_m2=covariance_m2)
        self._now += 1
        self.most = max(self.most, self._now)
        weakref.finalize(covariance_m2, self._gone)
        looks, none = np.ones(3, dtype=bool), np.zeros(3)
        return SlotRecord(at, at * SCENE.interval_s, looks, looks, people, none, none, looks)

    def _gone(self) -> None:
        self._now -= 1


def summary(records: Sequence[SlotRecord]) -> Any:
    without = replace(SCENE, truth=None)
    settings = ReplaySettings(policy="all").for_rig(3)
    return summarise(without, settings, records, load_profile("xavier-nx"))


@pytest.mark.parametrize(
    "look",
    [
        summary,
        lambda records: judge(SCENE, records),
        lambda records: keep_people(records, 1),
        lambda records: write_poses(records, SCENE.skeleton, Path("poses.csv")),
        lambda records: render(replace(SCENE, truth=None), records, summary([records[0]])),
    ],
    ids=["summary", "judge", "people", "table", "report"],
)
def test_people_of_few_slots_are_held(
    look: Callable[[Sequence[SlotRecord]], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(scene, "MAX_SLOTS", SHOWN)
    monkeypatch.setattr(poses_table, "CHUNK", SHOWN)
    monkeypatch.setattr(disk_list, "BLOCK", SHOWN)
    records = Made()
    look(records)
    assert 0 < records.most <= 4 * SHOWN
