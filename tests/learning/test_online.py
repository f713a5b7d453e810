"""The online trainer with trainers that succeed, fail, die, hang and lie; no torch anywhere."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from e3pose.clock import ManualClock
from e3pose.errors import InputError
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.learning import LearningSettings, OnlineTrainer
from e3pose.learning.rehearse import rehearse
from e3pose.pipeline import SlotRecord
from e3pose.pose import Poses3D
from e3pose.simulate import SceneSettings, simulate
from e3pose.skeleton import COCO17

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed: pip install e3pose[edge]")

FAKE = """
import hashlib, json, os, pathlib, signal, sys, time
mode, folder = sys.argv[1], pathlib.Path(sys.argv[2])
job = json.loads((folder / "job.json").read_text())
base = pathlib.Path(job["base"]).read_bytes()
new, better = base, 0.9
if mode == "crash": raise RuntimeError("out of\\x1bluck")
if mode == "killed": os.kill(os.getpid(), signal.SIGKILL)
if mode == "hang": time.sleep(600)
if mode == "no torch": print("torch is not installed", file=sys.stderr); sys.exit(3)
if mode == "silent": sys.exit(0)
if mode == "garbage": new = b"no network at all"
if mode == "worse": better = 1.1
if mode == "hardly": better = 0.99
errors = [0.02 * lead for lead in job["leads"]]
mine = [better * error for error in errors]
if mode == "one lead": mine[-1] = errors[-1]
if mode == "nan": mine[0] = float("nan")
verdict = {"base_sha256": hashlib.sha256(base).hexdigest(), "windows": 300,
           "sha256": hashlib.sha256(new).hexdigest(),
           "leads": job["leads"], "error_m": mine, "base_error_m": errors}
if mode == "few": verdict["windows"] = 3
if mode == "other base": verdict["base_sha256"] = "0" * 64
if mode == "other leads": verdict["leads"] = verdict["leads"][1:]
if mode == "changed": new = new + b"!"
(folder / "attention-lstm.onnx").write_bytes(new)
(folder / "model-card.md").write_text("# Card\\n")
text = json.dumps(verdict)
if mode == "half": text = text[:40]
if mode == "huge": text = "[" * 20_000_000
(folder / "verdict.json").write_text(text)
"""
SETTINGS = LearningSettings(
    interval_s=0.1, leads=(1, 5), held_back_s=4.0, least_s=8.0, every_s=100.0, train_s=5.0,
    back_off_s=10.0, longest_back_off_s=70.0, chunk_s=1.0,
)  # fmt: skip


Make = Callable[..., OnlineTrainer]


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(10**18)


@pytest.fixture
def make(tmp_path: Path, clock: ManualClock) -> Iterator[Make]:
    script = tmp_path / "fake.py"
    script.write_text(FAKE)
    made: list[OnlineTrainer] = []

    def trainer(mode: str, settings: LearningSettings = SETTINGS) -> OnlineTrainer:
        command = (sys.executable, str(script), mode)
        one = OnlineTrainer(
            tmp_path / "site", COCO17, settings, clock, command=command, background=False
        )
        made.append(one)
        return one

    yield trainer
    for one in made:
        one.close()


def live(trainer: OnlineTrainer, slots: int, start: int = 0) -> None:
    """Let a system run in which two people glide."""
    pose = np.random.default_rng(0).normal(size=(2, 17, 3)) * 0.3
    for slot in range(start, start + slots):
        joints = pose + np.array([0.01 * slot, 0, 0])
        trainer.collect(
            SlotRecord(
                slot=slot,
                time_s=0.1 * slot,
                selected=np.ones(3, dtype=bool),
                arrived=np.ones(3, dtype=bool),
                poses=Poses3D(joints, np.ones((2, 17))),
                track_ids=np.arange(2),
                occlusion=np.zeros(3),
                deficit=np.zeros(3),
                next_selection=np.ones(3, dtype=bool),
            )
        )
        trainer.write_waiting()


def trained(trainer: OnlineTrainer) -> str:
    """Begin a training that is due, or wait for the one that runs; return the last event."""
    if not trainer.training:
        trainer.attend()
        assert trainer.training, trainer.events
    wait(trainer)
    return trainer.events[-1]


def wait(trainer: OnlineTrainer) -> None:
    """Attend until no training runs."""
    for _ in range(3000):
        if not trainer.training:
            return
        time.sleep(0.01)
        trainer.attend()
    raise AssertionError("the training does not end")


def test_a_better_network_is_handed_over_once_and_survives_a_restart(make: Make) -> None:
    trainer = make("good")
    live(trainer, 100)
    assert trainer.poll() is None
    assert "version 1 runs" in trained(trainer)
    predictor = trainer.poll()
    assert predictor is not None
    assert trainer.poll() is None
    assert trainer.current == 1
    history = np.random.default_rng(0).normal(size=(10, 2, 17, 3))
    assert np.isfinite(predictor.predict(history, 0.1, 5).joints_m).all()
    (version,) = trainer.versions()
    assert version.parent == 0 and version.windows == 300
    np.testing.assert_allclose(version.error_m, np.multiply(version.parent_error_m, 0.9))
    trainer.close()
    again = make("good")
    assert again.current == 1 and again.poll() is not None


def test_little_motion_begins_nothing(make: Make) -> None:
    trainer = make("good")
    live(trainer, 70)
    trainer.attend()
    assert not trainer.training and trainer.events == ()


def test_the_newest_minutes_are_held_back_and_old_ones_learned(make: Make) -> None:
    trainer = make("hang")
    live(trainer, 100)
    trainer.attend()
    assert trainer._trainer is not None
    job = trainer._trainer.job
    assert [Path(p).stem for p in job.learn] == [f"{n:08d}" for n in range(1, 7)]
    assert [Path(p).stem for p in job.held_back] == [f"{n:08d}" for n in range(7, 11)]


@pytest.mark.parametrize("mode", ["worse", "hardly", "one lead", "few"])
def test_a_network_that_is_not_better_is_not_taken(make: Make, mode: str) -> None:
    trainer = make(mode)
    live(trainer, 100)
    assert "nothing is changed" in trained(trainer)
    assert trainer.poll() is None and trainer.current == 0 and trainer.versions() == ()


@pytest.mark.parametrize(
    ("mode", "said"),
    [
        ("crash", "ended with code 1: RuntimeError: out of luck"),
        ("killed", "killed by SIGKILL"),
        ("silent", r"verdict\.json"),
        ("garbage", "no readable network"),
        ("nan", r"verdict\.json"),
        ("half", r"verdict\.json: found no verdict"),
        ("huge", r"verdict\.json"),
        ("other base", "base weights"),
        ("other leads", "leads: found"),
        ("changed", "new weights"),
    ],
)
def test_a_trainer_that_fails_or_lies_changes_nothing_and_is_left_alone_for_longer_and_longer(
    make: Make, clock: ManualClock, mode: str, said: str
) -> None:
    trainer = make(mode)
    live(trainer, 100)
    assert re.search(said, trained(trainer)), trainer.events
    assert trainer.poll() is None and trainer.current == 0 and trainer.versions() == ()
    assert "not tried again for 10 s" in trainer.events[-1]
    clock.advance(9.0)
    trainer.attend()
    assert not trainer.training
    clock.advance(2.0)
    assert "not tried again for 20 s" in trained(trainer)


def test_waiting_grows_to_a_bound(make: Make, clock: ManualClock) -> None:
    trainer = make("crash")
    live(trainer, 100)
    waits = []
    for _ in range(5):
        waits.append(trained(trainer).split("again for ")[1])
        clock.advance(71.0)
    assert waits == ["10 s", "20 s", "40 s", "70 s", "70 s"]


def test_without_torch_it_is_long_before_the_next_attempt(make: Make) -> None:
    trainer = make("no torch")
    live(trainer, 100)
    assert "torch is not installed; not tried again for 70 s" in trained(trainer)


def test_a_trainer_that_cannot_be_started_changes_nothing(make: Make) -> None:
    trainer = make("good")
    trainer.command = ("/nowhere/python",)
    live(trainer, 100)
    trainer.attend()
    assert not trainer.training and "/nowhere/python" in trainer.events[-1]


def test_a_trainer_that_hangs_is_ended(make: Make, clock: ManualClock) -> None:
    trainer = make("hang")
    live(trainer, 100)
    trainer.attend()
    assert trainer._trainer is not None
    process = trainer._trainer.process
    clock.advance(2 * SETTINGS.train_s + 61.0)
    trainer.attend()
    assert not trainer.training and process.poll() == -signal.SIGKILL
    assert "took too long" in trainer.events[-1]


def test_a_trainer_killed_from_outside_changes_nothing(make: Make) -> None:
    trainer = make("hang")
    live(trainer, 100)
    trainer.attend()
    assert trainer._trainer is not None
    assert os.getpriority(os.PRIO_PROCESS, trainer._trainer.pid) == 19
    os.kill(trainer._trainer.pid, signal.SIGKILL)
    assert "killed by SIGKILL" in trained(trainer)


def test_closing_ends_the_training(make: Make) -> None:
    trainer = make("hang")
    live(trainer, 100)
    trainer.attend()
    assert trainer._trainer is not None
    process = trainer._trainer.process
    trainer.close()
    assert process.poll() == -signal.SIGKILL


def test_what_was_held_back_is_learned_later_and_only_new_minutes_judge(
    make: Make, clock: ManualClock
) -> None:
    trainer = make("good")
    live(trainer, 100)
    trained(trainer)
    clock.advance(200.0)
    live(trainer, 30, start=100)  # too few new seconds
    trainer.attend()
    assert not trainer.training
    live(trainer, 20, start=130)
    trainer.attend()
    assert trainer._trainer is not None
    job = trainer._trainer.job
    assert [int(Path(p).stem) for p in job.held_back] == [12, 13, 14, 15]
    assert job.base.endswith("000001.onnx")


def test_going_back_hands_over_the_earlier_network(make: Make) -> None:
    trainer = make("good")
    live(trainer, 100)
    trained(trainer)
    trainer.poll()
    assert trainer.rollback() == 0
    trainer.attend()
    assert trainer.current == 0 and trainer.poll() is not None
    assert trainer.rollback(1) == 1
    trainer.attend()
    assert trainer.current == 1 and trainer.poll() is not None
    with pytest.raises(InputError, match="version 5"):
        trainer.rollback(5)


def test_a_choice_made_during_a_training_stands(make: Make, clock: ManualClock) -> None:
    trainer = make("good")
    live(trainer, 100)
    trained(trainer)
    clock.advance(200.0)
    live(trainer, 60, start=100)
    trainer.attend()
    assert trainer.training
    trainer.rollback(0)
    wait(trainer)
    assert trainer.current == 0 and "another version was chosen" in trainer.events[-1]


def test_a_damaged_version_gives_way_to_the_one_before(make: Make, tmp_path: Path) -> None:
    trainer = make("good")
    live(trainer, 100)
    trained(trainer)
    trainer.close()
    (tmp_path / "site" / "versions" / "000001.onnx").write_bytes(b"damaged")
    again = make("good")
    assert again.current == 0 and again.poll() is None
    assert "version 1 is refused" in again.events[0]


def test_a_damaged_list_of_versions_is_put_aside(make: Make, tmp_path: Path) -> None:
    (tmp_path / "site" / "versions").mkdir(parents=True)
    (tmp_path / "site" / "versions" / "versions.json").write_bytes(b"{")
    trainer = make("good")
    assert trainer.current == 0 and "moved to versions.json.damaged" in trainer.events[0]


def test_a_full_disk_loses_poses_and_nothing_else(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer = make("good")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("e3pose.learning.ring.np.savez", full)
    live(trainer, 20)
    trainer.attend()
    assert "poses lost" in trainer.events[-1] and "no space left" in trainer.events[-1].lower()


def test_a_disk_that_never_answers_fills_no_memory(make: Make) -> None:
    trainer = make("good")
    trainer.write_waiting = lambda: None  # type: ignore[method-assign]
    live(trainer, 500)
    assert trainer._waiting.qsize() <= 8 and "too slow" in trainer.events[-1]
    del trainer.write_waiting


def test_only_one_process_learns_in_a_folder(make: Make) -> None:
    make("good")
    with pytest.raises(InputError, match="another process learns there"):
        make("good")


def test_a_swap_loses_no_slot_and_no_person(make: Make) -> None:
    recording = simulate(SceneSettings(people=2, seconds=12.0, fps=10.0, cameras=3), seed=4)
    settings = ReplaySettings(policy="all", num_selected=3, backend="reference", pipeline="paper")
    expected = list(replay(recording, settings))
    trainer = make("good")
    collected: list[SlotRecord] = []
    gather = trainer.collect

    def both(record: SlotRecord) -> None:
        collected.append(record)
        gather(record)

    trainer.collect = both  # type: ignore[method-assign]
    slots = []
    for slot in rehearse(recording, settings, trainer):
        slots.append(slot)
        trainer.attend()
        if slot.slot == 100:  # nobody may rely on a trainer's speed
            wait(trainer)
    assert [slot.slot for slot in slots] == list(range(recording.num_slots))
    assert sum(slot.swapped for slot in slots) == 1 and {s.version for s in slots} == {0, 1}
    for one, two in zip(collected, expected, strict=True):
        np.testing.assert_array_equal(one.track_ids, two.track_ids)
        np.testing.assert_array_equal(one.poses.joints_m, two.poses.joints_m)


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
        "from e3pose.clock import WallClock\n"
        "from e3pose.learning import LearningSettings, OnlineTrainer\n"
        "from e3pose.skeleton import COCO17\n"
        f"t = OnlineTrainer(Path({str(tmp_path / 'site')!r}), COCO17, LearningSettings(0.1),"
        " WallClock(), background=False)\n"
        "t.attend(); t.close(); print(*(m for m in sys.modules if m.startswith('e3pose.train')))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == []
