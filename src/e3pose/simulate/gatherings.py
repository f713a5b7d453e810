"""Scenes as people record them: they sit and stand round tables for minutes and hide each other.

Cameras hang where there is a place for them. Detectors guess what they do not see (`guesses.py`).
"""

from __future__ import annotations

import numpy as np

from e3pose.model.rigs import Spot
from e3pose.simulate.occluders import Box
from e3pose.simulate.place import Habits, Room, Scene
from e3pose.simulate.settings import DetectorSettings, Guessing

GUESSES = DetectorSettings(guessing=Guessing())
# Another network than the rig's noise was measured for: larger errors, which its scores hide.
FOREIGN = DetectorSettings(guessing=Guessing(sigma_m=0.032, joint_miss=0.05, overconfidence=1.0))

Seat = tuple[float, float, float]


def _cluster(
    x_m: float, y_m: float, radius_m: float, number: int, first: float
) -> tuple[Seat, ...]:
    """Places of a group that stands and talks, facing its middle."""
    angles = first + 2 * np.pi * np.arange(number) / number
    return tuple(
        (float(x_m + radius_m * np.cos(a)), float(y_m + radius_m * np.sin(a)), float(a + np.pi))
        for a in angles
    )


UP, DOWN, RIGHT, LEFT = np.pi / 2, -np.pi / 2, 0.0, np.pi  # headings along and against y and x

ROUND_TABLE = Scene(
    summary="six people sit round a table, which hides their legs",
    people=6, area_m=2.4,
    habits=Habits(
        stand=0.2, sit=0.8, sit_s=(40.0, 200.0), settled=True,
        held=("eat", "cup", "work", "talk", "crossed"), held_s=(6.0, 40.0),
    ),
    seats=(
        (-0.4, -0.9, UP), (0.4, -0.9, UP), (-0.4, 0.9, DOWN), (0.4, 0.9, DOWN),
        (-1.1, 0.0, RIGHT), (1.1, 0.0, LEFT),
    ),
    occluders=(Box(0.0, 0.0, 1.6, 1.2, 0.75, bottom_m=0.70, overhang_m=0.4),),
    exits=((3.2, 0.5),),
    spots=(
        Spot(2.7, 2.2, 2.4, 0.0, 0.0, 75.0), Spot(-2.7, 2.1, 2.5, 0.1, 0.0, 75.0),
        Spot(-2.5, -2.2, 1.3, 0.2, 0.0, 65.0), Spot(2.6, -2.3, 2.2, -0.1, 0.1, 75.0, 1.0, 6.0),
        Spot(-2.1, -2.4, 1.5, 0.2, 0.1, 65.0), Spot(0.4, -1.9, 2.7, 0.0, 0.2, 80.0, 0.8),
    ),
    detector=GUESSES,
)  # fmt: skip

BUFFET = Scene(
    summary="four people stand round a small table and hold plates; near cameras cut their legs",
    people=4, area_m=1.8,
    habits=Habits(
        stand=0.1, sit=0.9, stand_s=(30.0, 180.0), settled=True,
        held=("plate", "cup", "eat", "talk", "lean"), held_s=(5.0, 40.0),
    ),
    seats=(
        (-0.5, -0.85, 1.3), (0.4, -0.9, 1.8), (1.0, 0.1, LEFT), (0.2, 0.85, DOWN),
        (-0.95, 0.35, -0.4),
    ),
    upright=True,
    occluders=(Box(0.0, 0.0, 1.2, 0.7, 0.75, bottom_m=0.70, overhang_m=0.1),),
    exits=((3.0, 0.0),),
    spots=(
        Spot(2.4, -0.9, 1.3, 0.0, 0.0, 69.0), Spot(-1.9, -1.9, 2.4, 0.2, 0.2, 69.0),
        Spot(0.6, 2.6, 2.6, 0.0, -0.1, 69.0), Spot(2.2, -1.4, 1.5, 0.0, 0.1, 69.0),
        Spot(-2.5, 0.8, 1.0, 0.1, 0.0, 69.0, 1.1, -5.0),
    ),
    detector=GUESSES,
)  # fmt: skip

RECEPTION = Scene(
    summary="nine people stand in three groups and talk, some change the group",
    people=9, area_m=2.6,
    habits=Habits(
        stand=0.1, sit=0.85, leave=0.05, stand_s=(20.0, 150.0), speed_mps=(0.7, 1.2), settled=True,
        held=("cup", "talk", "crossed", "plate", "hips"), held_s=(4.0, 30.0),
    ),
    seats=(
        *_cluster(-1.2, -0.6, 0.5, 3, 0.3), *_cluster(1.1, -0.8, 0.48, 3, 1.2),
        *_cluster(0.1, 1.2, 0.52, 3, 0.8), *_cluster(-1.7, 1.4, 0.45, 2, 0.2),
    ),
    upright=True,
    exits=((4.6, 0.5), (-4.6, 0.0)),
    spots=(
        Spot(3.9, 3.0, 2.6, 0.0, 0.0, 70.0), Spot(-3.9, 3.0, 2.4, 0.0, 0.2, 70.0),
        Spot(-3.9, -3.0, 2.7, 0.0, 0.0, 70.0), Spot(3.4, -3.1, 1.8, 0.0, 0.2, 70.0, 1.0, 4.0),
        Spot(3.0, -3.3, 2.0, 0.0, 0.2, 70.0), Spot(0.2, 3.3, 1.5, 0.0, 0.0, 80.0),
    ),
    detector=GUESSES,
)  # fmt: skip

OPERATING_ROOM = Scene(
    summary="staff stand close round a covered table; lamps hang before high cameras",
    people=6, area_m=2.6, fps=6.0,
    habits=Habits(
        stand=0.2, sit=0.8, stand_s=(40.0, 240.0), settled=True,
        held=("work", "lean", "work", "crossed"), held_s=(8.0, 60.0),
    ),
    seats=(
        (-0.5, -0.62, UP), (0.15, -0.62, UP), (-0.3, 0.62, DOWN), (0.35, 0.62, DOWN),
        (1.38, 0.0, LEFT), (0.95, -1.2, 2.2), (-1.6, 0.7, 0.0),
    ),
    upright=True,
    platforms=((Room(-0.75, 0.75, 0.4, 1.2), 0.2),),
    occluders=(
        Box(0.0, 0.0, 2.0, 0.6, 1.0),
        Box(0.0, 0.1, 0.7, 0.7, 2.15, bottom_m=1.95, overhang_m=0.3),
        Box(1.5, -1.3, 0.6, 0.45, 0.95),
    ),
    exits=((-3.6, -1.5),),
    spots=(
        Spot(2.9, 2.5, 2.7, 0.0, 0.0, 70.0), Spot(-2.9, 2.4, 2.6, 0.0, 0.0, 70.0),
        Spot(-2.8, -2.5, 2.7, 0.1, 0.0, 70.0), Spot(2.8, -2.6, 2.5, 0.0, 0.1, 70.0, 1.0, -7.0),
        Spot(2.5, -2.7, 2.3, 0.0, 0.0, 70.0), Spot(-3.0, 0.3, 2.0, 0.2, 0.0, 65.0),
    ),
    detector=FOREIGN,
)  # fmt: skip

LAB = Scene(
    summary="people work at benches and on a raised floor, seen by five cameras hung unevenly",
    people=3, area_m=2.4,
    habits=Habits(
        stand=0.35, sit=0.45, leave=0.05, stand_s=(10.0, 60.0), settled=True,
        held=("work", "lean", "cup", "point", "crossed"), held_s=(4.0, 25.0),
    ),
    seats=((-1.2, 1.25, UP), (0.2, 1.25, UP), (1.35, -0.6, RIGHT), (-1.0, -1.0, 0.6)),
    upright=True,
    platforms=((Room(-1.9, -0.3, -1.9, -0.3), 0.3),),
    occluders=(
        Box(-0.5, 1.85, 2.8, 0.6, 0.90, bottom_m=0.85),
        Box(1.95, -0.6, 0.6, 1.6, 0.90, bottom_m=0.85),
    ),
    exits=((3.6, 1.6),),
    spots=(
        Spot(-3.2, -2.6, 2.6, 0.0, 0.0, 75.0), Spot(3.0, -2.5, 0.9, 0.0, 0.0, 60.0),
        Spot(3.3, 2.2, 2.3, 0.0, -0.2, 75.0, 1.0, 8.0), Spot(2.6, -2.8, 1.5, 0.0, 0.1, 60.0),
        Spot(-3.0, 1.2, 1.9, 0.2, 0.0, 75.0),
    ),
    detector=GUESSES,
)  # fmt: skip

GATHERINGS: dict[str, Scene] = {
    "round-table": ROUND_TABLE,
    "buffet": BUFFET,
    "reception": RECEPTION,
    "operating-room": OPERATING_ROOM,
    "lab": LAB,
}
