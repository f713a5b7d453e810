"""True motion -> what the filter makes of it: the histories that a running system hands over.

Simulated detectors of the recording's cameras observe its people, the loop runs on what they see,
and what it shows of somebody slot after slot is what a predictor is given; the truth is what it
should say. Neither pace nor rate of such a clip can be changed afterwards, as the filter's errors
depend on both: every replay has its own.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.estimate.base import Estimate
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.camera import Rig
from e3pose.predict.normalise import NUM_COMMON, common_columns
from e3pose.recording import Recording, ViewSeries
from e3pose.simulate import DetectorSettings
from e3pose_lab.prediction.normalise import to_common
from e3pose_lab.train.estimates import joined
from e3pose_lab.train.watched import watched
from e3pose_lab.train.windows import Clip, between_frames
from e3pose_lab.workers import Workers

FPS = (11.0, 31.0)  # what live sites run at
LOG_PACE = 0.2  # people move faster or slower by up to this
LOG_NOISE = 0.4  # detectors err more or less by up to this than the filter believes
POLICIES = ("information", "round-robin")  # in turn
MIN_CAMERAS = 2


@dataclass(frozen=True, slots=True)
class ReplayedSettings:
    """Settings of the replays to learn from.

    Attributes:
        replays: of every recording with truth; 0 for none.
        predictor: weights that correct the filter's velocities, as in a running system; None for
            the filter alone.
        seed: of cameras, rates, paces and detectors.
    """

    replays: int = 0
    predictor: Path | None = None
    seed: int = 0


def replayed_clips(
    recording: Recording,
    shortest: int,
    stretches: Sequence[tuple[int, int]],
    settings: ReplayedSettings,
    workers: Workers,
    progress: Callable[[float], None] = lambda share: None,
) -> list[Clip]:
    """Return the true motion of everybody with the errors of replays, one clip a replay.

    Args:
        recording: with truth and at least two cameras; its views are not used.
        shortest: slots of the shortest clip of use.
        stretches: half-open ranges of slots that may be learned from.
        settings: what is replayed.
        workers: who does it; the result does not depend on them.
        progress: called with the share that is done.

    Raises:
        InputError: when the recording has one camera.
    """
    if len(recording.rig) < MIN_CAMERAS:
        found = f"recording {recording.name}: cameras: found {len(recording.rig)}"
        raise InputError(f"{found}, expected {MIN_CAMERAS} or more to replay it, or --replays 0")
    allowed = np.zeros(recording.num_slots, dtype=bool)
    for start, stop in stretches:
        allowed[start:stop] = True
    clips = []
    shared = recording, allowed, settings
    tasks = range(settings.replays)
    for number, found_clips in enumerate(workers.run(_replayed, shared, tasks), start=1):
        clips += [part for clip in found_clips for part in clip.without_gaps(shortest)]
        progress(number / settings.replays)
    return clips


def _replayed(
    shared: tuple[Recording, NDArray[np.bool_], ReplayedSettings], number: int
) -> list[Clip]:
    """Replay once; return everybody's clip, NaN where it may not be learned from."""
    recording, allowed, settings = shared
    rng = np.random.default_rng([settings.seed, number, zlib.crc32(recording.name.encode())])
    seen, at = _seen(recording, rng)
    truth = seen.truth
    assert truth is not None
    columns = common_columns(seen.skeleton)
    joints = to_common(truth.joints_m, columns)
    errors = np.full((*joints.shape[:2], 1, NUM_COMMON, 3), np.nan, dtype=np.float16)
    published: list[Estimate] = []
    most = len(seen.rig)
    counts = np.arange(1, most + 1)  # few cameras are usual, and err most
    count = int(rng.choice(counts, p=(1 / counts) / (1 / counts).sum()))
    replaying = ReplaySettings(
        policy=POLICIES[number % len(POLICIES)],
        num_selected=count,
        predictor="constant-velocity" if settings.predictor is None else str(settings.predictor),
        phase=number,
    )
    for record in replay(seen, replaying, publish=published.append):
        found = to_common(published.pop().people.joints_m, columns)
        target = joints[record.slot]
        rows, people = joined(target, found)
        errors[record.slot, rows, 0] = found[people] - target[rows]
    joints[~allowed[np.rint(at).astype(np.int64)]] = np.nan
    return [
        Clip(
            f"{recording.name}, {name}", joints[:, person].astype(np.float32), seen.fps,
            errors_m=errors[:, person], replayed=True,
        )
        for person, name in enumerate(truth.person_ids)
    ]  # fmt: skip


def _seen(recording: Recording, rng: np.random.Generator) -> tuple[Recording, Floats]:
    """Return the recording at some pace and rate as some of its cameras see it, and its frames."""
    truth = recording.truth
    assert truth is not None
    fps = float(rng.uniform(*FPS))
    step = recording.fps / fps * math.exp(rng.uniform(-LOG_PACE, LOG_PACE))
    at = np.arange(0, recording.num_slots - 1, step)
    moved = replace(truth, joints_m=between_frames(truth.joints_m, at))
    kept = int(rng.integers(MIN_CAMERAS, len(recording.rig) + 1))
    cameras = np.sort(rng.permutation(len(recording.rig))[:kept]).tolist()
    rig = Rig(tuple(recording.rig.cameras[camera] for camera in cameras))
    noise = math.exp(rng.uniform(-LOG_NOISE, LOG_NOISE))
    nothing = ViewSeries.from_views([], [], [], len(recording.skeleton))
    there = replace(
        recording, rig=rig, fps=fps, num_slots=len(at), truth=moved, views=(nothing,) * kept,
        scored_slots=None, videos={}, battery_wh={}, dies_at_s={},
    )  # fmt: skip
    seed = int(rng.integers(2**31))
    return watched(there, seed, detector=DetectorSettings(noise=noise)), at
