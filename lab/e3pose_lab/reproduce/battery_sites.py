"""Sites on batteries: charges, loads, and budgets until a common end."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sin

import numpy as np

from e3pose.energy.profiles import load_profile
from e3pose_lab.reproduce.depletion import UPDATE_SLOTS, BatteryCamera, BudgetKind, deplete
from e3pose_lab.reproduce.sources import Sources

DAY_H = 24.0
PROFILES = {name: load_profile(name) for name in ("xavier-nx", "tx2", "generic")}


def camera(battery_wh: float, profile: str = "xavier-nx", peak_w: float = 0.0) -> BatteryCamera:
    """Return a camera; a panel gives it `peak_w` at noon, four hours after the start."""
    device = PROFILES[profile]
    return BatteryCamera(
        battery_wh,
        device.watts("active"),
        device.watts("power-saving"),
        lambda hours: peak_w * max(0.0, sin(pi * (hours + 2) / 12)),
    )


SITES = {
    "the same": [camera(50) for _ in range(5)],
    "36 to 60 Wh": [camera(wh) for wh in (36, 42, 50, 55, 60)],
    "other devices too": [
        camera(40), camera(50, "tx2"), camera(45, "generic"), camera(58, "tx2"), camera(55),
    ],
    "one with a panel": [camera(45, peak_w=5.0), *(camera(wh) for wh in (45, 45, 50, 55))],
    "one far too small": [camera(20), *(camera(wh) for wh in (50, 50, 55, 60))],
}  # fmt: skip
# Batteries of some days with panels: the sun must carry a part of them through.
SUNNY = {
    "days, 600 Wh each": [camera(wh) for wh in (600, 600, 600, 600, 600)],
    "days, 400 to 800 Wh": [camera(wh) for wh in (400, 500, 600, 700, 800)],
    "days, 400 Wh, panels on all": [camera(wh, peak_w=10.0) for wh in (400, 400, 400, 400, 400)],
    "days, panels on three of five": [
        camera(300, peak_w=15.0), camera(300, peak_w=15.0), camera(300, peak_w=15.0), camera(600),
        camera(600),
    ],
}  # fmt: skip
ALL_SITES = {**SITES, **SUNNY}
SLOT_S = 10.0  # a slot stands for many: budgets and queues do not depend on its length


@dataclass(frozen=True, slots=True)
class SiteAsked:
    """Which site of `ALL_SITES`, with which budgets, and the paper's C."""

    site: str
    budget: BudgetKind
    cameras: int = 3
    quality_weight: float = 1.0
    hours: float = 14 * DAY_H


@dataclass(frozen=True, slots=True)
class SiteFigures:
    """Figures of a site on batteries.

    Attributes:
        complete_h: hours for which C cameras were active in every slot.
        empty_h: when each camera was empty, in hours; None if it never was.
        duty: share of the slots of its life in which each was active.
        charge: share of its battery that each had left, at `hours`.
        hours: some points in time.
    """

    complete_h: float
    empty_h: tuple[float | None, ...]
    duty: tuple[float, ...]
    charge: tuple[tuple[float, ...], ...]
    hours: tuple[float, ...]


def site_figures(sources: Sources, asked: SiteAsked) -> SiteFigures:
    """Play a site until its batteries are empty, or for two weeks."""
    played = deplete(
        ALL_SITES[asked.site], asked.cameras, asked.budget,
        quality_weight=asked.quality_weight, hours=asked.hours, interval_s=SLOT_S,
    )  # fmt: skip
    every = max(1, len(played.charge) // 60)
    step_h = UPDATE_SLOTS * SLOT_S / 3600
    return SiteFigures(
        complete_h=played.full_h,
        empty_h=tuple(None if np.isnan(h) else float(h) for h in played.empty_h),
        duty=tuple(played.duty.tolist()),
        charge=tuple(tuple(row.tolist()) for row in played.charge[::every]),
        hours=tuple(float(n * step_h) for n in range(0, len(played.charge), every)),
    )
