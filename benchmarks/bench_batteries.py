"""Play sites on batteries until they are empty: who runs out when, with and without budgets."""

from __future__ import annotations

import argparse
from math import pi, sin

import numpy as np

from e3pose.energy.profiles import load_profile
from e3pose.reproduce.depletion import BatteryCamera, deplete

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cameras", type=int, default=3, help="C, active in every slot")
    parser.add_argument("--quality-weight", type=float, default=1.0, help="V")
    options = parser.parse_args()
    np.set_printoptions(precision=2, floatmode="fixed")
    print(f"{options.cameras} of 5 cameras in every slot of a second; hours until empty, duty")
    for name, site in SITES.items():
        print(f"\n{name}")
        for budget in ("equal", "together"):
            played = deplete(site, options.cameras, budget, quality_weight=options.quality_weight)
            print(
                f"  {budget:<9} all needed for {played.full_h:5.2f} h   empty {played.empty_h}   "
                f"spread {np.ptp(played.empty_h):5.2f} h   duty {played.duty}   "
                f"occlusion {played.occlusion:.3f}"
            )


if __name__ == "__main__":
    main()
