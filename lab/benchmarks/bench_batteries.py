"""Play sites on batteries until they are empty: who runs out when, with and without budgets."""

from __future__ import annotations

import argparse

import numpy as np

from e3pose_lab.reproduce.battery_sites import SITES
from e3pose_lab.reproduce.depletion import BudgetKind, deplete


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cameras", type=int, default=3, help="C, active in every slot")
    parser.add_argument("--quality-weight", type=float, default=1.0, help="V")
    options = parser.parse_args()
    np.set_printoptions(precision=2, floatmode="fixed")
    print(f"{options.cameras} of 5 cameras in every slot of a second; hours until empty, duty")
    for name, site in SITES.items():
        print(f"\n{name}")
        budgets: tuple[BudgetKind, ...] = ("equal", "each", "together")
        for budget in budgets:
            played = deplete(site, options.cameras, budget, quality_weight=options.quality_weight)
            print(
                f"  {budget:<9} all needed for {played.full_h:5.2f} h   empty {played.empty_h}   "
                f"spread {np.ptp(played.empty_h):5.2f} h   duty {played.duty}   "
                f"occlusion {played.occlusion:.3f}"
            )


if __name__ == "__main__":
    main()
