"""How wrong the filter's covariances are, from what the filter knows: a factor on what is stated.

A filter states the uncertainty of its own model of detectors and of people. Where people fill
little of an image that model is too cautious, where they walk or were not seen it claims too much.
The factor is a regression of the 90 % quantile of (error / stated 90 % distance), in its logarithm,
on simulated people: all scenes count alike. Seeds: `docs/explanation/camera-selection.md`; how well
it is calibrated: `docs/research/camera-selection.md`.
"""

from __future__ import annotations

import numpy as np

from e3pose.estimate.filter.state import Belief, Floats, Model

# Logarithm of the factor: constant, and by the features of `_features`.
CONSTANT, BY_SIZE, BY_SPEED, BY_UNMEASURED, BY_VIEWS = 0.03, 0.28, 0.17, 0.86, -0.17
TYPICAL_PX_PER_M = 252.0  # in an image of the size that noises are told for
MAX_SIZE, MAX_SPEED_MPS, MAX_UNMEASURED_S = 1.5, 1.5, 1.0  # nothing was fitted beyond
SIZE_LASTS_S, VIEWS_LAST_S = 1.0, 0.5
FEWEST_VIEWS = 0.05


def spread_factor(belief: Belief, model: Model) -> Floats:
    """Return `(num_tracks, num_joints)`: the factor that makes standard deviations honest."""
    middle = belief.state[..., :3].mean(axis=1)
    apart = np.linalg.norm(middle[:, None] - model.rig.centers_m, axis=-1)
    focal_px = np.array([camera.K[0, 0] for camera in model.rig.cameras])
    size = np.log(focal_px / model.scales / np.maximum(apart, 0.1) / TYPICAL_PX_PER_M)
    recent = np.exp(-belief.last_seen_s / SIZE_LASTS_S)
    size = (size * recent).sum(axis=1) / np.maximum(recent.sum(axis=1), 1e-9)
    speed = np.linalg.norm(belief.state[..., 3:5].mean(axis=1), axis=-1)
    views = np.exp(-belief.last_seen_s / VIEWS_LAST_S).sum(axis=1)
    person = (
        CONSTANT
        + BY_SIZE * np.clip(size, -MAX_SIZE, MAX_SIZE)
        + BY_SPEED * np.minimum(speed, MAX_SPEED_MPS)
        + BY_VIEWS * np.log(np.maximum(views, FEWEST_VIEWS))
    )
    joint = BY_UNMEASURED * np.minimum(belief.unmeasured_s, MAX_UNMEASURED_S)
    return np.asarray(np.exp(person[:, None] + joint))
