"""Which motion is learned from and which is kept for validation."""

from __future__ import annotations

import numpy as np
import pytest

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.rigs import ring_rig
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording, Truth, ViewSeries
from e3pose_lab.train.clips import clips_of, gather


def recording(name: str, joints_m: Floats | None) -> Recording:
    rig = ring_rig(2, 4.0, 2.0, (640, 480), np.random.default_rng(0))
    slots = 100 if joints_m is None else len(joints_m)
    people = 0 if joints_m is None else joints_m.shape[1]
    return Recording(
        name=name,
        rig=rig,
        fps=10.0,
        num_slots=slots,
        skeleton=COCO17,
        views=(ViewSeries.from_views([], [], [], 17),) * 2,
        truth=None
        if joints_m is None
        else Truth(COCO17, tuple(f"p{k}" for k in range(people)), joints_m),
    )


def numbered(slots: int, people: int = 1) -> Floats:
    """Return people whose every coordinate is the slot, so that a clip tells where it is from."""
    return np.broadcast_to(np.arange(slots)[:, None, None, None], (slots, people, 17, 3)).astype(
        np.float64
    )


def test_a_clip_ends_where_a_joint_is_unknown() -> None:
    joints = numbered(100, people=2)
    joints[40, 0, 9] = np.nan  # a wrist
    joints[70:75, 1] = np.nan
    joints[10, 1, 1] = np.nan  # an eye, which the network does not look at
    clips = clips_of(recording("a", joints), shortest=25)
    assert [len(c.joints_m) for c in clips] == [40, 59, 70, 25]


def test_the_end_of_long_motion_is_held_out_a_window_apart() -> None:
    training, groups = gather([recording("a", numbered(1000))], [], 0.2, 25)
    assert [name for name, _ in groups] == ["a, the end"]
    assert training[0].joints_m.max() == 774
    assert groups[0][1][0].joints_m.min() == 800


def test_whole_recordings_are_held_out_by_kind() -> None:
    training, groups = gather(
        [recording("ring 1", numbered(100))],
        [recording("ring 2", numbered(100)), recording("ring 3", numbered(100))],
        0.2,
        25,
    )
    assert len(training) == 1
    assert [(name, len(clips)) for name, clips in groups] == [("ring", 2)]


def test_nothing_is_both_learned_and_validated() -> None:
    one = recording("a", numbered(100))
    with pytest.raises(InputError, match="a: found to learn from and to validate"):
        gather([one], [one], 0.2, 25)


@pytest.mark.parametrize(
    ("learned", "held_out", "said"),
    [
        (recording("a", numbered(100)), None, "validate"),
        (recording("a", numbered(10)), recording("b", numbered(100)), "learn"),
        (recording("a", None), recording("b", numbered(100)), "truth"),
    ],
)
def test_too_little_motion_is_said(
    learned: Recording, held_out: Recording | None, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        gather([learned], [held_out] if held_out else [], 0.2, 25)


def test_simulated_people_are_drawn_less_than_real_ones() -> None:
    clips, _ = gather(
        [recording("real", numbered(100)), recording("simulated ring", numbered(900))],
        [recording("b", numbered(100))],
        0.0,
        25,
    )
    seconds = {c.name.split(",")[0]: c.weight * len(c.joints_m) for c in clips}
    share = seconds["simulated ring"] / sum(seconds.values())
    assert share == pytest.approx(0.2)
