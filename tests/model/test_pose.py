from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.model.pose import Poses2D, Poses3D

KINDS: list[tuple[Any, int]] = [(Poses2D, 2), (Poses3D, 3)]


def positions_of(poses: Any) -> Any:
    return poses.keypoints_px if isinstance(poses, Poses2D) else poses.joints_m


@pytest.mark.parametrize(("kind", "components"), KINDS)
def test_missing_is_nan_with_score_zero_however_it_is_said(kind: Any, components: int) -> None:
    positions = np.ones((2, 3, components))
    scores = np.full((2, 3), 0.5)
    positions[0, 0, 0] = np.nan  # a position without a number cannot have a score
    positions[0, 1, 0] = np.inf
    scores[1, 2] = 0.0  # nor can one without a score have a position
    poses = kind(positions, scores)
    assert poses.scores.tolist() == [[0, 0, 0.5], [0.5, 0.5, 0]]
    missing = np.isnan(positions_of(poses)).all(axis=-1)
    assert missing.tolist() == [[True, True, False], [False, False, True]]
    assert np.isfinite(positions_of(poses)[~missing]).all()
    assert positions[1, 2, 0] == 1.0, "the caller's arrays stay as they are"


@pytest.mark.parametrize(("kind", "components"), KINDS)
def test_nobody_is_a_normal_view(kind: Any, components: int) -> None:
    poses = kind.empty(17)
    assert len(poses) == 0
    assert positions_of(poses).shape == (0, 17, components)
    assert poses.scores.shape == (0, 17)


@pytest.mark.parametrize(("kind", "components"), KINDS)
def test_length_is_the_number_of_people(kind: Any, components: int) -> None:
    assert len(kind(np.zeros((4, 17, components)), np.ones((4, 17)))) == 4


@each_case(("kind", "components"), KINDS)
@each_case("score", [-0.01, 1.01, float("nan"), float("inf")])
def test_score_outside_zero_to_one_is_refused(kind: Any, components: int, score: float) -> None:
    scores = np.full((1, 2), 0.5)
    scores[0, 1] = score
    with pytest.raises(InputError, match=f"{kind.__name__}.*outside"):
        kind(np.zeros((1, 2, components)), scores)


@pytest.mark.parametrize(("kind", "components"), KINDS)
def test_wrong_shape_is_refused_with_both_shapes(kind: Any, components: int) -> None:
    with pytest.raises(InputError, match=r"positions have shape \(2, 3\)"):
        kind(np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.raises(InputError, match=rf"expected \(num_persons, num_joints, {components}\)"):
        kind(np.zeros((2, 3, 5 - components)), np.zeros((2, 3)))
    with pytest.raises(InputError, match=r"scores have shape \(3, 2\), expected \(2, 3\)"):
        kind(np.zeros((2, 3, components)), np.zeros((3, 2)))
