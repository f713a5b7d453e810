"""Motion to train on in a recording: its truth or its estimates, without evaluation slots."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from e3pose.base.errors import InputError
from e3pose.recording import Recording
from e3pose_lab.train.clips import clips_of
from e3pose_lab.train.estimates import EstimateSettings, estimated_clips
from e3pose_lab.train.replayed import ReplayedSettings, replayed_clips
from e3pose_lab.train.windows import Clip
from e3pose_lab.workers import Workers

Target = Literal["auto", "truth", "estimates", "least-occluded"]
Stretch = tuple[int, int]

LEAST_OCCLUDED = 3  # cameras: as many as the paper selects


@dataclass(frozen=True, slots=True)
class ClipSettings:
    """Which motion of recordings to train on.

    Attributes:
        target: `truth`, `estimates` (what all cameras together see), `least-occluded` (what the
            three cameras with the least occlusion see), or `auto`: the truth of recordings that
            have it outside their scored slots, else estimates.
        include_scored: learn from slots in which systems are evaluated too.
        estimates: what to make of the cameras.
        replayed: what the filter makes of true motion, beside that motion itself.
    """

    target: Target = "auto"
    include_scored: bool = False
    estimates: EstimateSettings = field(default_factory=EstimateSettings)
    replayed: ReplayedSettings = field(default_factory=ReplayedSettings)


def training_clips(
    recording: Recording,
    shortest: int,
    settings: ClipSettings,
    workers: Workers,
    progress: Callable[[float], None] = lambda share: None,
) -> list[Clip]:
    """Return the motion of a recording to train on.

    Args:
        recording: with truth, or with detections of two cameras or more.
        shortest: slots of the shortest clip of use.
        settings: what to learn.
        workers: who fuses the cameras and replays.
        progress: called with the share of the fusing or replaying that is done.

    Raises:
        InputError: when the recording has neither what is asked for, nor slots to learn it from.
    """
    true = settings.target == "truth" or (settings.target == "auto" and _has_truth(recording))
    stretches = free_stretches(recording, settings.include_scored)
    if not stretches:
        raise InputError(
            f"recording {recording.name}: found no slot that is not scored, expected some; "
            "--include-scored learns from scored slots, and the model card says so"
        )
    if true:
        clips = clips_of(recording, shortest, stretches)
        if settings.replayed.replays:
            clips += replayed_clips(
                recording, shortest, stretches, settings.replayed, workers, progress
            )
    else:
        _check_views(recording)
        least = LEAST_OCCLUDED if settings.target == "least-occluded" else 0
        estimates = replace(settings.estimates, least_occluded=least)
        clips = estimated_clips(recording, shortest, stretches, estimates, workers, progress)
    scored = settings.include_scored and recording.scored_slots is not None
    return [replace(clip, scored=scored) for clip in clips]


def free_stretches(recording: Recording, include_scored: bool) -> list[Stretch]:
    """Return the half-open ranges of slots that may be learned from.

    The slots that a recording declares scored may not, unless `include_scored`.
    """
    if include_scored or recording.scored_slots is None:
        return [(0, recording.num_slots)]
    first, stop = recording.scored_slots
    return [(a, b) for a, b in ((0, first), (stop, recording.num_slots)) if a < b]


def _has_truth(recording: Recording) -> bool:
    if recording.truth is None:
        return False
    known = np.asarray(recording.truth.annotated.any(axis=(1, 2)))
    return any(known[a:b].any() for a, b in free_stretches(recording, False))


def _check_views(recording: Recording) -> None:
    seeing = sum(bool(np.any(series.scores > 0)) for series in recording.views)
    if seeing < 2:
        raise InputError(
            f"recording {recording.name}: detections: found those of {seeing} cameras, expected "
            "two or more, or truth"
        )
