"""Recordings -> clips: stretches of one person's motion without gaps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.predict.normalise import common_columns
from e3pose.recording import Recording
from e3pose_lab.prediction.normalise import to_common
from e3pose_lab.train.windows import Clip

LONG_S = 60.0  # stretches this long spare their end for validation
SIMULATED = "simulated "  # how the names of simulated recordings begin
REPLAYED_SHARE = 0.5  # of the training windows, where there are others
SIMULATED_SHARE = 0.2  # of the training windows, where there is other motion: it is less varied

Groups = list[tuple[str, list[Clip]]]


def gather(
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    hold_out: float,
    shortest: int,
    motion: Callable[[Recording, int], list[Clip]] | None = None,
) -> tuple[list[Clip], Groups]:
    """Return the clips to learn from, and groups of clips to validate on, apart from each other.

    Args:
        recordings: to learn from.
        validation: never learned from.
        hold_out: share of the end of every long stretch of `recordings` that is for validation.
        shortest: slots of the shortest clip of use.
        motion: returns the clips of a recording; those of its truth by default.

    Raises:
        InputError: when a recording has no truth or is in both, or nothing is left for either side.
    """
    both = {r.name for r in recordings} & {r.name for r in validation}
    if both:
        raise InputError(f"train: {sorted(both)[0]}: found to learn from and to validate on")
    motion = motion or clips_of
    training: list[Clip] = []
    groups: Groups = []
    for recording in recordings:
        kept, spared = hold_out_ends(motion(recording, shortest), hold_out, shortest)
        training += kept
        if spared:
            groups.append((f"{recording.name}, the end", spared))
    # Short recordings of one kind are examined together: few windows tell little.
    together: dict[str, list[Clip]] = {}
    for recording in validation:
        kind = recording.name.split()[0] if recording.name else "unnamed"
        together.setdefault(kind, []).extend(motion(recording, shortest))
    groups += [(kind, clips) for kind, clips in together.items() if clips]
    if not training or not groups:
        side = "learn from" if not training else "validate on"
        raise InputError(
            f"train: found no motion of {shortest} slots to {side}, expected longer recordings"
            + ("" if not training else " given by --validate, or a minute long")
        )
    return _balanced(training), groups


def clips_of(
    recording: Recording, shortest: int, stretches: Sequence[tuple[int, int]] | None = None
) -> list[Clip]:
    """Return the stretches of at least `shortest` slots in which every common joint is known.

    Args:
        recording: with truth.
        shortest: slots of the shortest clip of use.
        stretches: half-open ranges of slots to use; all by default.

    Raises:
        InputError: when the recording has no truth.
    """
    truth = recording.truth
    if truth is None:
        raise InputError(f"recording {recording.name}: truth: found none, expected 3D poses")
    joints = to_common(truth.joints_m, common_columns(truth.skeleton))
    clips = []
    for person, name in enumerate(truth.person_ids):
        for start, stop in stretches or [(0, recording.num_slots)]:
            stretch = joints[start:stop, person].astype(np.float32)
            whole = Clip(f"{recording.name}, {name}", stretch, recording.fps)
            clips += whole.without_gaps(shortest)
    return clips


def hold_out_ends(
    clips: Sequence[Clip], share: float, shortest: int
) -> tuple[list[Clip], list[Clip]]:
    """Split every long clip in time: its end is for validation, a window's length apart."""
    training, validation = [], []
    for clip in clips:
        length = len(clip.joints_m)
        cut = round(length * (1 - share))
        if length < LONG_S * clip.fps or min(cut - shortest, length - cut) < shortest:
            training.append(clip)
            continue
        training.append(clip.cut(0, cut - shortest))
        validation.append(clip.cut(cut))
    return training, validation


def _balanced(clips: Sequence[Clip]) -> list[Clip]:
    """Draw alike from every second of motion, but less from simulated people, and half replayed."""
    made_up = np.array([clip.name.startswith(SIMULATED) for clip in clips])
    replayed = np.array([clip.replayed for clip in clips])
    fps = np.array([clip.fps for clip in clips])
    drawn = np.array([len(clip.joints_m) for clip in clips]) / fps
    for kind in (replayed, ~replayed):
        factor = _factor(drawn, kind & made_up, kind & ~made_up, SIMULATED_SHARE)
        drawn[kind & made_up] *= min(1.0, factor)
    drawn[replayed] *= _factor(drawn, replayed, ~replayed, REPLAYED_SHARE)
    weights = drawn / np.array([len(clip.joints_m) for clip in clips])
    return [replace(clip, weight=float(w)) for clip, w in zip(clips, weights, strict=True)]


def _factor(
    drawn: NDArray[np.float64], some: NDArray[np.bool_], others: NDArray[np.bool_], share: float
) -> float:
    """Return the factor of `some` that makes them `share` of these and `others`."""
    if not (some.any() and others.any()):
        return 1.0
    return float(share / (1 - share) * drawn[others].sum() / drawn[some].sum())
