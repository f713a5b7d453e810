"""An online trainer whose training fails, lies, hangs or is killed, or whose disk does."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path

import pytest
from tests.edge.learn.trainer import SETTINGS, Make, begun, live, trained
from tests.manual_clock import ManualClock

from e3pose.base.errors import InputError

pytestmark = pytest.mark.slow

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed: pip install e3pose[edge]")


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
def test_a_trainer_that_fails_or_lies_changes_nothing(make: Make, mode: str, said: str) -> None:
    trainer = make(mode)
    assert re.search(said, trained(trainer)), trainer.events
    assert trainer.poll() is None and trainer.current == 0 and trainer.store.read().versions == ()


def test_it_is_left_alone_for_longer_and_longer_up_to_a_bound(
    make: Make, clock: ManualClock
) -> None:
    trainer = make("crash")
    waits = [trained(trainer).split("attempt in ")[1]]
    clock.advance(9.0)
    trainer.run_once()
    assert not trainer.training
    for _ in range(4):
        clock.advance(71.0)
        waits.append(trained(trainer).split("attempt in ")[1])
    assert waits == ["10 s", "20 s", "40 s", "70 s", "70 s"]


def test_without_torch_it_is_long_before_the_next_attempt(make: Make) -> None:
    trainer = make("no torch")
    assert "torch is not installed; next attempt in 70 s" in trained(trainer)


def test_a_trainer_that_cannot_be_started_changes_nothing(make: Make) -> None:
    trainer = make("good")
    trainer.command = ("/nowhere/python",)
    trainer.run_once()
    assert not trainer.training and "/nowhere/python" in trainer.events[-1]


def test_a_trainer_that_hangs_is_ended(make: Make, clock: ManualClock) -> None:
    trainer = make("hang")
    process = begun(trainer).process
    assert os.getpriority(os.PRIO_PROCESS, process.pid) == 19
    clock.advance(2 * SETTINGS.train_s + 61.0)
    trainer.run_once()
    assert not trainer.training and process.poll() == -signal.SIGKILL
    assert "timed out" in trainer.events[-1]


def test_a_damaged_version_gives_way_to_the_one_before(make: Make, tmp_path: Path) -> None:
    trainer = make("good")
    trained(trainer)
    trainer.close()
    (tmp_path / "site" / "versions" / "000001.onnx").write_bytes(b"damaged")
    again = make("good", 0)
    assert again.current == 0 and again.poll() is None
    assert "version 1 rejected" in again.events[0]


def test_a_damaged_list_of_versions_is_put_aside(make: Make, tmp_path: Path) -> None:
    (tmp_path / "site" / "versions").mkdir(parents=True)
    (tmp_path / "site" / "versions" / "versions.json").write_bytes(b"{")
    trainer = make("good", 0)
    assert trainer.current == 0 and "moved to versions.json.damaged" in trainer.events[0]


def test_a_list_damaged_under_a_running_learner_keeps_what_runs(make: Make, tmp_path: Path) -> None:
    trainer = make("good")
    trained(trainer)
    assert trainer.poll() is not None and trainer.current == 1
    (tmp_path / "site" / "versions" / "versions.json").write_bytes(b"\0" * 100)
    trainer.run_once()
    assert trainer.current == 1 and trainer.poll() is None
    assert "moved to versions.json.damaged, version 1 runs" in trainer.events[-1]


def test_a_full_disk_loses_poses_and_nothing_else(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer = make("good", 0)

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("e3pose.edge.learn.ring_buffer.np.savez", full)
    live(trainer, 20)
    trainer.run_once()
    assert "poses lost" in trainer.events[-1] and "no space left" in trainer.events[-1].lower()


def test_a_disk_that_never_answers_fills_no_memory(make: Make) -> None:
    trainer = make("good", 0)
    trainer.write_waiting = lambda: None  # type: ignore[method-assign]
    live(trainer, 500)
    assert trainer._waiting.qsize() <= 8 and "too slow" in trainer.events[-1]
    del trainer.write_waiting


def test_only_one_process_learns_in_a_folder(make: Make) -> None:
    make("good", 0)
    with pytest.raises(InputError, match=r"poses: process [0-9]+ .*writes there already"):
        make("good", 0)
