"""Homes: a room with a bed, a table and a sofa, and four cameras in its corners."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.model.rigs import Spot
from e3pose.simulate.episode_kinds import FALLS
from e3pose.simulate.occluders import Box
from e3pose.simulate.place import Habits, Room, Scene
from e3pose.simulate.settings import DetectorSettings, Guessing

CORNER_M = 2.3  # cameras hang so high
NARROW_DEG = 50.0  # in place of 85
BED, SOFA = (-1.85, 1.0), (1.9, -1.1)  # middles, metres
DAILY = (
    "lie-on-bed", "lie-on-sofa", "lie-on-floor", "sit-hard", "sit-on-floor", "kneel", "tie-shoes",
    "pick-up", "squat",
)  # fmt: skip
# What somebody does on a day, and how often: by reasoning, of no study.
ORDINARY = {
    "pick-up": 18, "sit-hard": 6, "kneel": 6, "squat": 6, "tie-shoes": 4, "lie-on-bed": 2,
    "lie-on-sofa": 2, "sit-on-floor": 2, "lie-on-floor": 1,
}  # fmt: skip

HOME = Scene(
    summary="one person lives in a room: walks, sits, bends, lies on a bed",
    people=1, area_m=2.6,
    habits=Habits(stand=0.2, sit=0.2, do=0.45, does=DAILY, speed_mps=(0.6, 1.2)),
    seats=((0.3, 1.1, -np.pi / 2), (1.0, 1.1, -np.pi / 2)),
    beds=((-0.95, 1.0, 0.0), (1.9, -0.35, np.pi / 2)),
    occluders=(
        Box(*BED, 0.9, 2.0, 0.5), Box(*SOFA, 1.8, 0.8, 0.42), Box(0.6, 1.75, 1.4, 0.7, 0.74),
    ),
    rooms=(Room(-2.4, 2.4, -1.9, 1.9),),
    exits=((3.6, 0.4),),
    spots=(
        Spot(-2.5, -2.0, CORNER_M, 0.3, 0.2, 85.0), Spot(2.5, 2.0, CORNER_M, -0.3, -0.2, 85.0),
        Spot(2.5, -2.0, CORNER_M, -0.3, 0.2, 85.0), Spot(-2.5, 2.0, CORNER_M, 0.3, -0.2, 85.0),
    ),
    detector=DetectorSettings(guessing=Guessing()),
)  # fmt: skip

HOMES: dict[str, Scene] = {
    "home": HOME,
    "home-fall": replace(
        HOME,
        summary="the same room; the person falls in many ways, and gets up again",
        habits=replace(
            HOME.habits, stand=0.1, sit=0.1, do=0.8, does=tuple(FALLS), lies_s=(8.0, 30.0)
        ),
    ),
    "home-floor": replace(
        HOME,
        summary="the same room; the person lies, sits and kneels down on the floor, and gets up",
        habits=replace(
            HOME.habits, stand=0.05, sit=0.05, do=0.85, lies_s=(3.0, 8.0),
            does=("lie-on-floor", "sit-on-floor", "kneel"),
        ),
    ),
    "home-play": replace(
        HOME,
        summary="the same room; two children crawl, jump, drop to the floor and get up",
        people=2, statures_m=(0.95, 1.4),
        habits=replace(
            HOME.habits, sit=0.05, do=0.7, speed_mps=(0.8, 1.6),
            does=("play", "crawl", "jump", "sit-on-floor", "squat"), lies_s=(0.0, 2.0),
        ),
    ),
    "home-day": replace(
        HOME,
        summary="the same room; what three people do on days, without the hours in between",
        people=3,
        habits=replace(
            HOME.habits, leave=0.05,
            does=tuple(kind for kind, times in ORDINARY.items() for _ in range(times)),
        ),
    ),
    "home-night": replace(
        HOME,
        summary="the same room; two people lie in bed, and get up now and then",
        people=2,
        habits=replace(HOME.habits, do=0.9, does=("lie-on-bed",), lies_s=(300.0, 900.0)),
    ),
    "home-crowd": replace(
        HOME,
        summary="the same room; four people, often one before the other, fall and do all else",
        people=4, habits=replace(HOME.habits, do=0.7, does=(*FALLS, *DAILY)),
    ),
    "home-edge": replace(
        HOME,
        summary="the same room; its cameras see a part, and cut people off; falls and all else",
        habits=replace(HOME.habits, do=0.7, does=(*FALLS, *DAILY)),
        spots=tuple(replace(spot, view_deg=NARROW_DEG) for spot in HOME.spots),
    ),
}  # fmt: skip
