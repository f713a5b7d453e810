"""Judges of versions of the filter count people whom it makes up."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import e3pose.evaluate.replay as replaying
import filter_terms
from e3pose.evaluate.held_out import turns
from e3pose.simulate import SceneSettings, simulate
from filter_terms import NOW, Case, figures, report


def doubled(record: Any) -> Any:
    """Return the record with everybody there twice, under other names."""
    people = record.people
    joints_m, covariance_m2 = (
        np.concatenate([each, each]) for each in (people.joints_m, people.full_covariance_m2)
    )
    ids = np.concatenate([people.track_ids, people.track_ids + 1000])
    twice = type(people)(track_ids=ids, joints_m=joints_m, full_covariance_m2=covariance_m2)
    return replace(record, people=twice)


@pytest.mark.parametrize("judge", ["truth", "held-out camera"])
def test_a_judge_counts_people_who_are_nobody(judge: str, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = simulate(SceneSettings("ring", people=2, seconds=3.0, fps=10.0), 3)
    rest, by = turns(whole, [whole.rig.camera_ids[0]])[0]
    case = Case("ring", whole, filter_terms.truth_of(whole))
    if judge != "truth":
        case = Case("ring", rest, judges=by)
    replayed = replaying.replay

    def twice(*args: Any) -> Iterator[Any]:
        yield from map(doubled, replayed(*args))

    honest = figures(case, "round-robin", 2.0, 0)
    monkeypatch.setattr(replaying, "replay", twice)
    lying = figures(case, "round-robin", 2.0, 0)
    assert lying["nobody"] > honest["nobody"] + 40
    assert lying["missed"] == honest["missed"]


def test_the_table_shows_a_rare_false_person_with_its_spread() -> None:
    before = [{"mm": 20.0, "missed": 1.0, "nobody": 0.0} for _ in range(4)]
    after = [{**row, "nobody": share} for row, share in zip(before, (0, 0, 0.2, 0), strict=True)]
    rows = [{"version": name, "found": {"ring": found}} for name, found in
            ((NOW, before), ("without", after))]  # fmt: skip
    *_, first, second = report(rows)
    assert first == f"| {NOW} | 20.0 mm m 1 n 0 |"
    assert second == "| without | +0.0 ± 0.0 n +0.05 ± 0.05 |"
