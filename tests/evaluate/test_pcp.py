"""PCP against values worked out by hand, on a body whose limbs are 1 m and whose torso is 2 m."""

from __future__ import annotations

import numpy as np
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.evaluate.metrics import GROUPS, LIMBS, count_parts, group_percent, pcp_percent

BODY = np.array(
    [
        [0, 0, 0], [0, 0, 1], [0, 0, 2],  # right ankle, knee, hip
        [2, 0, 2], [2, 0, 1], [2, 0, 0],  # left hip, knee, ankle
        [0, 2, 4], [0, 1, 4], [0, 0, 4],  # right wrist, elbow, shoulder
        [2, 0, 4], [2, 1, 4], [2, 2, 4],  # left shoulder, elbow, wrist
        [1, 0, 4], [1, 0, 5],  # head
    ],
    dtype=np.float64,
)  # fmt: skip
NOBODY = np.zeros((0, 14, 3))
UNLABELLED = np.full((14, 3), np.nan)


def moved(**shifts: tuple[float, float, float]) -> Floats:
    """Return the body with joints `j<index>` shifted."""
    body: Floats = BODY.copy()
    for name, shift in shifts.items():
        body[int(name[1:])] += shift
    return body


def without(*joints: int) -> Floats:
    body: Floats = BODY.copy()
    body[list(joints)] = np.nan
    return body


def at(x: float) -> Floats:
    return BODY + [x, 0, 0]


def test_there_are_ten_limbs_of_known_length() -> None:
    assert len(LIMBS) == 10
    body = np.vstack([BODY, (BODY[2] + BODY[3]) / 2])
    lengths = [float(np.linalg.norm(body[a] - body[b])) for a, b in LIMBS]
    assert sorted(lengths) == [1.0] * 9 + [2.0]


@each_case(
    ("name", "people", "right"),
    [
        ("exact", [BODY], 10),
        ("no prediction in the frame", [], 0),
        ("a missing elbow takes both arm limbs", [without(7)], 8),
        ("a missing wrist takes the lower arm", [without(6)], 9),
        ("a missing hip takes thigh and torso", [without(2)], 8),
        ("a missing neck takes head and torso", [without(12)], 8),
        ("only the top of the head", [without(*range(13))], 0),
        ("a person without any joint", [without(*range(14))], 0),
        ("one end exactly at the threshold", [moved(j0=(1.0, 0, 0))], 10),
        ("one end just beyond it", [moved(j0=(1.0 + 2**-40, 0, 0))], 9),
        ("both ends share the threshold", [moved(j0=(0.5, 0, 0), j1=(0.5, 0, 0))], 10),
        ("both ends just beyond it", [moved(j0=(0.5, 0, 0), j1=(0.5 + 2**-40, 0, 0))], 9),
        ("the torso may err by its own length", [moved(j12=(0, 2.0, 0), j13=(0, 2.0, 0))], 9),
        ("far away still is taken, and wrong", [at(10.0)], 0),
        ("the nearer of two, whatever the order", [at(3.0), BODY], 10),
        ("a fragment nearby beats a whole body farther off", [at(0.25), without(*range(2, 14))], 1),
    ],
)
def test_right_limbs_of_one_actor(name: str, people: list[Floats], right: int) -> None:
    predicted = np.stack(people) if people else NOBODY
    counts = count_parts([predicted], BODY[None, None])
    assert counts.total.sum() == 10, name
    assert counts.right.sum() == right, name


def test_two_actors_may_take_the_same_prediction() -> None:
    counts = count_parts([BODY[None]], np.stack([at(0.25), at(-0.25)])[None])
    assert counts.right.sum(axis=1).tolist() == [10, 10]


def test_unlabelled_actors_and_limbs_are_not_scored() -> None:
    truth = np.stack([without(1), UNLABELLED])[None]
    counts = count_parts([BODY[None]], truth)
    assert counts.total.sum(axis=1).tolist() == [8, 0]
    assert counts.right.sum(axis=1).tolist() == [8, 0]
    assert "actor2" not in pcp_percent(counts, ["actor1", "actor2"])
    counts = count_parts([BODY[None]], np.stack([BODY, UNLABELLED, BODY])[None])
    # No average without all three actors.
    assert pcp_percent(counts, ["actor1", "actor2", "actor3"]) == {"actor1": 100, "actor3": 100}
    counts = count_parts([BODY[None]], UNLABELLED[None, None])
    assert pcp_percent(counts, ["actor1"]) == {}
    assert group_percent(counts, ["actor1"]) == {}


def test_average_is_over_the_first_three_actors_not_over_frames() -> None:
    # Actor 1 twice right, actor 2 right then nobody, actor 3 once wrong, actor 4 once right.
    truth = np.full((3, 4, 14, 3), np.nan)
    truth[0, 0], truth[1, 0] = BODY, BODY
    truth[0, 1], truth[2, 1] = BODY, BODY
    truth[2, 2] = BODY
    truth[0, 3] = BODY
    counts = count_parts([BODY[None], BODY[None], NOBODY], truth)
    table = pcp_percent(counts, ["actor1", "actor2", "actor3", "actor4"])
    assert table == {"actor1": 100, "actor2": 50, "actor3": 0, "actor4": 100, "average": 50}


def test_groups_name_the_limbs_that_are_wrong() -> None:
    counts = count_parts([without(13, 7)[None]], np.stack([BODY] * 3)[None])
    groups = group_percent(counts, ["actor1", "actor2", "actor3"])
    assert set(groups) == set(GROUPS)
    averages = {name: table["average"] for name, table in groups.items()}
    assert averages == {
        "head": 0, "torso": 100, "upper_arms": 50, "lower_arms": 50,
        "upper_legs": 100, "lower_legs": 100,
    }  # fmt: skip


def test_limbs_without_an_estimate_can_be_left_out() -> None:
    predicted = BODY[None].copy()
    predicted[0, 6] = np.nan
    missing = count_parts([predicted, predicted[:0]], np.stack([BODY, BODY])[:, None])
    left_out = count_parts([predicted, predicted[:0]], np.stack([BODY, BODY])[:, None], True)
    limbs = np.array(LIMBS)
    ends = (limbs == 6).any(axis=1).sum()
    assert missing.total.sum() == 2 * len(LIMBS)
    assert left_out.total.sum() == len(LIMBS) - ends == left_out.right.sum() == missing.right.sum()
