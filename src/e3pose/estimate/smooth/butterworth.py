"""Butterworth low-pass of fourth order, zero phase, as usual in biomechanics."""

from __future__ import annotations

from e3pose.base.errors import InputError
from e3pose.estimate.smooth.gaps import stretches
from e3pose.model.take import Motion

ORDER = 2  # definition: of one pass; two passes make the fourth order
# Two passes halve the power at a cut-off twice: each is given one that is higher (Winter 2009).
ONE_PASS = (2 ** (1 / 2) - 1) ** (-1 / (2 * ORDER))  # definition: of two passes
LEAST_SLOTS = 4  # numerics: of a stretch; a shorter one stays as it is
MARGIN = 9  # numerics: slots that are mirrored at the ends of a stretch


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
