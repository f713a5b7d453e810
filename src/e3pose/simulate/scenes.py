"""Named scenes: what people do there, what stands in their way, and where the cameras are."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from e3pose.errors import InputError
from e3pose.simulate.occluders import Box, Occluder, Pillar


@dataclass(frozen=True, slots=True)
class Habits:
    """What people do when they have reached a place; shares add up to at most 1, the rest walk on.

    Attributes:
        stand: share that stops, half of them gesturing.
        sit: share that takes a free seat.
        leave: share that goes away through a door and comes back later.
        cross: whether people walk straight through the middle to the other side.
        stand_s: shortest and longest stop.
        sit_s: shortest and longest time on a seat.
        speed_mps: slowest and fastest walking pace.
    """

    stand: float = 0.0
    sit: float = 0.0
    leave: float = 0.0
    cross: bool = False
    stand_s: tuple[float, float] = (2.0, 7.0)
    sit_s: tuple[float, float] = (5.0, 14.0)
    speed_mps: tuple[float, float] = (0.9, 1.5)


@dataclass(frozen=True, slots=True)
class Scene:
    """A place and what goes on in it, around the origin of the floor.

    Attributes:
        summary: one line for people.
        people: how many, unless asked otherwise.
        area_m: radius of the floor that people use.
        radius_m: distance of the ring's cameras.
        height_m: height of the ring's cameras.
        habits: what people do.
        seats: `(x, y, heading)` of each seat, metres and radians.
        occluders: what stands there.
    """

    summary: str
    people: int
    area_m: float
    radius_m: float
    height_m: float
    habits: Habits
    seats: tuple[tuple[float, float, float], ...] = ()
    occluders: tuple[Occluder, ...] = ()

    def fitted(self, area_m: float) -> Scene:
        """Return the scene for a floor of another radius; seats move along, occluders stay away.

        Occluders keep their place and size: they belong to a room, not to a rig.
        """
        factor = area_m / self.area_m
        seats = tuple((x * factor, y * factor, heading) for x, y, heading in self.seats)
        return replace(self, area_m=area_m, seats=seats)


def _circle_of_seats(
    number: int, radius_m: float, first: float = 0.4
) -> tuple[tuple[float, float, float], ...]:
    """Seats on a circle, facing its middle."""
    angles = first + 2 * np.pi * np.arange(number) / number
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
}  # fmt: skip


def scene_by_name(name: str) -> Scene:
    """Return the scene called `name`; raise `InputError` with the known ones if there is none."""
    if name not in SCENES:
        raise InputError(
            f"simulate: scene: found {name[:40]!r}, expected one of {', '.join(SCENES)}"
        )
    return SCENES[name]
