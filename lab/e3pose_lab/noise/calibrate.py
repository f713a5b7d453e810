"""Measure a detector's noise on a recording, without labels (docs/explanation/keypoint-noise.md).

all-camera replay -> tracks -> their detections -> leave one view out -> sigma by score
                                                        |                  |
                          made-up noise of that sigma and memory, the same way: what comes back?
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.base.errors import InputError
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.camera import Rig
from e3pose.model.noise import IMAGE_PX, ErrorMemory, Noise
from e3pose.model.noises import detector_of, load_noise
from e3pose.model.projection import project
from e3pose.recording import Recording, ViewSeries
from e3pose.simulate.noise import GROSS_MEMORY, GROSS_SIGMA_PX, correlated, normal_cdf
from e3pose_lab.noise.residuals import MIN_SLOTS, Observed, assign_detections, leave_one_out
from e3pose_lab.noise.smoother import smooth
from e3pose_lab.noise.statistics import Statistics, describe, falling, fit_memory

if TYPE_CHECKING:
    from e3pose.pipeline import SlotRecord

Replayed = Callable[[Iterable["SlotRecord"]], Iterable["SlotRecord"]]
Progress = Callable[[str, int, int], None]  # what is done, how much of it, of how much

LEAST_CAMERAS = 3
PASSES = 2  # the reference weighs keypoints by the noise that the pass before found
# A view's shift bends the reference of all others, so it is taken out in steps.
SHIFT_PASSES, SHIFT_STEP = 6, 0.7
ROUNDS = 2  # of making noise up and looking what comes back
LEAST_SIGMA_PX = 0.1  # of an image of 1000 pixels: exact detections have no noise at all
BELIEVABLE = (0.3, 2.0)  # of the sigma that was made up, what may come back


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """The noise of a detector as one recording shows it.

    Attributes:
        noise: sigma by score and memory, corrected for the error of the reference.
        measured: what the residuals themselves are like.
        shifts_px: `(num_cameras, 2)` what was taken out of every keypoint of a camera.
        people: tracks that were compared.
        slots: of the recording.
        learned: `(num_cameras,)` what the estimator found while it ran, over the noise file of the
            detector that the recording names; NaN where it saw too little.
    """

    noise: Noise
    measured: Statistics
    shifts_px: Floats
    people: int
    slots: int
    learned: Floats


def calibrate_noise(
    recording: Recording,
    *,
    seconds: float = 120.0,
    without_shifts: bool = False,
    replayed: Replayed = iter,
    progress: Progress = lambda what, done, total: None,
) -> Calibrated:
    """Measure the noise of the detector that made a recording.

    Args:
        recording: with three cameras or more; its truth is not looked at.
        seconds: how much of the recording is used, from its start.
        without_shifts: take out what shifts all keypoints of a camera alike, as wrong calibration
            does: it is of this rig and not of the detector.
        replayed: wraps the slots of the replay.
        progress: hears how the rest goes on.

    Raises:
        InputError: when the recording has too few cameras or shows too little.
    """
    rig = recording.rig
    if len(rig) < LEAST_CAMERAS:
        raise InputError(
            f"{recording.name}: found {len(rig)} cameras, expected at least {LEAST_CAMERAS}: "
            "a view is compared with what two others say"
        )
    num_slots = min(recording.num_slots, max(1, round(seconds / recording.interval_s)))
    tracks, learned = all_camera_tracks(recording, num_slots, replayed)
    people = list(assign_detections(recording, tracks, num_slots))
    image_px = float(max(max(camera.image_size) for camera in rig.cameras))
    noise = load_noise(detector_of(recording)).in_images_of(image_px)
    scales = np.array([max(camera.image_size) for camera in rig.cameras]) / image_px

    def compared(what: str, whom: Sequence[Observed], belief: Noise) -> Statistics:
        residuals = leave_one_out(
            whom, rig, belief, recording.interval_s, lambda n: progress(what, n, len(whom))
        )
        return describe(residuals, recording.interval_s, image_px)

    shifts = np.zeros((len(rig), 2))
    for number in range(SHIFT_PASSES if without_shifts else PASSES):
        measured = compared(f"comparing, pass {number + 1}", people, noise)
        noise = _noise(measured.scores, measured.sigma_px, image_px)
        if without_shifts and number < SHIFT_PASSES - 1:
            found = np.zeros_like(shifts)
            for camera, view in measured.views.items():
                found[camera] = SHIFT_STEP * view.shift_px
            shifts += found
            off_px = (found * scales[:, None])[:, None]
            people = [replace(each, keypoints_px=each.keypoints_px - off_px) for each in people]
    corrected = replace(noise, memory=fit_memory(measured.autocorrelation))
    checks: list[Statistics] = []
    for number in range(ROUNDS):
        rng = np.random.default_rng([0, number])
        made_up = [
            _made_up(each, rig, noise, corrected, measured, recording, rng) for each in people
        ]
        again = compared(f"checking, round {number + 1}", made_up, noise)
        back = np.interp(measured.scores, again.scores, again.sigma_px)
        ratio = np.clip(back / corrected.of(measured.scores), *BELIEVABLE)
        sigma = falling(measured.sigma_px / ratio, measured.counts)
        corrected = replace(_noise(measured.scores, sigma, image_px), memory=corrected.memory)
        checks.append(again)
    memory = _corrected(corrected.memory, measured, checks)
    corrected = replace(corrected, memory=memory)
    return Calibrated(corrected, measured, shifts, len(people), num_slots, learned)


def all_camera_tracks(
    recording: Recording, num_slots: int, replayed: Replayed = iter
) -> tuple[list[tuple[Integers, Floats]], Floats]:
    """Return the tracks of the estimator with a memory, all cameras on.

    Returns:
        The slots and joints of everybody who stays; `(num_cameras,)` the noise that it learned,
        over that of the noise file.
    """
    part = first_slots(recording, num_slots)
    settings = ReplaySettings(
        pipeline="memory", policy="all", num_selected=len(recording.rig), predictor="zero-velocity"
    )
    slots: dict[int, list[int]] = {}
    poses: dict[int, list[Floats]] = {}
    learned = np.full(len(recording.rig), np.nan)
    for record in replayed(replay(part, settings)):
        if record.noise_factors is not None:
            learned = record.noise_factors
        for track, joints_m in zip(
            record.people.track_ids.tolist(), record.people.joints_m, strict=True
        ):
            slots.setdefault(track, []).append(record.slot)
            poses.setdefault(track, []).append(joints_m)
    long = [track for track, there in slots.items() if len(there) >= MIN_SLOTS]
    return [(np.array(slots[track]), np.stack(poses[track])) for track in long], learned


def _corrected(
    memory: ErrorMemory, measured: Statistics, checks: Sequence[Statistics]
) -> ErrorMemory:
    """Invert the bias of the measured error memory by simulation.

    Args:
        memory: error memory of the simulated noise.
        measured: statistics of the real residuals.
        checks: statistics of the residuals of simulated noise.
    """
    found = measured.autocorrelation
    lags = [lag for lag in found if all(lag in check.autocorrelation for check in checks)]
    given = memory.correlation(np.array(lags))
    back = [np.mean([check.autocorrelation[lag] for check in checks]) for lag in lags]
    wanted = np.array([found[lag] for lag in lags]) + given - np.array(back)
    return fit_memory(dict(zip(lags, wanted.tolist(), strict=True)))


def _made_up(
    person: Observed,
    rig: Rig,
    belief: Noise,
    noise: Noise,
    measured: Statistics,
    recording: Recording,
    rng: np.random.Generator,
) -> Observed:
    """Return the person with keypoints of known errors, in the same views with the same scores."""
    scales = np.array([max(c.image_size) for c in rig.cameras]) / noise.image_px
    seen = person.scores > 0
    sigma = np.where(seen, belief.of(person.scores, scales[:, None]), np.inf)
    path = smooth(
        person.keypoints_px, sigma, rig.projections, person.joints_m, recording.interval_s
    )
    pixels = np.ascontiguousarray(project(path, rig.projections)[0].swapaxes(0, 1))
    direction = correlated(rng, pixels.shape, recording.interval_s, noise.memory.parts)
    wild = normal_cdf(
        correlated(rng, person.scores.shape, recording.interval_s, GROSS_MEMORY)
    ) < np.interp(person.scores, measured.scores, measured.gross_share)
    spread = np.where(wild, GROSS_SIGMA_PX * noise.image_px / IMAGE_PX, noise.of(person.scores))
    errors = direction * (spread * scales[:, None])[..., None]
    return replace(person, keypoints_px=np.where(seen[..., None], pixels + errors, np.nan))


def _noise(scores: Floats, sigma_px: Floats, image_px: float) -> Noise:
    return Noise(scores, np.maximum(sigma_px, LEAST_SIGMA_PX * image_px / 1000), image_px)


def first_slots(recording: Recording, num_slots: int) -> Recording:
    """Return the slots before `num_slots`, without truth."""
    cut = []
    for series in recording.views:
        frames = int(np.searchsorted(series.slots, num_slots))
        poses = int(series.starts[frames])
        cut.append(
            ViewSeries(
                series.slots[:frames],
                series.times_s[:frames],
                series.starts[: frames + 1],
                series.keypoints_px[:poses],
                series.scores[:poses],
            )
        )
    views = tuple(cut)
    return replace(recording, truth=None, num_slots=num_slots, views=views, scored_slots=None)
