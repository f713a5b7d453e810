"""An online trainer that learns beside a running system; no torch anywhere."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.edge.learn.trainer import SETTINGS, Make, begun, live, trained, wait
from tests.manual_clock import ManualClock

from e3pose.base.errors import InputError
from e3pose.edge.learn import OnlineTrainer
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.skeleton import COCO17
from e3pose.pipeline import SlotRecord
from e3pose.simulate import SceneSettings, simulate
from e3pose_lab.train.rehearse import rehearse

pytestmark = pytest.mark.slow

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed: pip install e3pose[edge]")


def test_a_better_network_is_handed_over_once_and_survives_a_restart(make: Make) -> None:
    trainer = make("good")
    assert trainer.poll() is None
    assert "version 1 in use" in trained(trainer)
    predictor = trainer.poll()
    assert predictor is not None
    assert trainer.poll() is None
    assert trainer.current == 1
    history = np.random.default_rng(0).normal(size=(10, 2, 17, 3))
    assert np.isfinite(predictor.predict(history, 0.1, 5).joints_m).all()
    (version,) = trainer.store.read().versions
    assert version.parent == 0 and version.windows == 300
    np.testing.assert_allclose(version.error_m, np.multiply(version.parent_error_m, 0.9))
    trainer.close()
    again = make("good", 0)
    assert again.current == 1 and again.poll() is not None


def test_the_newest_minutes_are_held_back_and_old_ones_learned_until_it_is_closed(
    make: Make,
) -> None:
    trainer = make("hang", 70)
    trainer.run_once()
    assert not trainer.training and trainer.events == ()  # of little motion nothing
    live(trainer, 30, start=70)
    begin = begun(trainer)
    assert [Path(p).stem for p in begin.job.learn] == [f"{n:08d}" for n in range(1, 7)]
    assert [Path(p).stem for p in begin.job.held_back] == [f"{n:08d}" for n in range(7, 11)]
    trainer.close()
    assert begin.process.poll() == -signal.SIGKILL


@pytest.mark.parametrize("mode", ["worse", "hardly", "one lead", "few"])
def test_a_network_that_is_not_better_is_not_taken(make: Make, mode: str) -> None:
    trainer = make(mode)
    assert "no change:" in trained(trainer)
    assert trainer.poll() is None and trainer.current == 0 and trainer.store.read().versions == ()


def test_what_was_held_back_is_learned_later_and_only_new_minutes_judge(
    make: Make, clock: ManualClock
) -> None:
    trainer = make("good")
    trained(trainer)
    clock.advance(200.0)
    live(trainer, 30, start=100)  # too few new seconds
    trainer.run_once()
    assert not trainer.training
    live(trainer, 20, start=130)
    job = begun(trainer).job
    assert [int(Path(p).stem) for p in job.held_back] == [12, 13, 14, 15]
    assert job.base.endswith("000001.onnx")


def test_going_back_hands_over_the_earlier_network(make: Make) -> None:
    trainer = make("good")
    trained(trainer)
    trainer.poll()
    assert trainer.store.back() == 0
    trainer.run_once()
    assert trainer.current == 0 and trainer.poll() is not None
    trainer.store.use(1)
    trainer.run_once()
    assert trainer.current == 1 and trainer.poll() is not None
    with pytest.raises(InputError, match="version: found 5"):
        trainer.store.use(5)


def test_a_choice_made_during_a_training_stands(make: Make, clock: ManualClock) -> None:
    trainer = make("good")
    trained(trainer)
    clock.advance(200.0)
    live(trainer, 60, start=100)
    trainer.run_once()
    assert trainer.training
    trainer.store.use(0)
    wait(trainer)
    assert trainer.current == 0 and "another version was selected" in trainer.events[-1]


def test_a_swap_loses_no_slot_and_no_person(make: Make) -> None:
    recording = simulate(SceneSettings(people=2, seconds=12.0, fps=10.0, cameras=3), seed=4)
    settings = ReplaySettings(policy="all", num_selected=3, pipeline="paper")
    expected = list(replay(recording, settings))
    trainer = make("good", 0)
    collected: list[SlotRecord] = []
    gather = trainer.collect

    def both(record: SlotRecord) -> None:
        collected.append(record)
        gather(record)

    trainer.collect = both  # type: ignore[method-assign]
    slots = []
    for slot in rehearse(recording, settings, trainer):
        slots.append(slot)
        trainer.run_once()
        if slot.slot == 100:  # nobody may rely on a trainer's speed
            wait(trainer)
    assert [slot.slot for slot in slots] == list(range(recording.num_slots))
    assert sum(slot.swapped for slot in slots) == 1 and {s.version for s in slots} == {0, 1}
    for one, two in zip(collected, expected, strict=True):
        np.testing.assert_array_equal(one.people.track_ids, two.people.track_ids)
        np.testing.assert_array_equal(one.people.joints_m, two.people.joints_m)


def test_the_thread_beside_the_edge_does_it_all(make: Make, tmp_path: Path) -> None:
    trainer = OnlineTrainer(
        tmp_path / "site",
        COCO17,
        replace(SETTINGS, every_s=0.0),
        ManualClock(10**18),
        command=(sys.executable, str(tmp_path / "fake.py"), "good"),
    )
    try:
        live(trainer, 100)
        until = time.monotonic() + 30
        predictor = None
        while predictor is None and time.monotonic() < until:
            predictor = trainer.poll()
            time.sleep(0.005)
    finally:
        trainer.close()
    assert predictor is not None
    assert trainer.current == 1


def test_the_edge_never_loads_torch(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['torch'] = None\n"  # any import of it fails
        "from pathlib import Path\n"
        "from e3pose.base.clock import WallClock\n"
        "from e3pose.edge.learn import LearningSettings, OnlineTrainer\n"
        "from e3pose.model.skeleton import COCO17\n"
        f"t = OnlineTrainer(Path({str(tmp_path / 'site')!r}), COCO17, LearningSettings(0.1),"
        " WallClock(), background=False)\n"
        "t.run_once(); t.close(); print(*(m for m in sys.modules if '.learn.train' in m))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == []
