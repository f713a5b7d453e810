"""Learn the energy cost of an active slot from a camera's meter. Pure functions.

A stretch of time in which a camera was active for `a` and idle for `i` seconds is taken to cost
`a * watts_active + i * watts_idle` joules. The two powers are estimated by recursive least squares
with the profile as its prior and forgetting, and a limit on how far one stretch can pull (Huber).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.energy.profiles import DeviceProfile, Mode

PRIOR_SHARE = 0.5  # standard deviation of a profile's power, of itself: boards of a kind vary
# Of the mean power of a second, before residuals have said more; it counts as one of these.
NOISE_SHARE = 0.1
NOISE_SPANS = 30.0  # how many stretches the estimate of the noise remembers
FORGET_S = 1800.0  # heat and clocks change over half an hour
# A device that changed surprises with one sign: what was learned is then forgotten faster.
BIASED = 0.25  # of the squared mean surprise, in variances; noise alone exceeds it one time in 10^5
FORGET_FASTER = 120.0  # tuned: times | power halved, doubled, +12 %; meters exact and noisy | 3 %
HUBER = 1.345  # standard deviations; 95 % efficient where the noise is normal (Huber 1964)
CLIPPED = 0.7101  # mean of min(z^2, HUBER^2) of a standard normal z
ENOUGH_SHARE = 0.1  # an estimate is one once its standard deviation is below this share of it
MIN_SPANS = 10
MIN_SPAN_S, MAX_SPAN_S = 0.05, 120.0


@dataclass(frozen=True, slots=True, eq=False)
class LearnedCost:
    """The learned power of a camera.

    Attributes:
        watts: `(2,)` when active and when idle.
        covariance: `(2, 2)` of `watts`.
        prior: `(2, 2)` covariance before anything was measured.
        noise: variance of a stretch's mean power around the two, watts squared seconds.
        spans: stretches that were taken in.
        bias: mean of recent surprises, in standard deviations: a device that changes has a sign.
    """

    watts: Floats
    covariance: Floats
    prior: Floats
    noise: float
    spans: int
    bias: float = 0.0

    def profile_watts(self) -> Floats:
        """Return `(2,)` power when active and when idle before anything was measured."""
        return np.asarray(np.sqrt(np.diag(self.prior)) / PRIOR_SHARE)


@dataclass(frozen=True, slots=True)
class SlotCost:
    """What a slot costs a camera.

    Attributes:
        active_j: an active slot.
        idle_j: an idle slot.
        active_sigma_j: standard deviation of `active_j`.
        idle_sigma_j: standard deviation of `idle_j`.
        measured: whether it was learned from measurements; otherwise the profile says it.
        why: which of the two, for people.
    """

    active_j: float
    idle_j: float
    active_sigma_j: float
    idle_sigma_j: float
    measured: bool
    why: str


def unlearned(profile: DeviceProfile, idle_mode: Mode = "power-saving") -> LearnedCost:
    """Return what a profile says before anything was measured."""
    watts = np.array([profile.watts("active"), profile.watts(idle_mode)])
    prior = np.diag((PRIOR_SHARE * watts) ** 2)
    return LearnedCost(watts, prior, prior, float((NOISE_SHARE * watts[0]) ** 2), 0)


def learn(cost: LearnedCost, energy_j: float, active_s: float, idle_s: float) -> LearnedCost:
    """Return the learned cost after one interval, such as between two heartbeats.

    Args:
        cost: what was known before.
        energy_j: measured in it; modelled energy must not be given.
        active_s: seconds that the camera was active in it.
        idle_s: seconds that it was not.

    Returns:
        What is known now; the same where the stretch says nothing: too short, too long, impossible.
    """
    span_s = active_s + idle_s
    numbers = (energy_j, active_s, idle_s)
    if not np.isfinite(numbers).all() or min(numbers) < 0 or not MIN_SPAN_S <= span_s <= MAX_SPAN_S:
        return cost
    covariance = _forgotten(cost, span_s)
    shares = np.array([active_s, idle_s]) / span_s
    # A longer stretch averages its noise away.
    noise = cost.noise / span_s
    spread = covariance @ shares
    variance = float(shares @ spread) + noise
    surprise = energy_j / span_s - float(shares @ cost.watts)
    limit = HUBER * np.sqrt(variance)
    pull = min(1.0, limit / max(abs(surprise), 1e-12))
    gain = spread / (float(shares @ spread) + noise / pull)
    watts = np.maximum(cost.watts + gain * surprise, 0.0)
    left = np.eye(2) - np.outer(gain, shares)
    covariance = left @ covariance @ left.T + np.outer(gain, gain) * noise / pull  # Joseph's form
    residual = energy_j / span_s - float(shares @ watts)
    rate = 1 / min(cost.spans + 2.0, NOISE_SPANS)
    heard = min(abs(residual), limit) ** 2 / CLIPPED * span_s
    floor = float((1e-3 * cost.watts.max()) ** 2)
    return LearnedCost(
        watts=watts,
        covariance=0.5 * (covariance + covariance.T),
        prior=cost.prior,
        noise=max((1 - rate) * cost.noise + rate * heard, floor),
        spans=cost.spans + 1,
        bias=cost.bias + (pull * surprise / np.sqrt(variance) - cost.bias) / NOISE_SPANS,
    )


def slot_cost(cost: LearnedCost, interval_s: float) -> SlotCost:
    """Return what slots of `interval_s` seconds cost, and whether that was measured.

    It is called measured once both powers are known to a tenth of themselves: a camera that was
    never idle, or never active, or always in the same share, says nothing about the other.
    """
    sigma = np.sqrt(np.diag(cost.covariance))
    vague = sigma > ENOUGH_SHARE * np.maximum(cost.watts, 1e-9)
    if cost.spans < MIN_SPANS:
        why = f"modelled: {cost.spans} of {MIN_SPANS} measurements so far"
    elif vague.any():
        what = " and ".join(n for n, bad in zip(("active", "idle"), vague, strict=True) if bad)
        why = f"modelled: too few measurements of the {what} power alone"
    else:
        why = f"measured: {cost.spans} intervals"
    active, idle = (cost.watts * interval_s).tolist()
    active_sigma, idle_sigma = (sigma * interval_s).tolist()
    return SlotCost(active, idle, active_sigma, idle_sigma, why.startswith("measured"), why)


def _forgotten(cost: LearnedCost, span_s: float) -> Floats:
    """Return the covariance after some time, at most what was known before any measurement."""
    faster = 1 + FORGET_FASTER * max(cost.bias**2 - BIASED, 0.0)
    grown = cost.covariance * np.exp(faster * span_s / FORGET_S)
    # Directions that nothing measures must not grow for ever: none may exceed the prior.
    scale = np.sqrt(np.diag(cost.prior))
    values, vectors = np.linalg.eigh(grown / np.outer(scale, scale))
    limited = (vectors * np.minimum(values, 1.0)) @ vectors.T
    return np.asarray(limited * np.outer(scale, scale))
