"""Predict: the loops of `filter.update.predict`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.filter.update import ACCELERATION_LASTS_S, ACCELERATION_MPS2, VELOCITY_LASTS_S
from e3pose.kernels.compile import kernel

Floats = NDArray[np.float64]

DENSITY = ACCELERATION_MPS2**2 * ACCELERATION_LASTS_S


@kernel
def predict(
    num_tracks: int, dt: float, state: Floats, covariance: Floats, unmeasured_s: Floats
) -> None:
    """Move the first `num_tracks` tracks on by `dt` seconds, in place.

    `state` is `(num_tracks, num_joints, 6)`, `covariance` has one 6 x 6 matrix for each.
    """
    fade = math.exp(-dt / VELOCITY_LASTS_S)
    reach = VELOCITY_LASTS_S * (1.0 - fade)
    place, both, speed = DENSITY * dt**3 / 3, DENSITY * dt**2 / 2, DENSITY * dt
    for track in range(num_tracks):
        for joint in range(state.shape[1]):
            unmeasured_s[track, joint] += dt
            for a in range(3):
                state[track, joint, a] += reach * state[track, joint, a + 3]
                state[track, joint, a + 3] *= fade
                for b in range(3):
                    pp = covariance[track, joint, a, b]
                    pv = covariance[track, joint, a, b + 3]
                    vp = covariance[track, joint, a + 3, b]
                    vv = covariance[track, joint, a + 3, b + 3]
                    same = 1.0 if a == b else 0.0
                    covariance[track, joint, a, b] = (
                        pp + reach * (pv + vp) + reach * reach * vv + same * place
                    )
                    covariance[track, joint, a, b + 3] = fade * (pv + reach * vv) + same * both
                    covariance[track, joint, a + 3, b] = fade * (vp + reach * vv) + same * both
                    covariance[track, joint, a + 3, b + 3] = fade * fade * vv + same * speed
