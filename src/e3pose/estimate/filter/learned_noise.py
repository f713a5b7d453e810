"""Learned noise: a factor on each camera's keypoint sigma.

After the update of a slot each keypoint is compared with where all other evidence puts the joint:
the residual of the update, divided by what the keypoint itself left of it (its leverage). Its
variance is that of the keypoint plus that of the joint without it, so a keypoint teaches by the
square of the share that is its own: where the joint is the vaguer of the two, the process noise
would be learned. The median is what is compared, so that wild joints count as one each.

A camera's factor is drawn to the mean of all cameras, and that to the noise file: most sites run
one detector, and a camera that seldom looks knows little by itself. What a score is worth is of
the detector: one tilt for all cameras makes certain keypoints better and uncertain ones worse than
the file states, or the other way round.
"""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.blindness import PROOF_CAMERAS, PROOF_S
from e3pose.estimate.filter.outliers import LEAST_KNOWN, MEMORY, ROBUST
from e3pose.estimate.filter.projected import Beside
from e3pose.estimate.filter.scratch import Constants, Detectors, Matches, Tracks, Views

LOG, COUNT, SHARPNESS = 0, 1, 2  # layout: of the last axis of `Belief.noise`
# tuned: keypoints | first guess | noise by camera
ALIKE = 60.0  # keypoints that the other cameras' mean counts for
# tuned: factor | not recorded | learned noise
MOST = 5.0  # the factor and its inverse
MOST_LEVERAGE = 0.9  # numerics
# The filter takes joints for independent, which they are not: it is best where it takes keypoints
# for this much noisier than they are. Shipped files hold it already where people are large.
# tuned: factor | simulated, seeds 701 to 703: 1.15, 1.33, 1.5 give 75.8, 74.9, 74.1 mm with one
#   camera, 20.1, 20.1, 20.3 with all | caution
CAUTION = 4 / 3
NORMAL = 2 * np.log(2)  # definition: median squared length of two standard normal coordinates
# tuned: variances | simulated with known noise, five scenes, seed 701, 10 to 25 slots per second:
#   found within a fifth | learned noise
MEDIAN = 0.8 * NORMAL / CAUTION**2  # of squared residuals where the factor is right
SLOPE = np.log(2)  # definition: of the share beyond their median, by the logarithm of sigma
# tuned: score, score | first guess | noise by score (tilt)
MIDDLE_SCORE, SCORE_REACH = 0.7, 0.25  # where the tilt does nothing, and how far it reaches
# tuned: factor | not recorded | noise by score (tilt)
STEEPEST = 3.0  # the tilt at its ends, and its inverse
FURTHEST = math.log(MOST)


def found(noise: Floats, weight: float) -> Floats:
    """Return `(num_cameras,)` sigma of the keypoints over the file's; NaN where too little is seen.

    Arguments are those of `factors`.
    """
    factor = np.empty(len(noise) - 1)
    stated_factors(noise, weight, factor)
    return factor


@kernel
def recall_noise(noise: Floats, constants: Constants, detectors: Detectors) -> None:
    """Start a slot: compute the factors and scales of all cameras."""
    num_cameras = len(noise) - 1
    find_logs(noise, constants.noise_weight, detectors.logs)
    for camera in range(num_cameras):
        detectors.scales[camera] = constants.scales[camera] * math.exp(detectors.logs[camera])
    tilt_knots(
        detectors.logs[num_cameras], constants.noise_scores, constants.noise_px, detectors.noise_px
    )
    detectors.fresh[:] = 0.0
    detectors.steps[:] = 0.0
    detectors.sharpness[:] = 0.0


@kernel
def find_logs(noise: Floats, weight: float, logs: Floats) -> None:
    """Fill `logs` `(num_cameras + 1,)`: of the factor of each camera on the file's sigma; the tilt.

    Args:
        noise: `Belief.noise`.
        weight: keypoints that the noise file counts for.
        logs: filled.
    """
    num_cameras = len(noise) - 1
    total, mean = weight, 0.0
    for camera in range(num_cameras):
        count = noise[camera, COUNT]
        own = count * ALIKE / (count + ALIKE)
        mean += own * noise[camera, LOG]
        total += own
    mean /= total
    for camera in range(num_cameras):
        count = noise[camera, COUNT]
        logs[camera] = (count * noise[camera, LOG] + ALIKE * mean) / (count + ALIKE)
    count = noise[num_cameras, COUNT]
    logs[num_cameras] = noise[num_cameras, LOG] * count / (count + weight)


@kernel
def tilt_knots(tilt: float, scores: Floats, stated_px: Floats, noise_px: Floats) -> None:
    """Fill `noise_px` `(num_knots,)`: the file's noise at `scores`, tilted."""
    for knot in range(len(scores)):
        noise_px[knot] = stated_px[knot] * math.exp(tilt * _leaning(scores[knot]))


@kernel
def quietest(
    noise: Floats,
    constants: Constants,
    sigma_px: Floats,
) -> None:
    """Fill `sigma_px` `(num_cameras,)`: of each camera's keypoints of the best score.

    `noise` is as of `find_logs`.
    """
    scales, scores = constants.scales, constants.noise_scores
    logs, noise_px = np.empty(len(noise)), np.empty(len(scores))
    find_logs(noise, constants.noise_weight, logs)
    tilt_knots(logs[len(scales)], scores, constants.noise_px, noise_px)
    for camera in range(len(scales)):
        sigma_px[camera] = scales[camera] * math.exp(logs[camera]) * noise_px.min()


@kernel
def expect_alike(noise: Floats, constants: Constants, sigma_px: Floats, worth: Floats) -> None:
    """Fill the noise that a selection expects of cameras, the mean of all that was learned.

    A camera that is selected often agrees with the people it has placed itself, and says by its own
    scores how sure it is: neither may bring it further selections. How much it shows of somebody,
    compared with its other views, stays.

    Args:
        noise: as of `find_logs`.
        constants: of the cameras.
        sigma_px: `(num_cameras,)` filled as by `quietest`, with the mean factor of all cameras.
        worth: `(num_cameras,)` filled with the factor on `Belief.delivered` that gives each camera
            the mean sharpness of all.
    """
    scales, num_cameras = constants.scales, len(sigma_px)
    quietest(noise, constants, sigma_px)
    log, known, sharpness = 0.0, 0.0, 0.0
    for camera in range(num_cameras):
        log += math.log(sigma_px[camera] / scales[camera]) / num_cameras
        own = noise[camera, COUNT] * ALIKE / (noise[camera, COUNT] + ALIKE)
        known += own
        sharpness += own * noise[camera, SHARPNESS]
    mean = sharpness / known if known > 0.0 else 1.0
    for camera in range(num_cameras):
        sigma_px[camera] = scales[camera] * math.exp(log)
        count = noise[camera, COUNT]
        own = count * noise[camera, SHARPNESS] + ALIKE * mean
        worth[camera] = mean * (count + ALIKE) / own


@kernel
def stated_factors(noise: Floats, weight: float, found: Floats) -> None:
    """Fill `found` `(num_cameras,)` as `learned_noise.found` has it; arguments of `find_logs`."""
    logs = np.empty(len(noise))
    find_logs(noise, weight, logs)
    for camera in range(len(found)):
        enough = noise[camera, COUNT] >= LEAST_KNOWN
        found[camera] = math.exp(logs[camera]) / CAUTION if enough else np.nan


@kernel
def _leaning(score: float) -> float:
    lean = (score - MIDDLE_SCORE) / SCORE_REACH
    return -1.0 if lean < -1.0 else 1.0 if lean > 1.0 else lean


@kernel
def proved(track: int, dt: float, views: Views, matches: Matches, tracks: Tracks) -> bool:
    """Return whether several cameras recently detected a track, so that it is no ghost."""
    recent = 0
    for camera in range(len(views.counts)):
        shown = views.arrived[camera] and matches.assigned[camera, track] >= 0
        recent += shown or tracks.last_seen_s[track, camera] + dt < PROOF_S
    return bool(tracks.confirmed[track] and recent >= PROOF_CAMERAS)


@kernel
def add_evidence(
    camera: int,
    found: Beside,
    score: float,
    variance: float,
    own_share: float,
    factor: float,
    detectors: Detectors,
) -> None:
    """Add the evidence of one keypoint, and its share beyond the median.

    Of its `variance`, `own_share` is left beside the learned bias; the update had `factor` of it.
    """
    tilt, lean = len(detectors.logs) - 1, _leaning(score)
    squares, counted = found.du * found.du + found.dv * found.dv, variance * factor
    leverage = found.variance_px2 / (counted * (1.0 + squares / counted * ROBUST))
    left = 1.0 - min(leverage, MOST_LEVERAGE)
    own = variance * own_share
    total = own + found.variance_px2 / left
    share = own / total
    beyond = squares / (left * left) > MEDIAN * total
    surprise = share * (0.5 if beyond else -0.5) / SLOPE
    best_px = detectors.noise_px.min() * detectors.scales[camera]
    detectors.sharpness[camera, 0] += best_px**2 / variance
    detectors.sharpness[camera, 1] += 1.0
    detectors.fresh[camera] += share * share
    detectors.steps[camera] += surprise
    detectors.fresh[tilt] += (share * lean) ** 2
    detectors.steps[tilt] += surprise * lean


@kernel
def learn_noise(noise: Floats, detectors: Detectors) -> None:
    """Add the evidence of a slot to `noise`, which is `Belief.noise`."""
    for camera in range(len(noise)):  # and the tilt, which comes last
        fresh = detectors.fresh[camera]
        if not fresh > 0.0:
            continue
        count = noise[camera, COUNT]
        log = noise[camera, LOG] * count + detectors.logs[camera] * fresh + detectors.steps[camera]
        log /= count + fresh
        most = math.log(STEEPEST)
        if camera < len(noise) - 1:
            most = FURTHEST
            newest = detectors.sharpness[camera, 0] / detectors.sharpness[camera, 1]
            before = noise[camera, SHARPNESS]
            noise[camera, SHARPNESS] = before + (newest - before) * fresh / (count + fresh)
        log = -most if log < -most else most if log > most else log
        noise[camera, LOG] = log
        noise[camera, COUNT] = count + fresh if count + fresh < MEMORY else MEMORY
