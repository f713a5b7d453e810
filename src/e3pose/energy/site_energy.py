"""Energy of a site: heartbeats in, budgets and costs out. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats
from e3pose.energy.budgets import Budget, Supply, allowance_j, slot_shares
from e3pose.energy.profiles import DeviceProfile, Mode

# Learn the energy cost of an active slot from a camera's meter. Pure functions.
#
# A stretch of time in which a camera was active for `a` and idle for `i` seconds is taken to cost
# `a * watts_active + i * watts_idle` joules. The two powers are estimated by recursive least
# squares with the profile as its prior and forgetting, and a limit on how far one stretch can pull
# (Huber).

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
    """The cost of a slot for a camera.

    Attributes:
        active_j: an active slot.
        idle_j: an idle slot.
        measured: whether it was learned from measurements; otherwise the profile says it.
        why: which of the two, for people.
    """

    active_j: float
    idle_j: float
    measured: bool
    why: str


def unlearned(profile: DeviceProfile, idle_mode: Mode = "power-saving") -> LearnedCost:
    """Return the costs of a profile, before any measurement."""
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
    # What was learned is forgotten, at most to what was known before any measurement.
    faster = 1 + FORGET_FASTER * max(cost.bias**2 - BIASED, 0.0)
    grown = cost.covariance * np.exp(faster * span_s / FORGET_S)
    # Directions that nothing measures must not grow for ever: none may exceed the prior.
    scale = np.sqrt(np.diag(cost.prior))
    values, vectors = np.linalg.eigh(grown / np.outer(scale, scale))
    limited = (vectors * np.minimum(values, 1.0)) @ vectors.T
    covariance = limited * np.outer(scale, scale)
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
    """Return the cost of slots of `interval_s` seconds, and whether that was measured.

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
    return SlotCost(active, idle, why.startswith("measured"), why)


SUN_S = 600.0  # over which charging is averaged: a cloud is no evening
LEAST_COST_J = 1e-6
# Of the time between two heartbeats, in which a camera is still called awake: the one on falling
# asleep has the looks before in it, and is made 0.1 ms after on live sites. Where it taught
# nothing, cameras that sleep after each look were not measured within two minutes.
ASLEEP_SHARE = 0.01
# Measured costs beside a profile's, of most cameras: what differs from it by more is not believed.
STRANGE_TIMES = 2.0
# Queues that are always full leave no choice. Budgets of 0.30 keep 0.294 with it, 0.285 with 0.95.
AFFORD_SHARE = 0.98  # of what budgets pay for


class Beat(Protocol):
    """The fields read of a heartbeat, which is `wire.messages.Heartbeat`."""

    @property
    def session(self) -> int:
        """Drawn when the camera's program started."""
        ...

    @property
    def sent_edge_ns(self) -> int:
        """When it left."""
        ...

    @property
    def energy_j(self) -> float | None:
        """Drawn since the start."""
        ...

    @property
    def measured(self) -> bool:
        """Whether that was measured since the heartbeat before."""
        ...

    @property
    def recording_j(self) -> float:
        """The part of it that recording video took."""
        ...

    @property
    def active_s(self) -> float:
        """Slots with a look since the start, in seconds."""
        ...

    @property
    def idle_s(self) -> float:
        """Other seconds awake since the start."""
        ...

    @property
    def asleep_s(self) -> float:
        """Seconds asleep or suspended since the start, part of neither."""
        ...

    @property
    def battery_j(self) -> float | None:
        """The charge of the battery."""
        ...

    @property
    def charging_w(self) -> float:
        """The power that charges it."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class CameraEnergy:
    """The energy of one camera.

    Attributes:
        cost: what was learned of its power.
        beat: the newest heartbeat.
        capacity_j: of its battery, as configured; infinite where it is not.
        charging_w: what goes into its battery, averaged over ten minutes.
        recording_w: what recording video draws in slots of every kind, averaged likewise.
    """

    cost: LearnedCost
    capacity_j: float = np.inf
    beat: Beat | None = None
    charging_w: float = 0.0
    recording_w: float = 0.0

    def supply(self) -> Supply:
        """Return the supply of the camera; without a battery it is on mains."""
        if self.beat is None or self.beat.battery_j is None:
            return Supply()
        return Supply(min(max(self.beat.battery_j, 0.0), self.capacity_j), self.charging_w)


@dataclass(frozen=True, slots=True, eq=False)
class EnergyEstimate:
    """The energy figures that the loop needs until the next estimate.

    Attributes:
        budget: `(num_cameras,)` the paper's E_n, for the queues.
        cost_j: `(num_cameras,)` of an active slot beyond an idle one, for their price, as far as
            it is credible.
        slots: what slots cost each camera, and whether that was measured.
        num_selected: mean cameras per slot: the number requested, or fewer if the budgets do not
            pay for it.
        starved: `(num_cameras,)` whether the budget does not even pay for idle slots.
    """

    budget: Floats
    cost_j: Floats
    slots: tuple[SlotCost, ...]
    num_selected: float
    starved: NDArray[np.bool_]

    def spent_j(self, selected: NDArray[np.bool_]) -> Floats:
        """Return `(num_cameras,)` joules that a slot with this selection is charged with."""
        active = np.array([slot.active_j for slot in self.slots])
        idle = np.array([slot.idle_j for slot in self.slots])
        return np.where(selected, active, idle)


def new_camera(
    profile: DeviceProfile, idle_mode: Mode = "power-saving", capacity_j: float = np.inf
) -> CameraEnergy:
    """Return the energy of a camera without a heartbeat yet, by its profile.

    Args:
        profile: of its device.
        idle_mode: what it does in slots without an order.
        capacity_j: of its battery; infinite where it is not known.
    """
    return CameraEnergy(unlearned(profile, idle_mode), capacity_j)


def observe(camera: CameraEnergy, beat: Beat) -> CameraEnergy:
    """Return a camera after a heartbeat: energy since the previous one, and the battery.

    A camera that was restarted counts from nothing again; its two first heartbeats say nothing of
    its power. Modelled energy teaches nothing: it is what the profile said in the first place.
    """
    before, cost = camera.beat, camera.cost
    if before is None or before.session != beat.session:
        return CameraEnergy(cost, camera.capacity_j, beat, max(beat.charging_w, 0.0))
    span_s = (beat.sent_edge_ns - before.sent_edge_ns) / 1e9
    if span_s <= 0:
        return camera
    # What is drawn asleep is of another mode.
    awake = beat.asleep_s - before.asleep_s <= ASLEEP_SHARE * span_s
    if awake and beat.measured and beat.energy_j is not None and before.energy_j is not None:
        cost = learn(
            cost,
            beat.energy_j - before.energy_j,
            beat.active_s - before.active_s,
            beat.idle_s - before.idle_s,
        )
    weight = 1 - np.exp(-span_s / SUN_S)
    charging_w = camera.charging_w + weight * (max(beat.charging_w, 0.0) - camera.charging_w)
    video_w = max(beat.recording_j - before.recording_j, 0.0) / span_s
    known_w = camera.recording_w or video_w
    recording_w = known_w + weight * (video_w - known_w)
    return replace(
        camera,
        cost=cost,
        beat=beat,
        charging_w=float(charging_w),
        recording_w=float(recording_w),
    )


def _slot_cost(camera: CameraEnergy, interval_s: float) -> SlotCost:
    """Return the cost of a camera's slots; a measured one contains the recording of video."""
    cost, video_j = slot_cost(camera.cost, interval_s), camera.recording_w * interval_s
    if cost.measured or video_j == 0:
        return cost
    return replace(cost, active_j=cost.active_j + video_j, idle_j=cost.idle_j + video_j)


def _credible_cost_j(
    cameras: Sequence[CameraEnergy], cost_j: Floats, measured: Flags, interval_s: float
) -> Floats:
    """Return `(num_cameras,)` costs of active slots, without those that one camera makes up.

    Prices are relative to the mean cost of all cameras, so that one that reports a megawatt would
    make the others' free. Devices may all differ from their profiles by the same factor; one that
    differs from the others by more than `STRANGE_TIMES`, or whose cost is not measured while that
    of others is, is taken to cost what theirs do.
    """
    profile_w = np.array([camera.cost.profile_watts() for camera in cameras])
    assumed_j = np.maximum((profile_w[:, 0] - profile_w[:, 1]) * interval_s, LEAST_COST_J)
    times = np.maximum(cost_j, LEAST_COST_J) / assumed_j
    known = np.sort(times[measured] if measured.any() else times)
    typical = known[(len(known) - 1) // 2]
    strange = (times > STRANGE_TIMES * typical) | (times < typical / STRANGE_TIMES)
    unknown = ~measured & measured.any()
    return np.asarray(np.where(strange | unknown, typical, times) * assumed_j)


def estimate_energy(
    cameras: Sequence[CameraEnergy],
    budgets: Sequence[Budget],
    interval_s: float,
    now_s: float,
    num_selected: float,
) -> EnergyEstimate:
    """Return budgets and costs for the next slots; call it every minute.

    Args:
        cameras: `(num_cameras,)` what is known of them.
        budgets: `(num_cameras,)` what each may spend.
        interval_s: seconds per slot.
        now_s: seconds since 1970.
        num_selected: cameras that are to be active in a slot.
    """
    slots = tuple(_slot_cost(camera, interval_s) for camera in cameras)
    active_j = np.array([slot.active_j for slot in slots])
    idle_j = np.array([slot.idle_j for slot in slots])
    measured = np.array([slot.measured for slot in slots])
    supplies = [camera.supply() for camera in cameras]
    allowed_j = allowance_j(budgets, supplies, active_j, idle_j, interval_s, now_s, num_selected)
    budget = slot_shares(allowed_j, active_j, idle_j)
    affordable = float(budget.sum())
    enough = affordable >= num_selected - 1e-6
    return EnergyEstimate(
        budget=budget,
        cost_j=_credible_cost_j(cameras, active_j - idle_j, measured, interval_s),
        slots=slots,
        num_selected=num_selected if enough else AFFORD_SHARE * affordable,
        starved=(allowed_j <= idle_j) & (active_j > idle_j),
    )
