"""Jobs and results exchanged with the trainer as files, checked on both sides."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import msgspec

from e3pose.base.bounded import UNDECODABLE, read_bytes
from e3pose.base.errors import InputError
from e3pose.predict.attention_lstm import MAX_WEIGHTS_BYTES

JOB, VERDICT, WEIGHTS, CARD, COMPLAINTS = (
    "job.json", "verdict.json", "attention-lstm.onnx", "model-card.md", "stderr.txt",
)  # fmt: skip
MAX_JOB_BYTES = 16 * 2**20
MAX_CARD_BYTES = 2**20


class Job(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A training.

    Attributes:
        parent: process that ends the training by ending.
        joints: of the skeleton.
        interval_s: seconds per slot.
        learn: files of poses to learn from, oldest first.
        held_back: files that are never learned from, the newest.
        base: weights to go on from.
        leads: slots ahead to compare at.
        steps: batches at most.
        train_s: seconds at most.
        learning_rate: the largest.
        memory_bytes: to allocate at most.
        seed: of windows.
    """

    parent: int
    joints: tuple[str, ...]
    interval_s: float
    learn: tuple[str, ...]
    held_back: tuple[str, ...]
    base: str
    leads: tuple[int, ...]
    steps: int
    train_s: float
    learning_rate: float
    memory_bytes: int
    seed: int


class Verdict(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Scores of a new network and of the running one on the held-back minutes.

    Attributes:
        base_sha256: of the weights that were gone on from.
        sha256: of the new ones.
        leads: slots ahead.
        error_m: mean errors of the new network, metres.
        base_error_m: of the running one on the same windows.
        windows: how many.
    """

    base_sha256: str
    sha256: str
    leads: tuple[int, ...]
    error_m: tuple[float, ...]
    base_error_m: tuple[float, ...]
    windows: int

    def better(self, margin: float) -> bool:
        """Tell whether the new error is lower by more than `margin` of the old at every lead."""
        pairs = zip(self.error_m, self.base_error_m, strict=True)
        return all(new < (1 - margin) * old for new, old in pairs)


def read_job(folder: Path) -> Job:
    """Read a training job; raise `InputError` for any other content."""
    path = folder / JOB
    try:
        return msgspec.json.decode(read_bytes(path, MAX_JOB_BYTES), type=Job)
    except UNDECODABLE as error:
        raise InputError(f"{path}: found no job ({error})") from None


def read_result(folder: Path, job: Job) -> tuple[Verdict, bytes, str]:
    """Return the verdict, the new weights and their card.

    Raises:
        InputError: when anything is missing, damaged or about something else than `job`.
    """
    path = folder / VERDICT
    try:
        verdict = msgspec.json.decode(read_bytes(path, MAX_JOB_BYTES), type=Verdict)
    except UNDECODABLE as error:
        raise InputError(f"{path}: found no verdict ({error})") from None
    errors = (*verdict.error_m, *verdict.base_error_m)
    if verdict.leads != job.leads or len(errors) != 2 * len(job.leads):
        raise InputError(f"{path}: leads: found {verdict.leads[:60]}, expected {job.leads}")
    if not all(math.isfinite(error) and 0 < error < 100 for error in errors):
        raise InputError(f"{path}: errors: found {errors[:60]}, expected metres")
    for name, file, said in (
        ("base", Path(job.base), verdict.base_sha256),
        ("new", folder / WEIGHTS, verdict.sha256),
    ):
        if hashlib.sha256(read_bytes(file, MAX_WEIGHTS_BYTES)).hexdigest() != said:
            raise InputError(f"{path}: {name} weights: found others than {file}")
    card = read_bytes(folder / CARD, MAX_CARD_BYTES).decode("utf-8", errors="replace")
    return verdict, read_bytes(folder / WEIGHTS, MAX_WEIGHTS_BYTES), card
