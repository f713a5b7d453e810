"""Smoothing with later slots."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from e3pose.base.errors import InputError
from e3pose.estimate.smooth.butterworth import butterworth
from e3pose.estimate.smooth.gaps import fill_gaps
from e3pose.estimate.smooth.limbs import keep_limbs
from e3pose.estimate.smooth.one_euro import one_euro
from e3pose.estimate.smooth.points import smooth_points
from e3pose.model.skeleton import Skeleton
from e3pose.model.take import Motion, Take

Smoother = Callable[[Motion, Skeleton, float, float], Motion]
Progress = Callable[[Iterable[Motion], int, str], Iterable[Motion]]


@dataclass(frozen=True, slots=True)
class SmoothSettings:
    """How a take is smoothed.

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
# tuned: share | not recorded | not measured
HIGHEST_SHARE = 0.25  # of the slots per second, for a cut-off that nobody named


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
