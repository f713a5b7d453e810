"""How noisy each camera's keypoints are, as a factor on what the noise file states: learned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.reference.filter_update import Sightings, pixel_variance

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.estimate.filter import bias
from e3pose.estimate.filter.blindness import PROOF_CAMERAS, PROOF_S
from e3pose.estimate.filter.learned_noise import (
    ALIKE,
    MEDIAN,
    MIDDLE_SCORE,
    MOST,
    MOST_LEVERAGE,
    SCORE_REACH,
    SLOPE,
    STEEPEST,
)
from e3pose.estimate.filter.outliers import MEMORY, OUTLIER_SIGMAS
from e3pose.estimate.filter.projected import USED_SCORE
from e3pose.estimate.filter.state import Belief, Model
from e3pose.model.projection import MIN_DEPTH_M, project


def factors(noise: Floats, weight: float) -> Floats:
    """Return `(num_cameras,)` factors on the sigma of the noise file, as `find_logs` has them."""
    logs, counts = noise[:-1, :2].T
    own = counts * ALIKE / (counts + ALIKE)
    mean = (own * logs).sum() / (own.sum() + weight)
    return np.asarray(np.exp((counts * logs + ALIKE * mean) / (counts + ALIKE)))


def tilt(noise: Floats, weight: float) -> float:
    """Return the logarithm of the factor on sigma at the highest scores; arguments as above."""
    log, count = noise[-1, :2]
    return float(log * count / (count + weight))


def leaning(scores: Floats) -> Floats:
    """Return how much of the tilt keypoints of these scores have, in [-1, 1]."""
    return np.asarray(np.clip((scores - MIDDLE_SCORE) / SCORE_REACH, -1, 1))


def knots_px(model: Model, noise: Floats) -> Floats:
    """Return `(num_cameras, num_knots)`: sigma of each camera at the scores of the noise file."""
    stated, weight = model.noise, model.noise.weight
    leant = stated.sigma_px * np.exp(tilt(noise, weight) * leaning(stated.scores))
    return np.asarray((model.scales * factors(noise, weight))[:, None] * leant)


def own_share(since_s: Floats, terms: bias.MemoryTerms) -> Floats:
    """Return what is left of a keypoint's variance once its learned bias is taken off."""
    return np.asarray(1 - terms.removed * np.exp(-2 * since_s / terms.lasting_s))


def learn(belief: Belief, seen: Sightings, cameras: Integers, dt: float, model: Model) -> Belief:
    """Return the belief after the views of a slot were compared with the updated people."""
    if len(belief) == 0 or len(cameras) == 0:
        return belief
    since_s = belief.last_seen_s + dt
    taught = proved(belief, seen, cameras, since_s)
    pixels, depth, jacobian = project(belief.state[..., :3], seen.projections)
    usable = (seen.scores > USED_SCORE) & (depth > MIN_DEPTH_M) & taught[:, None]
    error = np.where(usable[..., None], seen.keypoints_px - pixels, 0.0)
    squares = (error**2).sum(axis=-1)
    doubt = pixel_variance(jacobian, belief.covariance[..., :3, :3])
    variance = (seen.sigma_px * seen.look) ** 2
    weight = 1 / (variance * (1 + squares / variance / OUTLIER_SIGMAS**2))
    left = 1 - np.minimum(weight * doubt, MOST_LEVERAGE)
    terms = bias.memory_terms(model.noise.memory)
    own = seen.sigma_px**2 * own_share(since_s[:, cameras].T, terms)[..., None]
    total = own + doubt / left
    share = own / total
    share = np.where(usable, share, 0.0)
    beyond = squares / left**2 > MEDIAN * total
    surprise = share * (beyond - 0.5) / SLOPE
    lean = leaning(seen.scores)
    logs, counts, sharpness = belief.noise.T
    now = np.append(np.log(factors(belief.noise, model.noise.weight)), 0.0)
    now[-1] = tilt(belief.noise, model.noise.weight)
    fresh, steps = np.zeros_like(now), np.zeros_like(now)
    fresh[cameras], steps[cameras] = (share**2).sum(axis=(1, 2)), surprise.sum(axis=(1, 2))
    fresh[-1], steps[-1] = ((share * lean) ** 2).sum(), (surprise * lean).sum()
    total_count = counts + fresh
    mean = (logs * counts + now * fresh + steps) / np.maximum(total_count, 1e-9)
    most = np.log(np.append(np.full(len(now) - 1, MOST), STEEPEST))
    best_px = knots_px(model, belief.noise).min(axis=1)[cameras]
    squares = np.where(usable, (best_px[:, None, None] / seen.sigma_px) ** 2, 0.0)
    newest = np.zeros_like(now)
    newest[cameras] = squares.sum(axis=(1, 2)) / np.maximum(usable.sum(axis=(1, 2)), 1)
    sharpness = (sharpness * counts + newest * fresh) / np.maximum(total_count, 1e-9)
    learned = (np.clip(mean, -most, most), np.minimum(total_count, MEMORY), sharpness)
    noise = np.stack(learned, axis=-1)
    return replace(belief, noise=np.where(fresh[:, None] > 0, noise, belief.noise))


def proved(belief: Belief, seen: Sightings, cameras: Integers, since_s: Floats) -> Flags:
    """Return `(num_tracks,)` people whom several cameras showed of late: nobody's ghost."""
    recent: Flags = np.asarray(since_s < PROOF_S)
    recent[:, cameras] |= (seen.scores > 0).any(axis=-1).T
    return np.asarray(belief.confirmed & (recent.sum(axis=1) >= PROOF_CAMERAS))
