"""Tracks -> training windows: a history as the estimator would give it, and what came then."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.model.noise import ErrorMemory
from e3pose.predict.normalise import NUM_COMMON
from e3pose_lab.prediction.normalise import Normalised, fill_gaps, normalise, to_person
from e3pose_lab.train.bodies import mirrored, other_bodies, swapped_arms, uneven_time

Real = TypeVar("Real", np.float32, np.float64)
# What windows are made of recorded motion: `bodies` for other rates, paces, sides, limbs and sizes;
# `motion` for the same without other limbs and sizes; `none` for motion as it was recorded, with
# estimates as targets too where there are some: the paper's expanded training set.
Variety = Literal["bodies", "motion", "none"]

USUAL_FPS = (24.0, 31.0)
LOG_ANY_FPS = (math.log(5.0), math.log(60.0))
# Root mean square error of one joint over all three axes together, metres.
LOG_NOISE_M = (math.log(0.002), math.log(0.06))
BACKWARDS = 0.15  # share of windows played backwards: seldom what people do, but never impossible
USUAL_SHARE = 0.55  # of the windows have a usual frame rate
LOG_PACE = 0.3  # people move faster or slower by up to this
UNEVEN = 0.3  # by how much the pace of a window changes at most
OTHER_ARMS = 0.15  # share of windows with somebody else's arms
DAMPING = 0.85  # a slot
MEMORY = ErrorMemory()  # of the estimator's error, on average: that of its detectors


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """One stretch of one person's true motion.

    Attributes:
        name: where it comes from.
        joints_m: `(num_slots, NUM_COMMON, 3)` metres, z up, without gaps.
        fps: slots per second.
        weight: how often it is drawn, relative to others of its length.
        errors_m: `(num_slots, num_estimates, NUM_COMMON, 3)` metres by which estimates were off,
            NaN where they lacked a joint; None where motion is known exactly and is spoilt instead.
        scored: whether it holds slots in which systems are evaluated.
        replayed: whether the errors are of one estimator slot after slot, at this pace and rate, so
            that windows keep both.
    """

    name: str
    joints_m: NDArray[np.float32]
    fps: float
    weight: float = 1.0
    errors_m: NDArray[np.float16] | None = None
    scored: bool = False
    replayed: bool = False

    def cut(self, start: int, stop: int | None = None) -> Clip:
        """Return the clip from slot `start` to before `stop`."""
        errors = None if self.errors_m is None else self.errors_m[start:stop]
        return replace(self, joints_m=self.joints_m[start:stop], errors_m=errors)

    def without_gaps(self, shortest: int) -> list[Clip]:
        """Return its stretches of at least `shortest` slots in which every joint is known."""
        known = np.isfinite(self.joints_m).all(axis=(1, 2))
        edges = np.flatnonzero(np.diff(np.concatenate([[0], known.view(np.int8), [0]])))
        return [
            self.cut(start, stop)
            for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
            if stop - start >= shortest
        ]


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """A batch: what the network is given, and where the joints then are in the person's frame.

    Attributes:
        normal: the histories.
        future_m: `(num_leads, num_windows, NUM_COMMON, 3)` metres in the person's frame.
        usual_m: `(num_leads, num_windows)` mean error of the best simple predictor: no motion,
            constant or damped motion from the same spoilt history.
    """

    normal: Normalised
    future_m: Floats
    usual_m: Floats


@dataclass(frozen=True, slots=True)
class Corruption:
    """How a batch's histories are spoilt.

    Attributes:
        exact: share of windows with exact positions.
        missing: share of windows with missing joints.
        short: share of windows of people who just entered.
        log_noise_m: range of the logarithm of a joint's error in metres, over all three axes.
    """

    exact: float = 0.35
    missing: float = 0.45
    short: float = 0.1
    log_noise_m: tuple[float, float] = LOG_NOISE_M


class Sampler:
    """Draw windows from clips at any frame rate, mirrored, scaled, at another pace, and spoilt.

    With `usual_fps` most windows have that frame rate, instead of rates around 27. `variety` says
    what is made of recorded motion, see `Variety`.
    """

    def __init__(
        self,
        clips: Sequence[Clip],
        history_slots: int,
        num_leads: int,
        usual_fps: tuple[float, float] = USUAL_FPS,
        variety: Variety = "bodies",
    ) -> None:
        self.usual_fps, self.variety = usual_fps, variety
        padded = [_padded(clip.joints_m) for clip in clips]
        self.frames = np.concatenate(padded)
        self.lengths = np.array([len(c.joints_m) for c in clips])
        self.offsets = np.cumsum([0, *(len(p) for p in padded)])[:-1] + 1
        self.fps = np.array([c.fps for c in clips])
        self.weights = self.lengths * np.array([c.weight for c in clips])
        self.replayed = np.array([c.replayed for c in clips])
        self.history_slots, self.num_leads = history_slots, num_leads
        self.estimates = Estimates(clips)

    def draw(self, rng: np.random.Generator, size: int, corruption: Corruption) -> Windows:
        """Return `size` windows."""
        joints, spoilt, interval = self.motion(rng, size, corruption)
        future = joints[self.history_slots :]
        normal = normalise(spoilt, interval, self.history_slots)
        return Windows(normal, to_person(normal, future), usual_error(spoilt, future))

    def motion(
        self,
        rng: np.random.Generator,
        size: int,
        corruption: Corruption,
        rates: tuple[float, float] | None = None,
    ) -> tuple[Floats, Floats, Floats]:
        """Return `size` pieces of motion, their spoilt histories, and seconds per slot.

        All have slots per second within `rates`, where these are given and clips are long enough.

        Shapes are `(history_slots + num_leads, size, NUM_COMMON, 3)`, `(history_slots, size,
        NUM_COMMON, 3)` and `(size,)`; metres, the histories with NaN where joints are missing.
        """
        usual = rng.random(size) < USUAL_SHARE
        fps = np.where(
            usual, rng.uniform(*self.usual_fps, size), np.exp(rng.uniform(*LOG_ANY_FPS, size))
        )
        if rates is not None:
            fps = rng.uniform(*rates, size)
        clip = rng.choice(len(self.lengths), size, p=self.weights / self.weights.sum())
        span = self.history_slots + self.num_leads
        step = self.fps[clip] / fps * np.exp(rng.uniform(-LOG_PACE, LOG_PACE, size))
        longest = (self.lengths[clip] - 1.0) / (span - 1)
        fps = np.where(step > longest, fps * step / longest, fps)  # short clips: a higher rate
        step = np.minimum(step, longest)
        start = rng.random(size) * (self.lengths[clip] - 1 - step * (span - 1))
        order = uneven_time(span, size, UNEVEN, rng)
        backwards = rng.random(size) < BACKWARDS
        order[backwards] = order[backwards, ::-1]
        at = start[:, None] + step[:, None] * order
        kept = self.replayed[clip] | (self.variety == "none")
        fps[kept] = self.fps[clip[kept]]
        begun = np.minimum(start[kept], self.lengths[clip[kept]] - span)
        at[kept] = np.floor(begun)[:, None] + np.arange(span)
        joints = self._sample(clip, at)
        if self.variety == "none":
            return self._as_recorded(rng, clip, at, joints)
        if self.variety == "bodies":
            joints[:, ~kept] = swapped_arms(joints[:, ~kept], OTHER_ARMS, rng)
        errors = self.estimates.draw(rng, clip, at[:, : self.history_slots])
        mirror = rng.random(size) < 0.5
        mirrored(joints, mirror)
        mirrored(errors, mirror)
        if self.variety == "bodies":
            joints = other_bodies(joints, rng)
        history = joints[: self.history_slots]
        spoilt = spoil(history, 1 / fps, rng, corruption)
        estimated = self.estimates.rows[clip] >= 0
        given = history[:, estimated] + errors[:, estimated]
        given[np.isnan(spoilt[:, estimated])] = np.nan  # people enter and get lost here too
        spoilt[:, estimated] = given
        return joints, spoilt, 1 / fps

    def _as_recorded(
        self, rng: np.random.Generator, clip: NDArray[np.int64], at: Floats, joints: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return the results of `motion` for recorded motion: every slot is an estimate drawn.

        A joint that the drawn estimate lacks is missing in the history, and is where all cameras
        see it in the target.
        """
        errors = self.estimates.draw(rng, clip, at)
        later = slice(self.history_slots, None)
        joints[later] += np.nan_to_num(errors[later])
        history = joints[: self.history_slots] + errors[: self.history_slots]
        return joints, history, 1 / self.fps[clip]

    def _sample(self, clip: NDArray[np.int64], at: Floats) -> Floats:
        """Return `(span, size, NUM_COMMON, 3)` at frames `at` by cubic (Catmull-Rom) splines."""
        low = np.minimum(at.astype(np.int64), self.lengths[clip][:, None] - 2)
        t = (at - low).T[..., None, None].astype(np.float32)
        index = (self.offsets[clip][:, None] + low).T
        return _curve(self.frames, index, t)


class Estimates:
    """Estimates of clips: in every slot of a window one of them is drawn at random."""

    def __init__(self, clips: Sequence[Clip]) -> None:
        self.counts = np.array([0 if c.errors_m is None else c.errors_m.shape[1] for c in clips])
        sizes = [0 if c.errors_m is None else math.prod(c.errors_m.shape[:2]) for c in clips]
        rows = np.cumsum([0, *sizes])[:-1]
        self.rows = np.where(self.counts > 0, rows, -1)  # -1 marks a clip without estimates
        self.errors = np.concatenate(
            [np.zeros((0, NUM_COMMON, 3), np.float16)]
            + [c.errors_m.reshape(-1, NUM_COMMON, 3) for c in clips if c.errors_m is not None]
        )

    def draw(self, rng: np.random.Generator, clip: NDArray[np.int64], at: Floats) -> Floats:
        """Return `(span, size, NUM_COMMON, 3)` errors of the slots nearest to frames `at`.

        Zeros for clips without estimates, NaN where the drawn estimate lacks the joint.
        """
        errors = np.zeros((at.shape[1], len(clip), NUM_COMMON, 3))
        has = np.flatnonzero(self.rows[clip] >= 0)
        if len(has):
            count = self.counts[clip[has]]
            choice = np.floor(rng.random((at.shape[1], len(has))) * count).astype(np.int64)
            slot = np.rint(at[has]).astype(np.int64).T
            errors[:, has] = self.errors[self.rows[clip[has]] + slot * count + choice]
        return errors


def between_frames(joints_m: Floats, at: Floats) -> Floats:
    """Return `(len(at), *batch, 3)`: motion `(num_slots, *batch, 3)` at frames `at`, likewise.

    NaN around frames where a joint is missing.
    """
    padded = _padded(joints_m)
    low = np.minimum(at.astype(np.int64), len(joints_m) - 2)
    t = (at - low).reshape(-1, *(1,) * (joints_m.ndim - 1))
    return _curve(padded, low + 1, t)


def _curve(frames: NDArray[Real], index: NDArray[np.int64], t: NDArray[Real]) -> Floats:
    """Return the Catmull-Rom spline `t` of the way from frames `index` to the next ones."""
    a, b, c, d = (frames[index + k] for k in (-1, 0, 1, 2))
    curve = c - a + t * (2 * a - 5 * b + 4 * c - d + t * (3 * (b - c) + d - a))
    return np.asarray(b + 0.5 * t * curve, dtype=np.float64)


def _padded(joints_m: NDArray[Real]) -> NDArray[Real]:
    """Return the clip with one more frame at either end, as if it went on evenly."""
    before, after = 2 * joints_m[:1] - joints_m[1:2], 2 * joints_m[-1:] - joints_m[-2:-1]
    return np.concatenate([before, joints_m, after])


def usual_error(history_m: Floats, future_m: Floats) -> Floats:
    """Return `(num_leads, size)`: mean error in metres of the best of three simple predictors."""
    filled, measured = fill_gaps(history_m)
    seen: NDArray[np.bool_] = np.asarray(measured.any(axis=0))
    ahead = np.arange(1, len(future_m) + 1)
    damped = np.cumsum(DAMPING ** np.arange(1, len(future_m) + 1))
    newest, last, mean = filled[-1], filled[-1] - filled[-2], (filled[-1] - filled[-3]) / 2
    errors = [
        (np.linalg.norm(newest + factor[:, None, None, None] * motion - future_m, axis=-1) * seen)
        .sum(axis=-1) / np.maximum(seen.sum(axis=-1), 1)
        for factor, motion in ((0.0 * ahead, last), (1.0 * ahead, last), (damped, mean))
    ]  # fmt: skip
    return np.asarray(np.min(errors, axis=0))


def spoil(
    history_m: Floats, interval_s: Floats, rng: np.random.Generator, corruption: Corruption
) -> Floats:
    """Return histories `(num_slots, size, NUM_COMMON, 3)` with errors and gaps of an estimator."""
    num_slots, size = history_m.shape[:2]
    level = np.exp(rng.uniform(*corruption.log_noise_m, size)) * (
        rng.random(size) >= corruption.exact
    )
    spoilt = history_m + estimation_noise(num_slots, level, interval_s, rng)
    gone = np.zeros(history_m.shape[:3], dtype=bool)
    gaps = rng.random(size) < corruption.missing
    rate: Floats = np.asarray(rng.uniform(0, 0.4, size) * gaps)
    gone |= rng.random(gone.shape) < rate[:, None]
    gone |= (rng.random((size, NUM_COMMON)) < 0.25 * rate[:, None])[None]  # never seen
    gone |= (rng.random((num_slots, size)) < 0.25 * rate)[..., None]  # nobody in that slot
    short = np.where(rng.random(size) < corruption.short, rng.integers(0, num_slots, size), 0)
    gone |= (np.arange(num_slots)[:, None] < short)[..., None]
    gone[-1, gone.all(axis=(0, 2))] = False
    spoilt[gone] = np.nan
    return spoilt


def estimation_noise(
    num_slots: int, level_m: Floats, interval_s: Floats, rng: np.random.Generator
) -> Floats:
    """Return errors `(num_slots, size, NUM_COMMON, 3)` as triangulation makes them.

    They have the parts of `ErrorMemory`; how much of each is drawn per window.

    Args:
        num_slots: length.
        level_m: `(size,)` root mean square error of a joint.
        interval_s: `(size,)` seconds per slot.
        rng: random numbers.
    """
    size = len(level_m)
    shares = rng.dirichlet([0.5, 1.8, 1.8], size)
    joint = np.exp(rng.normal(0, 0.3, (size, NUM_COMMON, 1)))
    scale = level_m[:, None, None] / np.sqrt(3) * joint
    shape = (num_slots, size, NUM_COMMON, 3)
    noise = np.sqrt(shares[:, 0])[:, None, None] * rng.standard_normal(shape, dtype=np.float32)
    for share, memory_s in zip(shares.T[1:], (MEMORY.quick_s, MEMORY.lasting_s), strict=True):
        keep = np.exp(-interval_s / memory_s)[:, None, None]
        fresh = rng.standard_normal(shape, dtype=np.float32)
        state = fresh[0]
        for slot in range(num_slots):
            state = keep * state + np.sqrt(1 - keep**2) * fresh[slot] if slot else state
            noise[slot] += np.sqrt(share)[:, None, None] * state
    return np.asarray(noise * scale, dtype=np.float64)
