"""A trainer that succeeds, fails, dies, hangs or lies, on request; and what it learns from."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from e3pose.edge.learn import LearningSettings, OnlineTrainer
from e3pose.model.people import People
from e3pose.pipeline import SlotRecord

FAKE = """
import hashlib, json, os, pathlib, signal, sys, time
mode, folder = sys.argv[1], pathlib.Path(sys.argv[2])
job = json.loads((folder / "job.json").read_text())
base = pathlib.Path(job["base"]).read_bytes()
new, better = base, 0.9
if mode == "crash": raise RuntimeError("out of\\x1bluck")
if mode == "killed": os.kill(os.getpid(), signal.SIGKILL)
if mode == "hang": time.sleep(600)
if mode == "no torch": print("torch is not installed", file=sys.stderr); sys.exit(2)
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


def live(trainer: OnlineTrainer, slots: int, start: int = 0) -> None:
    """Let a system run in which two people glide."""
    pose = np.random.default_rng(0).normal(size=(2, 17, 3)) * 0.3
    for slot in range(start, start + slots):
        joints = pose + np.array([0.01 * slot, 0, 0])
        people, all_on, zero = People(np.arange(2), joints), np.ones(3, dtype=bool), np.zeros(3)
        trainer.collect(SlotRecord(slot, 0.1 * slot, all_on, all_on, people, zero, zero, all_on))
        trainer.write_waiting()


def begun(trainer: OnlineTrainer) -> Any:
    """Begin a training that is due, and return it."""
    trainer.run_once()
    assert trainer._trainer is not None
    return trainer._trainer


def trained(trainer: OnlineTrainer) -> str:
    """Begin a training that is due, or wait for the one that runs; return the last event."""
    if not trainer.training:
        trainer.run_once()
        assert trainer.training, trainer.events
    wait(trainer)
    return trainer.events[-1]


def wait(trainer: OnlineTrainer) -> None:
    """Attend until no training runs."""
    for _ in range(3000):
        if not trainer.training:
            return
        time.sleep(0.01)
        trainer.run_once()
    raise AssertionError("the training does not end")
