"""Simulate a site on batteries until they are empty."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.energy.budgets import Budget, Supply, allowance_j, slot_shares
from e3pose.energy.queues import advance_deficit, price
from e3pose.select.policies.base import Situation
from e3pose.select.policies.drift_plus_penalty import DriftPlusPenalty

BudgetKind = Literal["equal", "each", "together"]

UPDATE_SLOTS = 60  # how often budgets follow the batteries


@dataclass(frozen=True, slots=True)
class BatteryCamera:
    """A camera on a battery.

    Attributes:
        battery_wh: what it holds when full, at the start.
        active_w: power when active.
        idle_w: power when not.
        sun_w: power that charges it at a time, by hours since the start.
    """

    battery_wh: float
    active_w: float
    idle_w: float
    sun_w: Callable[[float], float] = lambda hours: 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Depletion:
    """How it went.

    Attributes:
        empty_h: `(num_cameras,)` hours after which each was empty; NaN if it never was.
        duty: `(num_cameras,)` share of the slots of its life in which it was active.
        full_h: hours for which as many cameras as asked for were active in every slot.
        occlusion: mean occlusion of the cameras selected, over `full_h`.
        charge: `(num_updates, num_cameras)` share of the battery left, every `UPDATE_SLOTS`.
    """

    empty_h: Floats
    duty: Floats
    full_h: float
    occlusion: float
    charge: Floats


def deplete(
    cameras: Sequence[BatteryCamera],
    num_selected: int,
    budget: BudgetKind,
    *,
    quality_weight: float = 1.0,
    hours: float = 24.0,
    interval_s: float = 1.0,
    seed: int = 0,
) -> Depletion:
    """Play a site until its batteries are empty, with the paper's policy and queues.

    Args:
        cameras: of the site.
        num_selected: the paper's C.
        budget: `equal` gives every camera the paper's E_n = C/N and prices the queues in slots;
            `each` gives it the paper's E_n by its battery, C times its share of all batteries;
            `together` has the batteries last equally long and prices them in joules.
        quality_weight: the paper's V.
        hours: at most.
        interval_s: seconds per slot.
        seed: of the occlusions, which wander slowly between 0 and 1.
    """
    rng = np.random.default_rng(seed)
    count = len(cameras)
    full_j = np.array([camera.battery_wh for camera in cameras]) * 3600
    active_j = np.array([camera.active_w for camera in cameras]) * interval_s
    idle_j = np.array([camera.idle_w for camera in cameras]) * interval_s
    cost_j = active_j - idle_j if budget == "together" else np.ones(count)
    policy = DriftPlusPenalty(num_selected, quality_weight)
    battery_j, deficit = full_j.copy(), np.zeros(count)
    shares = np.full(count, num_selected / count)
    if budget == "each":
        shares = np.minimum(num_selected * full_j / full_j.sum(), 1.0)
    occlusion, online = rng.random(count), np.ones(count, dtype=bool)
    empty_h, active_slots, life = np.full(count, np.nan), np.zeros(count), np.zeros(count)
    seen, full_slots, charge = 0.0, 0, []
    sun_j = np.zeros(count)
    for slot in range(int(hours * 3600 / interval_s)):
        hour = slot * interval_s / 3600
        if slot % UPDATE_SLOTS == 0:
            charge.append(battery_j / full_j)
            sun_j = np.array([camera.sun_w(hour) for camera in cameras]) * interval_s
            if budget == "together":
                supplies = [
                    Supply(b, s / interval_s) for b, s in zip(battery_j, sun_j, strict=True)
                ]
                shares = _shares(supplies, active_j, idle_j, interval_s, slot, num_selected)
        occlusion = np.clip(occlusion + 0.05 * rng.normal(size=count), 0.0, 1.0)
        prices = price(deficit, cost_j)
        selected = policy.select(
            _situation(slot, interval_s, online, occlusion, deficit, shares, prices)
        )
        deficit = advance_deficit(deficit, shares, selected)
        if selected.sum() == num_selected and not np.isfinite(empty_h).any():
            full_slots += 1
            seen += float(occlusion[selected].mean())
        spent_j = np.where(selected, active_j, idle_j) * online
        battery_j = np.minimum(battery_j - spent_j + sun_j * online, full_j)
        active_slots += selected
        life += online
        out = online & (battery_j <= 0)
        empty_h[out] = hour
        online = online & ~out
        if not online.any():
            break
    return Depletion(
        empty_h=empty_h,
        duty=active_slots / np.maximum(life, 1),
        full_h=full_slots * interval_s / 3600,
        occlusion=seen / max(full_slots, 1),
        charge=np.array(charge),
    )


def _shares(
    supplies: Sequence[Supply],
    active_j: Floats,
    idle_j: Floats,
    interval_s: float,
    slot: int,
    num_selected: int,
) -> Floats:
    """Return the shares of slots `(num_cameras,)` with which all batteries last equally long."""
    budgets = [Budget("together")] * len(supplies)
    allowed = allowance_j(
        budgets, supplies, active_j, idle_j, interval_s, slot * interval_s, num_selected
    )
    return slot_shares(allowed, active_j, idle_j)


def _situation(
    slot: int,
    interval_s: float,
    online: NDArray[np.bool_],
    occlusion: Floats,
    deficit: Floats,
    shares: Floats,
    prices: Floats,
) -> Situation:
    """Return the situation of a slot in which only occlusion and queues differ by camera."""
    count = len(online)
    return Situation(
        slot=slot,
        interval_s=interval_s,
        online=online,
        occlusion=occlusion,
        own_occlusion=occlusion,
        unseen_slots=np.zeros(count, dtype=np.int64),
        visibility=np.ones((count, 1)),
        deficit=deficit,
        budget=shares,
        price=prices,
    )
