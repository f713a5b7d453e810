"""The frontier's tables hold every policy and estimator, at the leads that make a difference."""

from __future__ import annotations

from typing import Any

import pytest

from e3pose.select.policies import POLICIES
from e3pose_lab.reproduce.identity_scores import IdentitiesAsked, IdentityFigures
from e3pose_lab.reproduce.items.base import Scale
from e3pose_lab.reproduce.items.frontier import AHEAD, LEADS, pieces, section
from e3pose_lab.reproduce.records import Section, Spread
from e3pose_lab.reproduce.replays import Run

ERROR_MM = {"all": 40.0, "round-robin": 45.0, "information": 44.0}


def made(piece: Any) -> Run | IdentityFigures:
    """Return figures of a replay that nobody ran: the worse the longer the lead."""
    asked = piece.settings
    if isinstance(asked, IdentitiesAsked):
        return IdentityFigures(0.9, 0.8, 1, 0, 0)
    error_mm = ERROR_MM.get(asked.policy, 50.0) + asked.lead + asked.seed
    return Run({}, {}, {}, error_mm, 1.0, (0.4,), asked.cameras or 1.5, 0.1, 1.0, 1.0, 0, ((0,),))


@pytest.fixture(scope="module")
def full() -> Section:
    return section(Scale(most_seeds=2), made)  # type: ignore[arg-type]


def test_every_policy_with_both_estimators(full: Section) -> None:
    names = {f"{pipeline}: {policy}" for pipeline in ("paper", "memory") for policy in POLICIES}
    leads, scenes, *_, every = full.tables
    assert {str(row[0]) for row in leads.rows} == {str(row[0]) for row in scenes.rows} == names
    assert {str(row[1]) for row in every.rows} == names and every.folded
    assert len(pieces(Scale(most_seeds=2))) == 2 * (len(every.rows) + len(full.tables[2].rows) + 15)


def test_policies_that_look_ahead_are_tried_at_every_lead(full: Section) -> None:
    table = full.tables[0]
    first = 2
    for row in table.rows:
        found = [cell for cell in row[first : first + len(LEADS)] if cell is not None]
        ahead = str(row[0]).partition(": ")[2] in AHEAD
        assert len(found) == (len(LEADS) if ahead else 1), row
    (row,) = [row for row in table.rows if row[0] == "memory: information"]
    assert [cell.mean for cell in row[first:-1] if isinstance(cell, Spread)] == pytest.approx(
        [44.5 + lead for lead in LEADS]
    )
    beside = row[-1]
    assert isinstance(beside, Spread)
    assert beside.mean == pytest.approx(100 * (48 / 49 + 49 / 50) / 2 - 100)


def test_quick_run_is_small() -> None:
    quick = Scale(quick=True)
    assert len(pieces(quick)) <= 12
    assert section(quick, made).headlines[0].holds  # type: ignore[arg-type]
