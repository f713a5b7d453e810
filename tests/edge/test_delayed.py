"""Poses a second time: the same people, later, as the smoother with a fixed lag has them."""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.commands import run
from tests.manual_clock import ManualClock

from e3pose.base.errors import InputError
from e3pose.edge.publisher import Publisher
from e3pose.edge.send_queue import SendQueue
from e3pose.estimate.base import Estimate
from e3pose.estimate.smooth.delayed import Delayed, lag_slots
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.smoothed import smooth_records
from e3pose.recording import Recording, load_recording, save_recording
from e3pose.settings.edge import EdgeSettings
from e3pose.settings.site_file import load_site
from e3pose.simulate import SceneSettings, simulate
from e3pose.wire.arrays import unpack
from e3pose.wire.codec import decode
from e3pose.wire.site_messages import Poses


@cache
def scene() -> Recording:
    return simulate(SceneSettings(scene="ring", people=2, seconds=2, fps=12.5), seed=701)


def test_smoothing_compiles_nothing_more_once_it_is_warm() -> None:
    from e3pose.estimate.filter.motion import move_all
    from e3pose.estimate.filter.proportions import keep_all

    kernels: tuple[Any, ...] = (move_all, keep_all)
    delayed = Delayed(scene().skeleton, 3)
    delayed.warm_up()
    ready = [len(kernel.compiled.signatures) for kernel in kernels]
    people: list[Estimate] = []
    records = list(replay(scene(), ReplaySettings(num_selected=2), publish=people.append))
    posteriors = [each.posterior for each in people if each.posterior is not None]
    found = [delayed.push(*each) for each in zip(records, posteriors, strict=True)]
    assert any(late is not None and len(late.people) for late in found) and all(ready)
    assert [len(kernel.compiled.signatures) for kernel in kernels] == ready


def test_slots_come_as_late_as_in_a_replay() -> None:
    people: list[Estimate] = []
    records = list(replay(scene(), ReplaySettings(num_selected=2), publish=people.append))
    posteriors = [each.posterior for each in people if each.posterior is not None]
    wanted = smooth_records(records, posteriors, scene().skeleton, 3)
    delayed = Delayed(scene().skeleton, 3)
    found = [delayed.push(*each) for each in zip(records, posteriors, strict=True)]
    assert found[:3] == [None] * 3
    for slot, (late, record) in enumerate(zip(found[3:], wanted, strict=False)):
        assert late is not None and late.slot == record.slot == slot
        np.testing.assert_array_equal(late.people.joints_m, record.people.joints_m)
        np.testing.assert_array_equal(late.people.covariance_m2, record.people.covariance_m2)
    assert [late.slot for late in delayed.flush()] == [22, 23, 24]
    assert [lag_slots(delay_s, 0.04) for delay_s in (0.2, 0.01, 0.1)] == [5, 1, 2]
    delayed.push(records[0], posteriors[0])
    delayed.forget()
    assert list(delayed.flush()) == []


def test_the_papers_pipeline_has_nothing_to_smooth_with(tmp_path: Path) -> None:
    (tmp_path / "site.toml").write_text(
        'format = "e3pose-site"\nversion = 1\nname = "lab"\ncalibration = "rig.toml"\nfps = 25\n'
        'smooth_delay_ms = 200\n[loop]\npipeline = "paper"\n'
    )
    with pytest.raises(InputError, match="smooth_delay_ms: found with the pipeline paper"):
        load_site(tmp_path / "site.toml")


def test_a_replay_with_a_delay_writes_what_an_edge_publishes(tmp_path: Path) -> None:
    save_recording(scene(), tmp_path / "ring")
    recording = load_recording(tmp_path / "ring")
    poses = tmp_path / "poses.csv"
    words = ["--policy", "round-robin", "--cameras", "2", "--delay", "200ms"]
    assert run("replay", str(tmp_path / "ring"), *words, "--poses", str(poses)) == 0
    rows = list(csv.DictReader(poses.read_text().splitlines()))
    written = {
        (int(row["slot"]), int(row["track"]), row["joint"]): [float(row[axis]) for axis in "xyz"]
        for row in rows
    }

    settings = EdgeSettings("lab", recording.skeleton, 0.1, (), smooth_delay_s=0.2)
    queue, clock = SendQueue(), ManualClock()
    publisher = Publisher(settings, recording.rig, recording.interval_s, queue, clock)
    people: list[Estimate] = []
    replayed = replay(
        recording, ReplaySettings(policy="round-robin", num_selected=2), publish=people.append
    )
    none = np.zeros(len(recording.rig), dtype=bool)
    for record in replayed:
        publisher.publish(record.slot, 0, people[-1], {}, none)
        publisher.publish_delayed(record, 0, busy=False)
    published: list[Poses] = []

    def keep(topic: str, payload: bytes, slot: int) -> None:
        if topic.endswith("/poses-delayed"):
            published.append(decode(payload, Poses, "edge"))

    queue.send_waiting(keep)
    assert len(published) >= 20
    for message in published:
        joints_m = unpack(message.joints_m)
        for person, track in enumerate(unpack(message.track_ids).tolist()):
            for joint, place_m in zip(message.joints, joints_m[person], strict=True):
                row = written.get((message.slot, track, joint), [np.nan] * 3)
                np.testing.assert_allclose(row, place_m, atol=1e-5)
