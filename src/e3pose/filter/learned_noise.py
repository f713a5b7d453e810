"""How noisy each camera's keypoints are, as a factor on what the noise file states: learned.

After the update of a slot each keypoint is compared with where all other evidence puts the joint:
the residual of the update, divided by what the keypoint itself left of it (its leverage). Its
variance is that of the keypoint plus that of the joint without it, so a keypoint teaches by the
share that is its own, and not at all where the joint is the vaguer of the two: there the process
noise would be learned. The median is what is compared, so that wild joints count as one each.

A camera's factor is drawn to the mean of all cameras, and that to the noise file: most sites run
one detector, and a camera that seldom looks knows little by itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.filter import bias
from e3pose.filter.blindness import PROOF_CAMERAS, PROOF_S
from e3pose.filter.state import Belief, Flags, Floats, Ints, Model
from e3pose.filter.update import (
    MIN_DEPTH_M,
    MIN_SCORE,
    OUTLIER_SIGMAS,
    Sightings,
    pixel_variance,
    project,
)

LOG, COUNT = 0, 1  # of the last axis of `Belief.noise`
ALIKE = 60.0  # keypoints that the other cameras' mean counts for
MEMORY = 10_000.0  # keypoints of a camera: a minute of five people who are seen all the time
MOST = 5.0  # the factor and its inverse
LEAST_SHARE = 0.2  # of a residual's variance that must be the keypoint's own
MOST_LEVERAGE = 0.9
KNOWN = 0.4  # share of a keypoint's variance that the learned bias of its view takes off
# The filter takes joints for independent, which they are not: it is best where it takes keypoints
# for this much noisier than they are. Shipped files hold it already where people are large.
CAUTION = 4 / 3
NORMAL = 2 * np.log(2)  # median squared length of two standard normal coordinates
MEDIAN = 0.8 * NORMAL / CAUTION**2  # of squared residuals where the factor is right
SLOPE = np.log(2)  # of the share of residuals beyond their median, by the logarithm of sigma
LEAST_KNOWN = 50.0  # keypoints from which on a camera's factor is worth telling


def nothing_known(num_cameras: int) -> Floats:
    """Return `(num_cameras, 2)` before the first slot: logarithm of the factor, keypoints."""
    return np.zeros((num_cameras, 2))


def factors(noise: Floats, weight: float) -> Floats:
    """Return `(num_cameras,)` what to multiply the sigma of the noise file by.

    Args:
        noise: `Belief.noise`.
        weight: keypoints that the file counts for.
    """
    logs, counts = noise[:, LOG], noise[:, COUNT]
    own = counts * ALIKE / (counts + ALIKE)
    mean = (own * logs).sum() / (own.sum() + weight)
    return np.asarray(np.exp((counts * logs + ALIKE * mean) / (counts + ALIKE)))


def found(noise: Floats, weight: float) -> Floats:
    """Return `(num_cameras,)` sigma of the keypoints over the file's; NaN where too little is seen.

    Arguments are those of `factors`.
    """
    return np.where(noise[:, COUNT] >= LEAST_KNOWN, factors(noise, weight) / CAUTION, np.nan)


def own_share(since_s: Floats) -> Floats:
    """Return what is left of a keypoint's variance once its learned bias is taken off.

    Args:
        since_s: seconds since the view saw the person before; inf if never.
    """
    return np.asarray(1 - KNOWN * np.exp(-2 * since_s / bias.LASTS_S))


def learn(belief: Belief, seen: Sightings, cameras: Ints, dt: float, model: Model) -> Belief:
    """Return the belief after the views of a slot were compared with the updated people.

    Args:
        belief: after the update, before biases are learned and views are counted.
        seen: the views, with sigmas that the factors of `belief` are part of.
        cameras: `(num_views,)` of the views.
        dt: seconds since the slot before.
        model: the noise.
    """
    if len(belief) == 0 or len(cameras) == 0:
        return belief
    since_s = belief.last_seen_s + dt
    taught = _proved(belief, seen, cameras, since_s)
    pixels, depth, jacobian = project(belief.state[..., :3], seen.projections)
    usable = (seen.scores > MIN_SCORE) & (depth > MIN_DEPTH_M) & taught[:, None]
    error = np.where(usable[..., None], seen.keypoints_px - pixels, 0.0)
    squares = (error**2).sum(axis=-1)
    doubt = pixel_variance(jacobian, belief.covariance[..., :3, :3])
    variance = (seen.sigma_px * seen.look) ** 2
    weight = 1 / (variance * (1 + squares / variance / OUTLIER_SIGMAS**2))
    left = 1 - np.minimum(weight * doubt, MOST_LEVERAGE)
    own = seen.sigma_px**2 * own_share(since_s[:, cameras].T)[..., None]
    total = own + doubt / left
    share = own / total
    share = np.where(usable & (share > LEAST_SHARE), share, 0.0)
    beyond = squares / left**2 > MEDIAN * total
    fresh = (share**2).sum(axis=(1, 2))
    steps = (share * (beyond - 0.5)).sum(axis=(1, 2)) / SLOPE
    now = np.log(factors(belief.noise, model.noise.weight))[cameras]
    noise = belief.noise.copy()
    logs, counts = noise[cameras].T
    total_count = counts + fresh
    mean = (logs * counts + now * fresh + steps) / np.maximum(total_count, 1e-9)
    noise[cameras, LOG] = np.where(fresh > 0, np.clip(mean, -np.log(MOST), np.log(MOST)), logs)
    noise[cameras, COUNT] = np.minimum(total_count, MEMORY)
    return replace(belief, noise=noise)


def _proved(belief: Belief, seen: Sightings, cameras: Ints, since_s: Floats) -> Flags:
    """Return `(num_tracks,)` people whom several cameras showed of late: nobody's ghost."""
    recent: Flags = np.asarray(since_s < PROOF_S)
    recent[:, cameras] |= (seen.scores > 0).any(axis=-1).T
    return np.asarray(belief.confirmed & (recent.sum(axis=1) >= PROOF_CAMERAS))
