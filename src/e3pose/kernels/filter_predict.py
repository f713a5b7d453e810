"""Predict: the loops of `filter.update.predict`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from e3pose.filter.bias import LASTS_S
from e3pose.filter.update import ACCELERATION_LASTS_S, VELOCITY_LASTS_S
from e3pose.kernels.compile import kernel
from e3pose.kernels.filter_memory import Tracks

Floats = NDArray[np.float64]


@kernel
def predict(
    num_tracks: int, dt: float, drift_m2ps4: Floats, shared_m2ps4: Floats, tracks: Tracks
) -> None:
    """Move the first `num_tracks` tracks on by `dt` seconds, in place."""
    fade = math.exp(-dt / VELOCITY_LASTS_S)
    bias_fade = math.exp(-dt / LASTS_S)
    for track in range(num_tracks):
        state = tracks.state[track]
        for joint in range(len(state)):
            tracks.unmeasured_s[track, joint] += dt
            for a in range(3):
                state[joint, a] += VELOCITY_LASTS_S * (1.0 - fade) * state[joint, a + 3]
                state[joint, a + 3] *= fade
            for camera in range(tracks.bias_px.shape[1]):
                tracks.bias_px[track, camera, joint, 0] *= bias_fade
                tracks.bias_px[track, camera, joint, 1] *= bias_fade
        _move_on(tracks.covariance[track], drift_m2ps4, dt, fade)
        _move_on(tracks.shared[track], shared_m2ps4, dt, fade)


@kernel
def _move_on(covariance: Floats, drift_m2ps4: Floats, dt: float, fade: float) -> None:
    """Replace each 6 x 6 C by F C F' and what chance accelerations add."""
    reach = VELOCITY_LASTS_S * (1.0 - fade)
    for joint in range(len(covariance)):
        density = ACCELERATION_LASTS_S * drift_m2ps4[joint]
        for a in range(3):
            for b in range(3):
                pp, pv = covariance[joint, a, b], covariance[joint, a, b + 3]
                vp, vv = covariance[joint, a + 3, b], covariance[joint, a + 3, b + 3]
                own = density if a == b else 0.0
                covariance[joint, a, b] = (
                    pp + reach * (pv + vp) + reach * reach * vv + own * (dt**3 / 3)
                )
                covariance[joint, a, b + 3] = fade * (pv + reach * vv) + own * (dt**2 / 2)
                covariance[joint, a + 3, b] = fade * (vp + reach * vv) + own * (dt**2 / 2)
                covariance[joint, a + 3, b + 3] = fade * fade * vv + own * dt
