"""The model card tells what was learned, beside every figure where that is doubtful."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install e3pose[train]")

from e3pose_lab.train.card import model_card
from e3pose_lab.train.validation import Marks
from e3pose_lab.train.windows import Clip


def clip(name: str, scored: bool, estimated: bool) -> Clip:
    joints = np.zeros((60, 14, 3), np.float32)
    errors = np.zeros((60, 2, 14, 3), np.float16) if estimated else None
    return Clip(name, joints, 30.0, errors_m=errors, scored=scored)


def marks(name: str) -> Marks:
    return Marks(name, np.full(15, 0.01), np.full(15, 0.01), np.full((3, 15), 0.02))


def test_what_windows_are_made_of_is_said() -> None:
    said = [model_card({"variety": each}, 1, [], [], []) for each in ("bodies", "motion", "none")]
    assert ["size" in card for card in said] == [True, False, False]
    assert "as it was recorded" in said[2]


@pytest.mark.parametrize("scored", [False, True])
def test_scored_slots_that_were_learned_from_stand_beside_every_figure(scored: bool) -> None:
    training = [clip("Shelf, person 1", scored, True), clip("cmu, person", False, False)]
    card = model_card({}, 10, training, [], [marks("ring, exact"), marks("walk, estimated")])
    headings = [line for line in card.split("\n") if line.startswith("### ")]
    assert len(headings) == 2
    for heading in headings:
        assert ("learned from scored slots of Shelf" in heading) == scored
    assert ("- Shelf, as its cameras estimate it, scored slots too: 2 s" in card) == scored
    assert ("- Shelf, as its cameras estimate it: 2 s" in card) != scored
    assert "- cmu: 2 s" in card
