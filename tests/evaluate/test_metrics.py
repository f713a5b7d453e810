"""AP, MPJPE, recall and identity switches against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.evaluate.metrics import (
    Candidates,
    acceleration_error_mps2,
    average_precision,
    candidates,
    id_switches,
    joint_coverage,
    joint_quantile_mm,
    mean_errors_m,
    mpjpe_mm,
    poses_within,
    precision_500mm,
    recall_500mm,
    wrong_limbs,
)

HOMES = [0.0, 10.0, 20.0, 30.0]  # where actors stand, far from each other


def person(x: float, missing: bool = False) -> Floats:
    """Return two joints 1 m apart whose mean error is the distance to where it should be."""
    joints = np.array([[x, 0, 0], [x, 0, 1]])
    if missing:
        joints[1] = np.nan
    return joints


def people(*xs: float) -> Floats:
    return np.stack([person(x) for x in xs]) if xs else np.zeros((0, 2, 3))


def found(slots: list[list[tuple[float, float]]], truth: list[list[float]]) -> Candidates:
    """Predictions as (x, score) per slot, truth as x per slot; NaN is an unlabelled actor."""
    return candidates(
        [people(*(x for x, _ in slot)) for slot in slots],
        [np.array([score for _, score in slot], dtype=np.float64) for slot in slots],
        np.stack([people(*slot) for slot in truth]),
    )


NAN = float("nan")


@each_case(
    ("turned_by", "moved_m", "wrong"),
    [(0, 0, 0), (25, 0, 0), (35, 0, 1), (180, 0, 1), (0, 0.14, 0), (0, 0.16, 1), (0, NAN, NAN)],
)
def test_wrong_limbs(turned_by: float, moved_m: float, wrong: float) -> None:
    """A forearm is turned about its elbow, or moved; 35 degrees move its end by 150 mm."""
    names = ("left_shoulder", "left_elbow", "left_wrist")
    true_m = np.array([[0, 0, 1.4], [0, 0, 1.1], [0, 0, 0.85]])
    angle = np.radians(turned_by)
    joints_m = true_m.copy()
    joints_m[2] = joints_m[1] - 0.25 * np.array([np.sin(angle), 0, np.cos(angle)])
    joints_m[2, 1] += moved_m
    joints_m[1, 1] += min(moved_m, 0.14)
    result = candidates([joints_m[None]], [np.array([0.9])], true_m[None, None])
    upper = NAN if np.isnan(moved_m) else 0
    np.testing.assert_equal(wrong_limbs(result, names), [[NAN, upper, wrong]])


@each_case(
    ("name", "slots", "truth", "ap", "mpjpe", "recall", "precision"),
    [
        ("everybody exact", [[(0, 0.9), (10, 0.8)]], [[0, 10]], 100.0, 0.0, 1.0, 1.0),
        # Right, wrong, right of four people: recall .25 .25 .5, envelope 1, 2/3, 2/3.
        (
            "a false one between two right ones",
            [[(0, 0.9), (5, 0.8), (10, 0.7)]], [HOMES],
            100 * (0.25 + 0.25 * 2 / 3), 0.0, 0.5, 2 / 3,
        ),
        # The envelope lifts the first step: precision 0, 1/2, 2/3 becomes 2/3, 2/3, 2/3.
        (
            "a false one first",
            [[(5, 0.9), (0, 0.8), (10, 0.7)]], [[0, 10]], 100 * 2 / 3, 0.0, 1.0, 2 / 3,
        ),
        ("a false one last costs nothing", [[(0, 0.9), (5, 0.1)]], [[0]], 100.0, 0.0, 1.0, 0.5),
        ("the second of a person is false", [[(0, 0.9), (0.01, 0.95)]], [[0]], 100, 10, 1, 0.5),
        ("slots are apart", [[(0, 0.9)], [(0, 0.8)]], [[0], [0]], 100.0, 0.0, 1.0, 1.0),
        ("wrong slot", [[(0, 0.9)], []], [[NAN], [0]], 0.0, None, 0.0, 0.0),
        ("no prediction at all", [[], []], [[0], [0]], 0.0, None, 0.0, None),
        ("exactly at the threshold of AP", [[(0.0625, 0.9)]], [[0]], 0.0, 62.5, 1.0, 1.0),
        ("just below it", [[(0.0624, 0.9)]], [[0]], 100.0, 62.4, 1.0, 1.0),
        ("exactly at 500 mm", [[(0.5, 0.9)]], [[0]], 0.0, None, 0.0, 0.0),
        # Of equal scores the first in slot order takes the truth, better or not.
        ("tied scores", [[(0.03, 0.5), (0.01, 0.5)]], [[0]], 100.0, 30.0, 1.0, 0.5),
        # At 62.5 mm the best is found; for MPJPE the first below 500 mm, by score, is 100 mm off.
        ("score decides, not error", [[(0.1, 0.9), (0, 0.8)]], [[0]], 50.0, 100.0, 1.0, 0.5),
        ("an unlabelled actor is nobody", [[(0, 0.9)]], [[0, NAN]], 100.0, 0.0, 1.0, 1.0),
        (
            "MPJPE is over matches",
            [[(0.02, 0.9), (10.04, 0.8)]], [[0, 10, 20]], 200 / 3, 30.0, 2 / 3, 1.0,
        ),
    ],
)  # fmt: skip
def test_metrics_by_hand(
    name: str,
    slots: list[list[tuple[float, float]]],
    truth: list[list[float]],
    ap: float,
    mpjpe: float | None,
    recall: float,
    precision: float | None,
) -> None:
    result = found(slots, truth)
    assert average_precision(result, 0.0625) == pytest.approx(ap), name
    assert mpjpe_mm(result) == (None if mpjpe is None else pytest.approx(mpjpe, abs=1e-9)), name
    assert recall_500mm(result) == pytest.approx(recall), name
    assert precision_500mm(result) == (None if precision is None else pytest.approx(precision)), (
        name
    )


@pytest.mark.parametrize("truth", [[[NAN]], [[]]])
def test_nothing_can_be_said_without_truth(truth: list[list[float]]) -> None:
    result = found([[(0, 0.9)]], truth)
    assert result.num_truths == 0
    assert average_precision(result, 0.1) is None
    assert mpjpe_mm(result) is None
    assert recall_500mm(result) is None
    assert precision_500mm(result) is None
    assert joint_coverage(result) is None
    assert id_switches([people(0)], [np.array([1])], people(NAN)[None]) is None


def test_missing_joints_are_left_out_of_the_error_and_reported() -> None:
    predicted = np.stack([person(0.02, missing=True), person(10.0)])
    result = candidates([predicted], [np.array([0.9, 0.8])], people(0, 10)[None])
    assert mpjpe_mm(result) == pytest.approx(10.0)  # of 20 mm and 0 mm
    assert joint_coverage(result) == pytest.approx(0.75)  # of 1/2 and 1
    truth = np.stack([person(0.0, missing=True)])  # and joints without annotation
    result = candidates([people(0.02)], [np.array([0.9])], truth[None])
    assert mpjpe_mm(result) == pytest.approx(20.0)
    assert joint_coverage(result) == 1.0


def test_quantiles_are_over_the_joints_of_matched_people() -> None:
    predicted = np.stack([person(0.02), person(10.0), person(17.0)])  # the last is of nobody
    predicted[1, 1, 2] += 0.1
    result = candidates([predicted], [np.array([0.9, 0.8, 0.7])], people(0, 10)[None])
    assert mpjpe_mm(result) == pytest.approx((20 + 50) / 2)
    assert joint_quantile_mm(result, 1.0) == pytest.approx(100.0)
    assert joint_quantile_mm(result, 0.5) == pytest.approx(20.0)  # of 0, 20, 20 and 100 mm
    assert joint_quantile_mm(found([[]], [[0]]), 0.99) is None


def test_people_without_a_joint_in_common_are_infinitely_far() -> None:
    upper, lower = people(0.0)[0], people(0.0)[0]
    upper[0], lower[1] = np.nan, np.nan
    assert np.isinf(mean_errors_m(upper[None], lower[None])).all()
    assert mean_errors_m(people(), people(0.0)).shape == (0, 1)


@each_case(
    ("name", "slots", "truth", "switches"),
    [
        ("kept", [[(0, 1), (10, 2)], [(10, 2), (0, 1)]], [[0, 10], [0, 10]], 0),
        ("swapped", [[(0, 1), (10, 2)], [(0, 2), (10, 1)]], [[0, 10], [0, 10]], 2),
        ("lost and found again", [[(0, 1)], [], [(0, 1)]], [[0], [0], [0]], 0),
        ("lost and found as another", [[(0, 1)], [], [(0, 3)]], [[0], [0], [0]], 1),
        ("too far to be the same", [[(0, 1)], [(0.5, 3)]], [[0], [0]], 0),
        ("unlabelled in between", [[(0, 1)], [(0, 5)], [(0, 1)]], [[0], [NAN], [0]], 0),
        ("one each, at the least in all", [[(0, 1), (0.3, 2)], [(0.1, 2), (0.0, 1)]],
         [[0, 0.3], [0, 0.3]], 0),
    ],
)  # fmt: skip
def test_identity_switches_by_hand(
    name: str, slots: list[list[tuple[float, int]]], truth: list[list[float]], switches: int
) -> None:
    predicted = [people(*(x for x, _ in slot)) for slot in slots]
    ids = [np.array([track for _, track in slot], dtype=np.int64) for slot in slots]
    assert id_switches(predicted, ids, np.stack([people(*slot) for slot in truth])) == switches


def test_acceleration_error_is_that_of_three_slots_of_one_track() -> None:
    times = np.arange(6) / 10
    truth = np.zeros((6, 1, 2, 3))
    truth[:, 0, :, 0] = 0.5 * 2.0 * times[:, None] ** 2  # 2 m/s2
    still = [truth[0] + [0.1 * t, 0, 0] for t in times]  # an even motion
    ids = [np.array([4])] * 6
    error = acceleration_error_mps2(still, ids, truth, 0.1)
    assert error == pytest.approx(2.0)
    assert acceleration_error_mps2(list(truth), ids, truth, 0.1) == pytest.approx(0.0)
    changing = [np.array([slot // 2]) for slot in range(6)]  # nobody stays for three slots
    assert acceleration_error_mps2(still, changing, truth, 0.1) is None


def test_share_of_poses_counts_no_person_who_is_missed() -> None:
    # Of three poses two are within 25 mm; the fourth person is not found by anybody.
    result = found([[(0.0, 0.9), (10.01, 0.8), (20.4, 0.7)]], [HOMES])
    assert poses_within(result, 0.025) == pytest.approx(200 / 3)
    assert poses_within(result, 0.5) == 100.0 > (average_precision(result, 0.5) or 0.0)
    assert poses_within(found([[]], [HOMES]), 0.1) is None
    assert poses_within(found([[(0.0, 0.9)]], [[NAN]]), 0.1) is None
