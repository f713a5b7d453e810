"""Smoothing with later slots.

`butterworth` is a low-pass of fourth order, zero phase, as usual in biomechanics. `one-euro`
(Casiez, Roussel, Vogel, CHI 2012) is a low-pass that speeds up with motion:

    cut-off = least + beta |speed|,    x <- x + a (new - x),    a = 1 / (1 + rate / (2 pi cut-off))

It looks at no later slot, so it lags; what runs live can be had here, too. After each of them limbs
get the person's lengths in every slot.

`rts` is Rauch-Tung-Striebel smoothing of stored poses, joint by joint. A store keeps where joints
were thought to be and how sure that was, not velocities and not how joints hang together. Joint by
joint, both follow from the answers: with the position's mean m- and variance p- expected from the
slot before, and m, s2 as kept,

    k = 1 - s2 / p-,    (position, velocity) <- expected + (1, c- / p-) (m - m-)

with c- the covariance of position and velocity: a measurement of a position moves the velocity by
regression, whatever it was. So the kept answers are never taken for new measurements, which they
are not. Each joint moves by itself, as `filter.motion.alone` has it; axes share one variance.
Answers without a variance, which know nothing of the slots before, are measurements of
`UNKNOWN_SIGMA_M`.

Where a store keeps the joints' dynamics, too (`model.dynamics`), velocity and covariance are those
of the whole body's filter: they know how a joint moved that no view showed, because others did.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.base.errors import InputError
from e3pose.estimate.filter.bones import proportions_of
from e3pose.estimate.filter.motion import alone, fading
from e3pose.estimate.filter.proportions import kept, median_lengths_m
from e3pose.estimate.filter.tree import grow
from e3pose.estimate.per_slot.estimator import JOINT_SIGMA_M
from e3pose.estimate.smooth.gaps import fill_gaps, stretches
from e3pose.estimate.smooth.rauch import Expected, expect, step_back
from e3pose.model.dynamics import covariance_of
from e3pose.model.proportions import LEAST_M, MOST_M
from e3pose.model.skeleton import Skeleton
from e3pose.model.take import FILLED, Motion, Take

Smoother = Callable[[Motion, Skeleton, float, float], Motion]
Progress = Callable[[Iterable[Motion], int, str], Iterable[Motion]]


ORDER = 2  # definition: of one pass; two passes make the fourth order
# Two passes halve the power at a cut-off twice: each is given one that is higher (Winter 2009).
ONE_PASS = (2 ** (1 / 2) - 1) ** (-1 / (2 * ORDER))  # definition: of two passes
LEAST_SLOTS = 4  # numerics: of a stretch; a shorter one stays as it is
MARGIN = 9  # numerics: slots that are mirrored at the ends of a stretch
# tuned: Hz per m/s | a first guess | by the truth of three scenes half: 14 to 24 % more error, 9 to
#   11 % less jitter; twice: 7 to 12 % less error, 8 to 12 % more jitter
BETA_PER_M = 10.0  # Hz by which each metre per second raises the cut-off
SPEED_CUTOFF_HZ = 1.0  # definition: of the speed itself, as published
UNKNOWN_SIGMA_M = JOINT_SIGMA_M  # of an estimator that states none
# A joint that is known better than this tells the lengths of its limbs.
TELLING_M = 2 * JOINT_SIGMA_M  # definition: twice the usual error
FIRST_SPEED_MPS = 1.0  # physical: people walk: of a velocity of which nothing is known
LEAST_NEWS = 1e-3  # numerics: of a slot, as a share of the variance expected


@dataclass(frozen=True, slots=True)
class SmoothSettings:
    """Settings for smoothing a take.

    Attributes:
        method: a name of `SMOOTHERS`; None only fills gaps.
        cutoff_hz: of `butterworth`, and the least one of `one-euro`; None for their own.
        fill_s: the longest gap that is filled; 0 fills none.
    """

    method: str | None = None
    cutoff_hz: float | None = None
    fill_s: float = 0.0


# Motion, skeleton, seconds per slot, cut-off in Hz -> motion. The cut-off says nothing to `rts`.
SMOOTHERS: dict[str, Smoother] = {
    "rts": lambda motion, skeleton, interval_s, _: smooth_points(motion, skeleton, interval_s),
    "butterworth": lambda motion, _, interval_s, hz: butterworth(motion, interval_s, hz),
    "one-euro": lambda motion, _, interval_s, hz: one_euro(motion, interval_s, hz),
}
CUTOFFS_HZ = {"butterworth": 6.0, "one-euro": 1.0}
HIGHEST_SHARE = 0.25  # numerics: of the slots per second, half of what they can show


def check_smoothing(settings: SmoothSettings) -> None:
    """Raise `InputError` for a method that is unknown or a cut-off that it does not have."""
    method = settings.method
    if method is not None and method not in SMOOTHERS:
        raise InputError(f"--smooth: found {method[:40]!r}, expected {', '.join(SMOOTHERS)}")
    if settings.cutoff_hz is not None and method not in CUTOFFS_HZ:
        which = " or ".join(CUTOFFS_HZ)
        raise InputError(f"--cutoff: found without --smooth {which}, which have one")


def smoothed(
    take: Take,
    settings: SmoothSettings,
    progress: Progress = lambda items, total, label: items,
) -> Take:
    """Return the take with short gaps filled, then smoothed person by person.

    Args:
        take: to smooth.
        settings: how.
        progress: given the people, their number and a label, yields them while it shows how far
            the work is.

    Raises:
        InputError: for settings that cannot be had.
    """
    check_smoothing(settings)
    longest = int(settings.fill_s / take.interval_s + 1e-6)
    smoother = SMOOTHERS.get(settings.method or "")
    usual_hz = min(CUTOFFS_HZ.get(settings.method or "", 0.0), HIGHEST_SHARE * take.fps)
    cutoff_hz = settings.cutoff_hz or usual_hz
    motions = []
    for motion in progress(take.motions, len(take.motions), "smooth"):
        whole = fill_gaps(motion, longest)
        if smoother is not None:
            smooth = smoother(whole, take.skeleton, take.interval_s, cutoff_hz)
            whole = keep_limbs(smooth, take.skeleton)
        motions.append(whole)
    return replace(take, motions=tuple(motions))


def butterworth(motion: Motion, interval_s: float, cutoff_hz: float) -> Motion:
    """Return the motion without frequencies above `cutoff_hz`; gaps split it.

    Args:
        motion: of one person.
        interval_s: seconds per slot.
        cutoff_hz: where power is halved, Hz.

    Raises:
        InputError: when the slots are too slow for the cut-off.
    """
    from scipy.signal import butter, filtfilt

    highest = 0.5 / interval_s
    if not 0 < cutoff_hz * ONE_PASS < highest:
        raise InputError(
            f"--cutoff: found {cutoff_hz:g} Hz, expected more than 0 and less than "
            f"{highest / ONE_PASS:.3g} Hz at {1 / interval_s:g} slots per second"
        )
    b, a = butter(ORDER, cutoff_hz * ONE_PASS / highest)
    joints_m = motion.joints_m.copy()
    for joint in range(joints_m.shape[1]):
        for start, stop in stretches(motion.known[:, joint], 0):
            if stop - start >= LEAST_SLOTS:
                margin = min(MARGIN, stop - start - 1)
                path = motion.joints_m[start:stop, joint]
                joints_m[start:stop, joint] = filtfilt(b, a, path, axis=0, padlen=margin)
    return Motion(
        motion.track_id, motion.first, joints_m, motion.sigma_m, motion.scores, motion.origin
    )


def one_euro(motion: Motion, interval_s: float, cutoff_hz: float) -> Motion:
    """Return the motion filtered; a joint that was missing starts again.

    Args:
        motion: of one person.
        interval_s: seconds per slot.
        cutoff_hz: the least cut-off, of a joint at rest, Hz.
    """
    joints_m = motion.joints_m.copy()
    place: Floats = np.full(joints_m.shape[1:], np.nan)
    velocity: Floats = np.zeros_like(place)
    slow = _share(np.float64(SPEED_CUTOFF_HZ), interval_s)
    for row, new in enumerate(motion.joints_m):
        goes_on = np.isfinite(place) & np.isfinite(new)
        speed = np.where(goes_on, (new - place) / interval_s, 0.0)
        velocity = np.where(goes_on, velocity + slow * (speed - velocity), 0.0)
        cutoff = cutoff_hz + BETA_PER_M * np.linalg.norm(velocity, axis=-1, keepdims=True)
        place = np.where(goes_on, place + _share(cutoff, interval_s) * (new - place), new)
        joints_m[row] = place
    return Motion(
        motion.track_id, motion.first, joints_m, motion.sigma_m, motion.scores, motion.origin
    )


def _share(cutoff_hz: Floats | np.float64, interval_s: float) -> Floats:
    return np.asarray(1 / (1 + 1 / (2 * np.pi * cutoff_hz * interval_s)))


def keep_limbs(motion: Motion, skeleton: Skeleton) -> Motion:
    """Return the motion with limbs of the person's lengths.

    What is missing stays so; scores and origins are as they were; a joint that had to move is as
    much less certain. Bodies that are nobody's, by the median of their limbs, stay as they are.

    Args:
        motion: of one person.
        skeleton: of its joints.
    """
    body = proportions_of(skeleton, grow(skeleton))
    sigma_m = np.where(np.isfinite(motion.sigma_m), motion.sigma_m, UNKNOWN_SIGMA_M)
    telling = motion.known & (sigma_m < TELLING_M)
    lengths_m, counts = median_lengths_m(body, motion.joints_m, telling)
    told = (body.kinds >= 0) & (counts > 0)
    if told.any():
        shares = np.exp(body.shares[body.kinds[told]])
        if not LEAST_M <= np.median(lengths_m[told] / shares) <= MOST_M:
            return motion
    joints_m, covariance_m2, _ = kept(
        body,
        np.tile(lengths_m, (len(motion), 1)),
        np.tile(counts, (len(motion), 1)),
        motion.joints_m,
        sigma_m[..., None, None] ** 2 * np.eye(3),
        motion.known,
    )
    wider_m = np.sqrt(np.trace(covariance_m2, axis1=-2, axis2=-1) / 3)
    return replace(
        motion,
        joints_m=joints_m,
        sigma_m=np.where(np.isfinite(motion.sigma_m), wider_m, motion.sigma_m),
    )


def smooth_points(motion: Motion, skeleton: Skeleton, interval_s: float) -> Motion:
    """Return the motion smoothed by all of its slots.

    Filled joints are no evidence: they are placed by those before and after, and stay marked.

    Args:
        motion: of one person.
        skeleton: of its joints.
        interval_s: seconds per slot.
    """
    drift, lasts_s = alone(grow(skeleton))
    known = motion.known
    begins = np.zeros_like(known)
    for joint in range(known.shape[1]):
        for start, _ in stretches(known[:, joint], 0):
            begins[start, joint] = True
    tells = known & (motion.origin != FILLED)
    means, covariances, expected = _forward(
        np.where(tells[..., None], motion.joints_m, np.nan),
        motion.sigma_m,
        motion.dynamics,
        begins,
        *fading(drift, lasts_s, interval_s),
    )
    joints_m = np.where(known[..., None], motion.joints_m, np.nan)
    sigma_m = motion.sigma_m.copy()
    mean, covariance = means[-1], covariances[-1]
    for slot in range(len(known) - 1, -1, -1):
        if slot < len(known) - 1:
            goes_on = known[slot] & known[slot + 1] & ~begins[slot + 1]
            back, spread = step_back(
                means[slot], covariances[slot], expected[slot + 1], mean, covariance
            )
            mean = np.where(goes_on[:, None, None], back, means[slot])
            covariance = np.where(goes_on[:, None, None], spread, covariances[slot])
        here = known[slot]
        joints_m[slot, here] = mean[here, 0]
        stated = here & np.isfinite(motion.sigma_m[slot])
        sigma_m[slot, stated] = _stated_m(
            motion.sigma_m[slot, stated], covariances[slot][stated, 0, 0], covariance[stated, 0, 0]
        )
    return Motion(motion.track_id, motion.first, joints_m, sigma_m, motion.scores, motion.origin)


def _stated_m(before_m: Floats, filtered_m2: Floats, smoothed_m2: Floats) -> Floats:
    """Return the stated standard deviations after smoothing, `(num,)`.

    What was stated beyond what the filter knew are errors that views repeat, which no number of
    slots averages out (`smooth.bodies`): they stay. What was stated below it is a factor.
    """
    factor = np.minimum(before_m**2 / filtered_m2, 1.0)
    return np.sqrt(before_m**2 - factor * (filtered_m2 - np.maximum(smoothed_m2, 0.0)))


def _forward(
    joints_m: Floats,
    sigma_m: Floats,
    dynamics: Floats | None,
    begins: Flags,
    move: Floats,
    noise: Floats,
) -> tuple[list[Floats], list[Floats], list[Expected]]:
    """Return the filtered state after each slot, `(num_joints, 2, 3)` and `(num_joints, 2, 2)`.

    With it what was expected of each slot, from the one before; the first entry says nothing.
    """
    num_joints = joints_m.shape[1]
    mean, covariance = np.zeros((num_joints, 2, 3)), np.tile(np.eye(2), (num_joints, 1, 1))
    means, covariances, expectations = [], [], []
    for slot, (place_m, sigma, new) in enumerate(zip(joints_m, sigma_m, begins, strict=True)):
        across = covariance @ np.swapaxes(move, -1, -2)
        expected = expect(move @ mean, move @ across + noise, across)
        mean, covariance = _taken_in(expected, place_m, sigma)
        if new.any():
            variance = np.where(np.isfinite(sigma), sigma, UNKNOWN_SIGMA_M) ** 2
            mean[new, 0], mean[new, 1] = place_m[new], 0.0
            covariance[new] = 0.0
            covariance[new, 0, 0], covariance[new, 1, 1] = variance[new], FIRST_SPEED_MPS**2
        if dynamics is not None:
            told = np.isfinite(dynamics[slot]).all(axis=-1) & np.isfinite(place_m).all(axis=-1)
            mean[told, 1] = dynamics[slot, told, :3]
            covariance[told] = covariance_of(dynamics[slot, told])
        means.append(mean)
        covariances.append(covariance)
        expectations.append(expected)
    return means, covariances, expectations


def _taken_in(expected: Expected, place_m: Floats, sigma_m: Floats) -> tuple[Floats, Floats]:
    """Return the filtered state after a slot, from its published state; NaN adds nothing."""
    before = expected.covariance[:, 0, 0]
    measured: Flags = np.asarray(np.isfinite(place_m).all(axis=-1))
    stated = np.isfinite(sigma_m)
    measurement = before * UNKNOWN_SIGMA_M**2 / (before + UNKNOWN_SIGMA_M**2)
    after = np.where(stated, np.where(stated, sigma_m, 1.0) ** 2, measurement)
    share = 1 - np.clip(after / before, 0.0, 1 - LEAST_NEWS)  # information of the slot: k above
    share = np.where(measured, share, 0.0)
    column = expected.covariance[:, :, 0] / before[:, None]  # (1, c- / p-)
    gone = np.where(measured[:, None], place_m - expected.mean[:, 0], 0.0)
    gone *= np.where(measured & ~stated, share, 1.0)[:, None]  # a measurement is not yet the answer
    mean = expected.mean + column[:, :, None] * gone[:, None]
    less = (share * before)[:, None, None] * column[:, :, None] * column[:, None, :]
    return mean, expected.covariance - less
