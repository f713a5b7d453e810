"""Scenes in which no camera sees everybody: rooms, halls, rigs with failing cameras."""

from __future__ import annotations

from dataclasses import replace

from e3pose.model.rigs import Spot
from e3pose.simulate.occluders import Box
from e3pose.simulate.place import Condition, Habits, Room, Scene

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
