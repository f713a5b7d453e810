"""The real trainer: goes on from the weights that run, never looks at what is held back."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: pip install e3pose[train]")
pytest.importorskip("onnx", reason="onnx is not installed: pip install e3pose[train]")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")

from e3pose.base.clock import WallClock
from e3pose.edge.learn import LearningSettings, OnlineTrainer
from e3pose.edge.learn.job import Job
from e3pose.edge.learn.ring_buffer import Chunk, Ring
from e3pose.edge.learn.versions import VersionStore
from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.predict.attention_lstm import SHIPPED

FPS = 10.0
SETTINGS = LearningSettings(
    interval_s=1 / FPS, leads=(1, 5), held_back_s=20.0, least_s=40.0, every_s=0.0, train_s=60.0,
    steps=40, learning_rate=2e-3, least_windows=20,
)  # fmt: skip


def swinging(slots: range, seed: int = 0) -> Chunk:
    """Somebody who waves evenly, which no velocity tells but who has seen it before can."""
    rng = np.random.default_rng(seed)
    pose = rng.normal(size=(17, 3)) * 0.4
    swing = 0.2 * rng.normal(size=(17, 3))
    time_s = np.array(slots)[:, None, None] / FPS
    joints = pose + swing * np.sin(5 * time_s) + 0.003 * rng.normal(size=(len(slots), 17, 3))
    return Chunk(
        seed,
        np.array(slots),
        People(
            np.zeros(len(slots), dtype=np.int64),
            joints.astype(np.float32),
            np.full((len(slots), 17), 0.9, np.float16),
        ),
    )


def site(folder: Path, seconds: int = 60) -> Path:
    ring = Ring(folder / "poses", COCO17, 2**30)
    for first in range(0, seconds, 10):
        ring.write(swinging(range(10 * first, 10 * first + 100)))
    return folder


def trained(folder: Path, settings: LearningSettings = SETTINGS) -> OnlineTrainer:
    trainer = OnlineTrainer(folder, COCO17, settings, WallClock(), background=False)
    trainer.run_once()
    until = time.monotonic() + 120
    while trainer.training and time.monotonic() < until:
        time.sleep(0.05)
        trainer.run_once()
        if trainer.current or "not tried" in trainer.events[-1]:
            break
    trainer.close()
    return trainer


def test_motion_of_the_room_is_learned_and_taken(tmp_path: Path) -> None:
    trainer = trained(site(tmp_path))
    assert trainer.current == 1, trainer.events
    (version,) = VersionStore(tmp_path / "versions").read().versions
    assert all(
        new < 0.98 * old for new, old in zip(version.error_m, version.parent_error_m, strict=True)
    )
    weights = VersionStore(tmp_path / "versions").weights(version)
    assert weights.read_bytes() != SHIPPED.read_bytes()
    card = weights.with_suffix(".md").read_text(encoding="utf-8")
    assert "the newest minutes, estimated" in card


def test_the_result_does_not_depend_on_what_is_held_back(tmp_path: Path) -> None:
    results = []
    for name, seed in (("one", 0), ("two", 5)):  # the newest 20 s of the second are of another
        folder = tmp_path / name
        ring = Ring(folder / "poses", COCO17, 2**30)
        for first in range(0, 60, 10):
            ring.write(swinging(range(10 * first, 10 * first + 100), 0 if first < 40 else seed))
        settings = replace(SETTINGS, steps=3, train_s=1000.0)
        trained(folder, settings)
        results.append((folder / "job" / "attention-lstm.onnx").read_bytes())
        verdict = json.loads((folder / "job" / "verdict.json").read_text())
        results.append(verdict["base_error_m"])
    assert results[0] == results[2] and results[1] != results[3]


def test_a_trainer_without_memory_changes_nothing(tmp_path: Path) -> None:
    trainer = trained(site(tmp_path), replace(SETTINGS, memory_bytes=64 * 2**20))
    assert trainer.current == 0 and "next attempt in" in trainer.events[-1]


def test_damaged_poses_are_left_out(tmp_path: Path) -> None:
    folder = site(tmp_path, 80)
    trainer = OnlineTrainer(folder, COCO17, SETTINGS, WallClock(), background=False)
    (folder / "poses" / "00000002.npz").write_bytes(b"damaged since")
    trainer.run_once()
    until = time.monotonic() + 120
    while trainer.training and time.monotonic() < until:
        time.sleep(0.05)
        trainer.run_once()
        if trainer.current:
            break
    trainer.close()
    assert trainer.current == 1, trainer.events


def test_a_trainer_whose_edge_is_gone_ends(tmp_path: Path) -> None:
    folder = site(tmp_path)
    files = sorted(str(path) for path in (folder / "poses").glob("*.npz"))
    job = Job(
        parent=2**22 + 1, joints=COCO17.joints, interval_s=0.1, learn=tuple(files[:4]),
        held_back=tuple(files[4:]), base=str(SHIPPED), leads=(1,), steps=10**9, train_s=600.0,
        learning_rate=1e-3, memory_bytes=2**32, seed=0,
    )  # fmt: skip
    (tmp_path / "job").mkdir()
    (tmp_path / "job" / "job.json").write_bytes(msgspec.json.encode(job))
    result = subprocess.run(
        [sys.executable, "-m", "e3pose_lab.train.online", str(tmp_path / "job")],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.returncode == 2 and "edge has ended" in result.stderr
