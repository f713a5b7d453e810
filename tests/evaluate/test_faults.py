"""Replays in which cameras die, views are lost and frames are few."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.evaluate.faults import arriving, capacity_j, deaths_s, downsampled, parse_kill
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording
from e3pose.settings.faults import Faults, Kill
from e3pose.simulate import DetectorSettings, SceneSettings, simulate


@cache
def scene() -> Recording:
    return simulate(
        SceneSettings(people=2, seconds=4, cameras=4, detector=DetectorSettings(perfect=True)), 5
    )


def run(recording: Recording, **settings: object) -> list[SlotRecord]:
    policy = {"policy": "round-robin", "num_selected": 2, **settings}
    return list(replay(recording, ReplaySettings(pipeline="paper", **policy)))  # type: ignore[arg-type]


@each_case(
    ("text", "kill"),
    [
        ("cam2@100", Kill("cam2", slot=100)),
        ("cam2@12.5s", Kill("cam2", time_s=12.5)),
        ("each@0", Kill("each", slot=0)),
        ("a@b@3s", Kill("a@b", time_s=3.0)),
    ],
)
def test_kills_are_read(text: str, kill: Kill) -> None:
    assert parse_kill(text) == kill


@each_case("text", ["cam2", "@3", "cam2@", "cam2@-1", "cam2@1.5", "cam2@1e9", "x@s"])
def test_what_is_no_kill_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"--kill-camera: found .*expected CAMERA@SLOT"):
        parse_kill(text)


def test_the_earliest_death_counts_and_each_takes_the_phase() -> None:
    recording = replace(scene(), dies_at_s={"cam1": 2.0, "cam2": 1.0})
    kills = [Kill("cam1", slot=25), Kill("cam2", time_s=3.0), Kill("each", time_s=0.5)]
    assert deaths_s(recording, kills, phase=7).tolist() == [np.inf, 1.0, 1.0, 0.5]
    with pytest.raises(InputError, match="--kill-camera: found 'eve', expected one of cam0"):
        deaths_s(recording, [Kill("eve", slot=1)])


def test_a_dead_camera_is_never_selected_again() -> None:
    of_itself = replace(scene(), dies_at_s={"cam1": 1.2})
    for recording, kills in (
        (scene(), (Kill("cam1", slot=30),)), (scene(), (Kill("cam1", time_s=1.2),)), (of_itself, ())
    ):  # fmt: skip
        awake = np.stack([record.selected for record in run(recording, faults=Faults(kills))])
        assert awake[:30, 1].mean() > 0.4
        assert not awake[30:, 1].any()
        # From the order on that could know of it, the others take its turns.
        assert (awake[31:].sum(axis=1) == 2).all()


def test_lost_views_cost_energy_but_do_not_arrive() -> None:
    records = run(scene(), policy="all", faults=Faults(loss=0.3))
    selected = np.stack([record.selected for record in records])
    arrived = np.stack([record.arrived for record in records])
    assert selected.mean() > 0.9  # but for cameras that seem dead for a moment
    assert 0.25 < (selected & ~arrived).sum() / selected.sum() < 0.35
    again = np.stack([r.arrived for r in run(scene(), policy="all", faults=Faults(loss=0.3))])
    other = run(scene(), policy="all", seed=1, faults=Faults(loss=0.3))
    assert (again == arrived).all()
    assert (np.stack([record.arrived for record in other]) != arrived).any()


def test_policies_lose_the_same_views() -> None:
    every = np.stack([arriving(4, 0.4, 3, slot) for slot in range(100)])
    turns = run(scene(), seed=3, faults=Faults(loss=0.4))
    for record, came in zip(turns, every, strict=True):
        assert (record.arrived == record.selected & came).all()


@each_case("loss", [-0.1, 1.1, float("nan")])
def test_a_loss_is_a_share(loss: float) -> None:
    with pytest.raises(InputError, match="--loss: found"):
        next(replay(scene(), ReplaySettings(faults=Faults(loss=loss))))


def test_everything_may_be_lost() -> None:
    records = run(scene(), faults=Faults(loss=1.0))
    assert not any(record.arrived.any() for record in records)
    gone = Faults(tuple(Kill(f"cam{i}", slot=20) for i in range(4)))
    assert not any(record.selected.any() for record in run(scene(), faults=gone)[20:])


def test_empty_batteries_end_cameras() -> None:
    """12 W active and 6 W idle for 4 s: 36 J are 3 s of activity, or 6 s of idleness."""
    recording = replace(scene(), battery_wh={"cam0": 36 / 3600, "cam1": 36 / 3600})
    assert capacity_j(recording).tolist() == pytest.approx([36, 36, np.inf, np.inf])
    watts = ((12.0,) * 4, (6.0,) * 4)
    always = np.stack(
        [r.selected for r in run(recording, policy="all", faults=Faults(watts=watts))]
    )
    assert always[:75].all() and not always[76:, :2].any() and always[76:, 2:].all()
    unlimited = np.stack([r.selected for r in run(recording, policy="all")])
    assert unlimited.all()


def test_thinning_keeps_views_times_and_truth_together() -> None:
    slow = downsampled(replace(scene(), scored_slots=(10, 60)), 10)
    assert slow.fps == 10 and slow.num_slots == 40 and slow.truth is not None
    truth = scene().truth
    assert truth is not None
    for slot in range(slow.num_slots):
        before = int(np.rint(slot * 2.5))
        np.testing.assert_array_equal(slow.truth.joints_m[slot], truth.joints_m[before])
        for camera in range(4):
            old, new = scene().view(before, camera), slow.view(slot, camera)
            assert old is not None and new is not None
            np.testing.assert_array_equal(old.keypoints_px, new.keypoints_px)
            time_s = slow.views[camera].times_s[slot]
            assert time_s == pytest.approx(before / 25) and abs(time_s - slot / 10) <= 0.02 + 1e-9
    assert slow.scored_slots == (4, 24)


def test_thinning_keeps_losses_lost() -> None:
    dying = simulate(SceneSettings(scene="dying-cameras", people=1, seconds=2), 0)
    slow = downsampled(dying, 5)
    for old, new in zip(dying.views, slow.views, strict=True):
        assert new.slots.tolist() == [s for s in range(10) if s * 5 in set(old.slots.tolist())]


def test_thinning_to_the_same_rate_changes_nothing_and_no_rate_is_made_up() -> None:
    assert downsampled(scene(), scene().fps) is scene()
    for fps in (0.0, 30.0, -1.0, float("nan")):
        with pytest.raises(InputError, match="--fps: found"):
            downsampled(scene(), fps)
