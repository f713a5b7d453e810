"""Named scenes: activities, objects and cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.base.errors import InputError
from e3pose.model.rigs import Spot
from e3pose.simulate.episodes import FALLS
from e3pose.simulate.occluders import Box, Pillar
from e3pose.simulate.place import Condition, Habits, Room, Scene
from e3pose.simulate.settings import DetectorSettings, Guessing

WALL_M = 0.2  # thick
STOREY_M = 3.0  # high
CAMERA_M = 2.4  # cameras hang under the ceiling

# Two rooms of 5 m x 5 m, east and west of a wall with a door at its northern end.
TWO_ROOMS = Scene(
    summary="people walk between two rooms through a door; each camera sees one room",
    people=2, area_m=5.6,
    habits=Habits(stand=0.45, leave=0.06, stand_s=(3.0, 9.0)),
    walls=(Box(0.0, -0.75, WALL_M, 3.5, STOREY_M), Box(0.0, 2.5, WALL_M, 0.2, STOREY_M)),
    rooms=(Room(-5.0, -0.3, -2.5, 2.5), Room(0.3, 5.0, -2.5, 2.5)),
    ways=((-0.6, 1.7), (0.6, 1.7)),
    exits=((-6.2, -1.0), (6.2, -1.0)),
    spots=(
        Spot(-5.2, -2.6, CAMERA_M, -2.5, 0.0), Spot(5.2, -2.6, CAMERA_M, 2.5, 0.0),
        Spot(-0.4, 2.6, CAMERA_M, -2.8, -0.2), Spot(0.4, 2.6, CAMERA_M, 2.8, -0.2),
        Spot(-5.2, 2.6, CAMERA_M, -2.5, -0.2), Spot(5.2, 2.6, CAMERA_M, 2.5, -0.2),
        Spot(-0.4, -2.6, CAMERA_M, -2.8, 0.0), Spot(0.4, -2.6, CAMERA_M, 2.8, 0.0),
    ),
)  # fmt: skip


def _mirrored(spot: Spot) -> Spot:
    """Return the place in the hall's other leg, which mirrors the first."""
    return Spot(spot.y_m, spot.x_m, spot.z_m, spot.target_y_m, spot.target_x_m, spot.view_deg)


# An L of two halls of 12 m x 3.6 m that share their south-western corner; five cameras in each.
LEG = (
    Spot(-1.6, -6.2, CAMERA_M, -4.0, -3.9, 65.0),
    Spot(6.2, -2.5, CAMERA_M, 3.2, -4.6, 65.0),
    Spot(0.8, -2.4, CAMERA_M, -1.2, -4.7, 65.0),
    Spot(1.2, -6.2, CAMERA_M, 3.2, -3.7, 65.0),
    Spot(6.2, -6.1, CAMERA_M, 3.2, -3.6, 65.0),
)
L_HALL = Scene(
    summary="people walk about an L-shaped hall; three or four of ten cameras see any of them",
    people=3, area_m=7.0,
    habits=Habits(stand=0.4, leave=0.06, stand_s=(3.0, 9.0)),
    walls=(Box(1.9, 1.9, 8.4, 8.4, STOREY_M),),
    rooms=(Room(-6.0, 6.0, -6.0, -2.4), Room(-6.0, -2.4, -2.4, 6.0)),
    ways=((-2.8, -2.8),),
    exits=((7.4, -4.2), (-4.2, 7.4)),
    spots=tuple(place for spot in LEG for place in (spot, _mirrored(spot))),
)  # fmt: skip

# A lift shaft of 1.8 m x 1.8 m in the middle of a hall, and six cameras around.
SHAFT = Scene(
    summary="people walk around a lift shaft that hides them from half of six cameras",
    people=3, area_m=3.4, radius_m=5.2, height_m=2.4, cameras=6,
    habits=Habits(stand=0.35, leave=0.06),
    walls=(Box(0.0, 0.0, 1.8, 1.8, STOREY_M),),
    rooms=(
        Room(-3.2, 3.2, -3.2, -0.9), Room(-3.2, 3.2, 0.9, 3.2),
        Room(-3.2, -0.9, -0.9, 0.9), Room(0.9, 3.2, -0.9, 0.9),
    ),
    ways=((1.4, 1.4), (-1.4, 1.4), (-1.4, -1.4), (1.4, -1.4)),
    exits=((5.2, 1.0), (-5.2, -1.0)),
)  # fmt: skip

BUILDINGS: dict[str, Scene] = {
    "shaft": SHAFT,
    "two-rooms": TWO_ROOMS,
    "l-hall": L_HALL,
    "unequal-batteries": replace(
        TWO_ROOMS,
        summary="the two rooms; half of the cameras have little energy left",
        conditions={
            **{index: Condition(battery=0.56) for index in (0, 3, 6, 5)},
            **{index: Condition(battery=1.1) for index in (1, 2, 4, 7)},
        },
    ),
    "dying-cameras": replace(
        L_HALL,
        summary="the L-shaped hall; three of its ten cameras die one after another",
        conditions={
            0: Condition(dies_at=0.25),
            3: Condition(dies_at=0.45),
            6: Condition(dies_at=0.65),
        },
    ),
    "slow": replace(TWO_ROOMS, summary="the two rooms at 10 frames per second", fps=10.0),
}


# Scenes as people record them: they sit and stand round tables for minutes and hide each other.
#
# Cameras hang where there is a place for them. Detectors guess what they do not see
# (`guesses.py`).

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


def _circle_of_seats(number: int, radius_m: float) -> tuple[tuple[float, float, float], ...]:
    """Seats on a circle, facing its middle."""
    angles = 0.4 + 2 * np.pi * np.arange(number) / number
    return tuple(
        (float(radius_m * np.cos(a)), float(radius_m * np.sin(a)), float(a + np.pi)) for a in angles
    )


SCENES: dict[str, Scene] = {
    "ring": Scene(
        summary="people walk about, stop and gesture, sit down, leave and come back",
        people=4, area_m=2.3, radius_m=4.2, height_m=2.0,
        habits=Habits(stand=0.35, sit=0.2, leave=0.12),
        seats=_circle_of_seats(3, 1.7),
    ),
    "crossing": Scene(
        summary="people keep walking through the middle, past each other at arm's length",
        people=4, area_m=2.3, radius_m=4.2, height_m=2.0,
        habits=Habits(cross=True),
    ),
    "crowd": Scene(
        summary="ten people walk and stand close together",
        people=10, area_m=2.9, radius_m=5.0, height_m=2.6,
        habits=Habits(stand=0.3, leave=0.05, speed_mps=(0.7, 1.3)),
    ),
    "meeting": Scene(
        summary="people sit in a circle, gesture, get up and sit down again",
        people=5, area_m=1.9, radius_m=3.8, height_m=2.0,
        habits=Habits(stand=0.3, sit=0.6, sit_s=(8.0, 25.0), speed_mps=(0.8, 1.2)),
        seats=_circle_of_seats(6, 1.5),
    ),
    "pillar": Scene(
        summary="people walk and stand among two pillars and a cupboard that hide them",
        people=4, area_m=2.6, radius_m=4.6, height_m=2.2,
        habits=Habits(stand=0.3, leave=0.1),
        occluders=(
            Pillar(0.9, 0.7, 0.22, 3.0),
            Pillar(-1.0, -0.5, 0.22, 3.0),
            Box(0.3, -1.5, 1.1, 0.45, 1.9, yaw=0.5),
        ),
    ),
    "one-sided": Scene(
        summary="shelves on one side hide people from three of six cameras",
        people=3, area_m=2.2, radius_m=4.2, height_m=2.2, cameras=6,
        habits=Habits(stand=0.35, leave=0.1),
        walls=tuple(
            Box(float(2.8 * np.cos(a)), float(2.8 * np.sin(a)), 0.4, 2.6, 2.4, yaw=a)
            for a in (2 * np.pi / 3, np.pi, 4 * np.pi / 3)
        ),
        exits=((4.0, 1.6), (4.0, -1.6)),
    ),
    "poor-view": Scene(
        summary="one of five cameras looks through frosted glass: it misses much and is blurred",
        people=3, area_m=2.3, radius_m=4.2, height_m=2.0,
        habits=Habits(stand=0.35, leave=0.12),
        conditions={1: Condition(noise=2.0, blur=1.2, joint_miss=0.2, person_miss=0.3)},
    ),
    **BUILDINGS,
    **GATHERINGS,
    **HOMES,
}  # fmt: skip


def scene_by_name(name: str) -> Scene:
    """Return the scene called `name`; raise `InputError` with the known ones if there is none."""
    if name not in SCENES:
        raise InputError(
            f"simulate: scene: found {name[:40]!r}, expected one of {', '.join(SCENES)}"
        )
    return SCENES[name]
