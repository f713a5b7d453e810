"""The trainer beside a running edge: `python -m e3pose_lab.train.online FOLDER`.

A process of its own at the lowest priority, with one thread and bounded memory, which the system
ends first when memory runs out. It goes on from the weights that run, learns from older poses, and
compares on the newest.
"""

from __future__ import annotations

import hashlib
import os
import resource
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from e3pose.base.atomic import write_file
from e3pose.base.bounded import read_bytes
from e3pose.base.errors import Exit, InputError
from e3pose.base.installing import not_installed
from e3pose.edge.learn.job import CARD, VERDICT, WEIGHTS, Job, Verdict, read_job
from e3pose.edge.learn.ring_buffer import load_chunk
from e3pose.model.skeleton import Skeleton
from e3pose.predict.attention_lstm import MAX_WEIGHTS_BYTES

if TYPE_CHECKING:
    from e3pose_lab.train.windows import Clip

BATCH = 128
CALIBRATION_SHARE = 0.1  # of the motion: not learned from, to fit the expected errors on
OOM_SCORE = "1000"  # the first to go


def main(arguments: Sequence[str]) -> int:
    """Do the job in a folder; return the exit code."""
    step_back()
    try:
        folder = Path(arguments[0])
        job = read_job(folder)
        bound_memory(job.memory_bytes)
        _work(folder, job)
    except ModuleNotFoundError as error:
        print(not_installed(error.name, "train"), file=sys.stderr)
        return Exit.REFUSED
    except (InputError, OSError, IndexError, MemoryError) as error:
        print(str(error) or type(error).__name__, file=sys.stderr)
        return Exit.FAULT
    return Exit.DONE


def step_back() -> None:
    """Leave the processor and the memory to others."""
    with suppress(OSError):
        os.nice(19)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)


def bound_memory(limit: int) -> None:
    """Let allocations beyond `limit` bytes fail, here rather than at the edge."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))


def clips_of(
    paths: Sequence[str], skeleton: Skeleton, interval_s: float, shortest: int
) -> list[Clip]:
    """Return the motion in files of poses; damaged files are left out, and named."""
    from e3pose_lab.train.collected import collected_clips

    chunks = []
    for path in paths:
        try:
            chunks.append(load_chunk(Path(path), skeleton.joints))
        except InputError as error:
            print(error, file=sys.stderr)
    return collected_clips(chunks, skeleton, interval_s, shortest)


def _work(folder: Path, job: Job) -> None:
    import torch

    from e3pose_lab.train.attention_lstm import Training, TrainSettings
    from e3pose_lab.train.card import model_card
    from e3pose_lab.train.clips import hold_out_ends
    from e3pose_lab.train.export import export, halved
    from e3pose_lab.train.validation import error_curves, examine, make_exams
    from e3pose_lab.train.weights import network_of
    from e3pose_lab.train.windows import Corruption, Sampler

    torch.set_num_threads(1)
    base = read_bytes(Path(job.base), MAX_WEIGHTS_BYTES)
    running, _ = network_of(base, job.base)
    leads = max(15, *job.leads)
    shape = running.settings.history_slots, leads
    span = sum(shape)
    skeleton = Skeleton("collected", job.joints, ())
    clips = clips_of(job.learn, skeleton, job.interval_s, span)
    held_back = clips_of(job.held_back, skeleton, job.interval_s, span)
    if not clips or not held_back:
        raise InputError(f"found {len(clips)} and {len(held_back)} stretches, expected more")
    learned, calibration = hold_out_ends(clips, CALIBRATION_SHARE, span)
    if not calibration:
        learned, calibration = clips[:-1] or clips, clips[-1:]

    settings = TrainSettings(
        network=running.settings,
        num_leads=leads,
        steps=job.steps,
        minutes=job.train_s / 60,
        batch=BATCH,
        learning_rate=job.learning_rate,
        seed=job.seed,
    )
    run = Training(settings)
    run.take_up(running)
    fps = 1 / job.interval_s
    sampler = Sampler(learned, *shape, (fps, fps))
    while run.done < 1 and os.getppid() == job.parent:
        began = time.monotonic()
        torch.manual_seed(job.seed + run.step)
        rng = np.random.default_rng([job.seed, run.step])
        run.advance(sampler.draw(rng, BATCH, Corruption()))
        run.elapsed_s += time.monotonic() - began
    if os.getppid() != job.parent:
        raise InputError("the edge has ended")

    new = run.averaged()
    halved(new)
    curves = error_curves(examine(new, make_exams([("calibration", calibration)], *shape)))
    exams = make_exams([("the newest minutes", held_back)], *shape)
    (after,), (before,) = examine(new, exams), examine(running, exams)
    content = export(new, [1.0] * leads, curves, half=True)
    write_file(folder / WEIGHTS, content)
    card = model_card(asdict(settings), run.step, learned, held_back, [after])
    write_file(folder / CARD, card)
    verdict = Verdict(
        base_sha256=hashlib.sha256(base).hexdigest(),
        sha256=hashlib.sha256(content).hexdigest(),
        leads=job.leads,
        error_m=tuple(float(after.error_m[lead - 1]) for lead in job.leads),
        base_error_m=tuple(float(before.error_m[lead - 1]) for lead in job.leads),
        windows=exams[0].windows.normal.features.shape[1],
    )
    write_file(folder / VERDICT, msgspec.json.encode(verdict))  # last: its being there means all is


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
