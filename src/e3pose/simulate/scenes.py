"""Named scenes: activities, objects and cameras."""

from __future__ import annotations

import numpy as np

from e3pose.base.errors import InputError
from e3pose.simulate.buildings import BUILDINGS
from e3pose.simulate.gatherings import GATHERINGS
from e3pose.simulate.homes import HOMES
from e3pose.simulate.occluders import Box, Pillar
from e3pose.simulate.place import Condition, Habits, Scene


def _circle_of_seats(
    number: int, radius_m: float, first: float = 0.4
) -> tuple[tuple[float, float, float], ...]:
    """Seats on a circle, facing its middle."""
    angles = first + 2 * np.pi * np.arange(number) / number
    return tuple(
        (float(radius_m * np.cos(a)), float(radius_m * np.sin(a)), float(a + np.pi)) for a in angles
    )


def _shelves(radius_m: float, angles: tuple[float, ...]) -> tuple[Box, ...]:
    """Shelves of 0.4 m x 2.6 m, 2.4 m high, around the scene."""
    return tuple(
        Box(float(radius_m * np.cos(a)), float(radius_m * np.sin(a)), 0.4, 2.6, 2.4, yaw=a)
        for a in angles
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
        walls=_shelves(2.8, (2 * np.pi / 3, np.pi, 4 * np.pi / 3)),
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
