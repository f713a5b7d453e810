"""Agility: how much more, or less, a person's joints move than a predictor expects.

Where the process noise of a joint is too large, every look moves it too far, and the next look of
another camera moves it back; where it is too small, the next look moves it on the same way. So the
logarithm of the factor on the noise follows the product of each innovation with the correction of
the look before, as its camera sees that. Looks of one camera are not compared: its errors repeat
themselves, and would look like motion. Figures: `lab/experiments/2026-11-23-agility.md`.
"""

from __future__ import annotations

import math

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.outliers import ROBUST
from e3pose.estimate.filter.projected import Beside

# tuned: per keypoint | not recorded | agility
RATE = 0.1  # of one keypoint that confirms, or takes back, all of the correction before it
# tuned: logarithm | not recorded | agility
FURTHEST = 2.0  # the logarithm of the factor, either way
# tuned: s | not recorded | agility
LASTS_S = 3.0  # until what was learned is down to 1/e: people who stood begin to walk


@kernel
def fade_agility(agility: Floats, newest_s: float, dt: float) -> bool:
    """Forget a part of `agility` `(num_joints,)`; return whether the look before still tells.

    `newest_s` is the age of that look when the slot before was computed, `dt` the time since.
    """
    for joint in range(len(agility)):
        agility[joint] *= math.exp(-dt / LASTS_S)
    return newest_s + dt <= LASTS_S


@kernel
def confirm(
    found: Beside, variance: float, corrected_m: Floats, joint: int, agility: Floats
) -> None:
    """Let one keypoint teach `agility`: does it confirm the correction of the look before?

    `variance` is of the keypoint, px2; `corrected_m` `(3,)` the correction of its joint.
    """
    x, y, z = corrected_m[0], corrected_m[1], corrected_m[2]
    du, dv = found.du, found.dv
    alike = du * (found.ux * x + found.uy * y + found.uz * z)
    alike += dv * (found.vx * x + found.vy * y + found.vz * z)
    alike /= variance + found.variance_px2 + (du * du + dv * dv) * ROBUST
    learned = agility[joint] + RATE * min(max(alike, -1.0), 1.0)
    agility[joint] = min(max(learned, -FURTHEST), FURTHEST)
