"""How good a network is on motion that it never saw, beside the simple predictors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import isotonic_regression

from e3pose.base.arrays import Floats
from e3pose_lab.prediction.normalise import fill_gaps, normalise, to_person
from e3pose_lab.train.network import AttentionLstm
from e3pose_lab.train.windows import DAMPING, Clip, Estimates, Windows, estimation_noise

NOISE_M = 0.035  # of a joint, like triangulated OpenPose keypoints
MISSING = 0.2
MAX_WINDOWS = 400  # of one kind of motion: quick, and no recording drowns the others
OTHER_RATES = (5.0, 15.0, 60.0)  # a second, at which motion that is known is examined too
SAME_RATE = 0.2  # share by which rates differ that count as the same
CURVE_GROUPS = 8  # of expected errors, per lead
REPLAYED = "replayed"  # kind of exam
SMALLEST_M = 1e-5  # no error is smaller


@dataclass(frozen=True, slots=True, eq=False)
class Exam:
    """One kind of held-out motion, with exact or with noisy histories.

    Attributes:
        name: recordings and kind of history: exact, noisy, or as estimators gave it.
        windows: what the network is given and should say.
        simple_m: `(3, num_leads)` mean errors of zero, constant and damped velocity in metres.
    """

    name: str
    windows: Windows
    simple_m: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """Errors of a network in one exam.

    Attributes:
        name: of the exam.
        error_m: `(num_leads,)` mean errors in metres.
        expected_m: `(num_leads,)` mean of the errors that it expected.
        simple_m: `(3, num_leads)` mean errors of zero, constant and damped velocity.
        each_m: `(2, num_leads, number of joints)` expected and actual error of every joint.
    """

    name: str
    error_m: Floats
    expected_m: Floats
    simple_m: Floats
    each_m: Floats = field(default_factory=lambda: np.zeros((2, 0, 0)))

    @property
    def ratio(self) -> Floats:
        """`(num_leads,)` error over that of the best simple predictor."""
        return np.asarray(self.error_m / self.simple_m.min(axis=0))


def make_exams(
    groups: Sequence[tuple[str, Sequence[Clip]]], history_slots: int, num_leads: int
) -> list[Exam]:
    """Return an exam with exact and one with noisy histories for every group of clips.

    Motion that was estimated has one exam, with histories as estimated, and so has motion that was
    replayed. Motion that is known is examined at other frame rates too.
    """
    exams = []
    for name, clips in [*groups, *_other_rates(groups, history_slots + num_leads)]:
        known = [clip for clip in clips if clip.errors_m is None]
        estimated = [clip for clip in clips if clip.errors_m is not None and not clip.replayed]
        replayed = [clip for clip in clips if clip.replayed]
        for some, noise_m, missing, kind in (
            (known, 0.0, 0.0, "exact"),
            (known, NOISE_M, MISSING, "noisy"),
            (estimated, 0.0, 0.0, "estimated"),
            (replayed, 0.0, 0.0, REPLAYED),
        ):
            if some:
                exams.append(
                    _exam(f"{name}, {kind}", some, history_slots, num_leads, noise_m, missing)
                )
    return exams


def _other_rates(
    groups: Sequence[tuple[str, Sequence[Clip]]], span: int
) -> list[tuple[str, list[Clip]]]:
    """Return the groups again at other frame rates, where they are long enough."""
    others = []
    for name, clips in groups:
        for fps in OTHER_RATES:
            clips_there = [
                replace(clip, joints_m=joints, fps=fps)
                for clip in clips
                if clip.errors_m is None and abs(clip.fps / fps - 1) > SAME_RATE
                if len(joints := resampled(clip.joints_m, clip.fps / fps)) >= span
            ]
            if clips_there:
                others.append((f"{name} at {fps:g} slots per second", clips_there))
    return others


def resampled(joints_m: NDArray[np.float32], step: float) -> NDArray[np.float32]:
    """Return motion `(num_slots, NUM_COMMON, 3)` at every `step`th slot, by cubic splines."""
    at = np.arange(0, len(joints_m) - 1 + 1e-9, step)
    spline = CubicSpline(np.arange(len(joints_m)), joints_m, axis=0)
    return np.asarray(spline(at), dtype=np.float32)


def _exam(
    name: str,
    clips: Sequence[Clip],
    history_slots: int,
    num_leads: int,
    noise_m: float,
    missing: float,
) -> Exam:
    rng = np.random.default_rng(0)
    span = history_slots + num_leads
    number = sum(max(len(clip.joints_m) - span, 0) for clip in clips)
    stride = max(1, number // MAX_WINDOWS)
    pieces, rates, owners, slots = [], [], [], []
    for row, clip in enumerate(clips):
        starts = np.arange(0, len(clip.joints_m) - span + 1, stride)
        pieces.append(clip.joints_m[starts[:, None] + np.arange(span)])
        rates.append(np.full(len(starts), clip.fps))
        owners.append(np.full(len(starts), row))
        slots.append(starts[:, None] + np.arange(history_slots))
    joints = np.concatenate(pieces).astype(np.float64).swapaxes(0, 1)
    interval = 1 / np.concatenate(rates)
    history, future = joints[:history_slots], joints[history_slots:]
    level = np.full(len(interval), noise_m)
    history = history + estimation_noise(history_slots, level, interval, rng)
    history += Estimates(clips).draw(rng, np.concatenate(owners), np.concatenate(slots))
    history[rng.random(history.shape[:3]) < missing] = np.nan
    normal = normalise(history, interval, history_slots)
    filled = fill_gaps(history)[0]
    ahead = np.arange(1, num_leads + 1)[:, None, None, None]
    damped = np.cumsum(DAMPING ** np.arange(1, num_leads + 1))[:, None, None, None]
    simple = [
        filled[-1] + 0.0 * ahead,
        filled[-1] + ahead * (filled[-1] - filled[-2]),
        filled[-1] + damped * (filled[-1] - filled[-3]) / 2,
    ]
    errors = np.array([_mean_error(s + np.zeros_like(future), future, normal.seen) for s in simple])
    windows = Windows(normal, to_person(normal, future), errors.min(axis=0)[:, None])
    return Exam(name, windows, errors)


def examine(network: AttentionLstm, exams: Sequence[Exam]) -> list[Marks]:
    """Return the marks of the network, which is left in evaluation mode."""
    network.eval()
    marks = []
    for exam in exams:
        normal, future = exam.windows.normal, exam.windows.future_m
        with torch.no_grad():
            places, log_error = network(
                torch.from_numpy(normal.features), torch.from_numpy(normal.context), len(future)
            )
        error = np.linalg.norm(places.numpy().astype(np.float64) - future, axis=-1)
        expected = np.exp(log_error.numpy().astype(np.float64))
        each = np.stack([expected, error])[:, :, normal.seen]
        expected_mean, mean = each.mean(axis=-1)
        marks.append(Marks(exam.name, mean, expected_mean, exam.simple_m, each))
    return marks


def score(marks: Sequence[Marks]) -> float:
    """Return one number, lower is better: mean ratio to the best simple predictor.

    Where there are replayed histories they alone count: those are what a running system gives.
    """
    replayed = [mark for mark in marks if mark.name.endswith(REPLAYED)]
    return float(np.mean([mark.ratio.mean() for mark in replayed or marks]))


def error_curves(marks: Sequence[Marks]) -> Floats:
    """Return per lead what to make of expected errors, so that they are right at every size.

    Returns:
        `(2, num_leads, CURVE_GROUPS)`: logarithms of expected and of actual errors, both rising.
    """
    both = np.concatenate([mark.each_m for mark in marks], axis=-1)
    order = np.argsort(both[0], axis=-1)
    sorted_m = np.take_along_axis(both, order[None], axis=-1)
    groups = np.array_split(sorted_m, CURVE_GROUPS, axis=-1)
    curves = np.stack([group.mean(axis=-1) for group in groups], axis=-1)
    curves[1] = [isotonic_regression(row).x for row in curves[1]]
    return np.asarray(np.log(np.maximum(curves, SMALLEST_M)))


def _mean_error(places_m: Floats, future_m: Floats, seen: NDArray[np.bool_]) -> Floats:
    """Return `(num_leads,)`: mean over people and joints that the history shows."""
    apart = np.linalg.norm(places_m - future_m, axis=-1)
    return np.asarray((apart * seen).sum(axis=(1, 2)) / seen.sum())
