"""Agility: how much more, or less, a person's joints move than a predictor expects.

Where the process noise of a joint is too large, every look moves it too far, and the next look of
another camera moves it back; where it is too small, the next look moves it on the same way. So the
logarithm of the factor on the noise follows the product of each innovation with the correction of
the look before, as its camera sees that. Looks of one camera are not compared: its errors repeat
themselves, and would look like motion. Figures: `docs/experiments/2026-11-23-agility.md`.
"""

from __future__ import annotations

RATE = 0.1  # of one keypoint that confirms, or takes back, all of the correction before it
FURTHEST = 2.0  # the logarithm of the factor, either way
LASTS_S = 3.0  # until what was learned is down to 1/e: people who stood begin to walk
STALE_S = 0.5  # a correction older than this is not compared
