from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.model.people import People
from e3pose.model.pose import Poses2D


def made(positions: Any, scores: Any) -> Any:
    """Return poses of two components, or people of three; others are refused as the first."""
    if positions.shape[-1:] == (3,) and positions.ndim == 3:
        return People(np.arange(len(positions)), positions, scores)
    return Poses2D(positions, scores)


def positions_of(poses: Any) -> Any:
    return poses.keypoints_px if isinstance(poses, Poses2D) else poses.joints_m


@each_case("components", [2, 3])
def test_missing_is_nan_with_score_zero_however_it_is_said(components: int) -> None:
    positions = np.ones((2, 3, components))
    scores = np.full((2, 3), 0.5)
    positions[0, 0, 0] = np.nan  # a position without a number cannot have a score
    positions[0, 1, 0] = np.inf
    scores[1, 2] = 0.0  # nor can one without a score have a position
    poses = made(positions, scores)
    assert len(poses) == 2 and poses.scores.tolist() == [[0, 0, 0.5], [0.5, 0.5, 0]]
    missing = np.isnan(positions_of(poses)).all(axis=-1)
    assert missing.tolist() == [[True, True, False], [False, False, True]]
    assert np.isfinite(positions_of(poses)[~missing]).all()
    assert positions[1, 2, 0] == 1.0, "the caller's arrays stay as they are"


def test_nobody_is_a_normal_view() -> None:
    for nobody, components in ((Poses2D.empty(17), 2), (People.empty(17), 3)):
        assert len(nobody) == 0 and nobody.scores.shape == (0, 17)
        assert positions_of(nobody).shape == (0, 17, components)


@each_case("components", [2, 3])
@each_case("score", [-0.01, 1.01, float("nan"), float("inf")])
def test_score_outside_zero_to_one_is_refused(components: int, score: float) -> None:
    with pytest.raises(InputError, match=r"(Poses2D|People).*outside"):
        made(np.zeros((1, 2, components)), np.array([[0.5, score]]))


def test_wrong_shape_is_refused_with_both_shapes() -> None:
    with pytest.raises(InputError, match=r"positions have shape \(2, 3\)"):
        made(np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.raises(InputError, match=r"expected \(num_persons, num_joints, 3\)"):
        People(np.arange(2), np.zeros((2, 3, 2)), np.zeros((2, 3)))
    with pytest.raises(InputError, match=r"scores have shape \(3, 2\), expected \(2, 3\)"):
        made(np.zeros((2, 3, 3)), np.zeros((3, 2)))
