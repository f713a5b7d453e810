"""How often a board on the floor is placed tilted the other way, by pictures of 1, 2 and 4 cameras.

    python lab/benchmarks/floor_boards.py [--runs 200]

An A4 board lies anywhere within a metre of the middle of a ring of five cameras (4 m, 1280 x 720),
turned anyhow. A mirrored one is tilted by 20 degrees or more; printed are the runs that were
placed, refused, and mirrored (more than 8 degrees off), and the largest tilt of those placed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from e3pose.base.errors import InputError
from e3pose.calibrate.from_boards import board_on_floor

sys.path.append(str(Path(__file__).resolve().parents[2]))  # scenes of the tests

from tests.calibrate.test_from_boards import A4, thrown

KINDS = ((1, 0.2), (1, 0.5), (2, 0.5), (4, 0.5))
MIRRORED_DEG = 8.0


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=200)
    runs = parser.parse_args().runs
    print("| cameras | corners, px | placed | refused | mirrored | largest tilt, degrees |")
    print("|---" * 6 + "|")
    for cameras, noise_px in KINDS:
        tilts = []
        for seed in range(runs):
            rig, turn, pixels = thrown(seed, cameras, noise_px)
            try:
                found = board_on_floor(rig, A4.corners_m, pixels)
            except InputError:
                continue
            cosine = float(np.clip(found[:3, 2] @ turn[:, 2], -1, 1))
            tilts.append(np.degrees(np.arccos(cosine)))
        mirrored = int((np.array(tilts) > MIRRORED_DEG).sum())
        print(
            f"| {cameras} | {noise_px} | {len(tilts)} | {runs - len(tilts)} | {mirrored} | "
            f"{max(tilts, default=0.0):.1f} |", flush=True,
        )  # fmt: skip


if __name__ == "__main__":
    main()
