"""Where a view is off, it stays so for a while: what that means for the next look.

Residuals of a detector have a memory. Of their variance about 45 % lasts seconds (2.5 s), 45 % a
tenth of a second; only 10 % is new in every frame. What lasts is learned here, as a slow bias per
view, person and joint, and taken off. What comes and goes counts for less the sooner a view looks
again: n looks of a noise with memory tell as much as one look of n times its variance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LASTS_S = 2.5  # until a bias is down to 1/e
LEARNED_S = 1.2  # how long it takes to learn one
MOST = 0.45  # of the first residual: the share of the variance that lasts
FRESH, QUICK = 0.45, 0.18  # shares of the variance: of every look; of a tenth of a second
QUICK_S = 0.1
SHORTEST_S = 1e-3  # for looks of one time
CLIP_SIGMAS = 3.0  # a wild keypoint teaches no more than one this far off


def fade(bias_px: Floats, dt: float) -> Floats:
    """Return the biases `dt` seconds later."""
    return np.asarray(bias_px * np.exp(-dt / LASTS_S))


def inflation(since_s: Floats) -> Floats:
    """Return the factor on a keypoint's variance, `(*batch)`, so long after the look before.

    A noise of memory T, looked at every t, is worth a white one of coth(t / 2T) times its variance.
    """
    times = np.clip(since_s, SHORTEST_S, LASTS_S)
    return np.asarray(FRESH + QUICK / np.tanh(times / (2 * QUICK_S)))


def learn(
    bias_px: Floats, error_px: Floats, sigma_px: Floats, doubt_px2: Floats, since_s: Floats
) -> Floats:
    """Return the biases of one view after it was seen.

    Args:
        bias_px: `(num_tracks, num_joints, 2)` taken off the keypoints of this slot.
        error_px: `(num_tracks, num_joints, 2)` what they were still off after the update; 0 where
            there was no keypoint.
        sigma_px: `(num_tracks, num_joints)` expected error of the keypoints.
        doubt_px2: `(num_tracks, num_joints)` variance of the projected joints after the update; the
            less sure a joint, the less is the view to blame.
        since_s: `(num_tracks,)` seconds since the view saw the person before; inf if never.
    """
    off = np.linalg.norm(error_px, axis=-1) / sigma_px
    blame = sigma_px**2 / (sigma_px**2 + doubt_px2) / np.maximum(off / CLIP_SIGMAS, 1.0)
    rate = np.minimum(MOST, 1 - np.exp(-since_s / LEARNED_S))
    return np.asarray(bias_px + (rate[:, None] * blame)[..., None] * error_px)
