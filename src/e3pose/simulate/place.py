"""The layout of a scene: floor, objects, walls, cameras, habits of its people."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.rigs import Spot
from e3pose.simulate.occluders import Box, Occluder
from e3pose.simulate.settings import DetectorSettings

STEP_M = 0.35  # length of a stride onto a raised floor


@dataclass(frozen=True, slots=True)
class Habits:
    """The activities of people who reach a place; shares add up to at most 1, the rest walk on.

    Attributes:
        stand: share that stops, half of them gesturing.
        sit: share that takes a free seat.
        leave: share that goes away through a door and comes back later.
        cross: whether people walk straight through the middle to the other side.
        stand_s: shortest and longest stop.
        sit_s: shortest and longest time on a seat.
        speed_mps: slowest and fastest walking pace.
        settled: whether people are at their places from the start.
        held: what hands do there; the usual gestures by default.
        held_s: shortest and longest time that they do it.
        do: share that does one of `does` there.
        does: names of `episodes.EPISODES`.
        lies_s: shortest and longest time on the floor or a bed.
    """

    stand: float = 0.0
    sit: float = 0.0
    leave: float = 0.0
    cross: bool = False
    stand_s: tuple[float, float] = (2.0, 7.0)
    sit_s: tuple[float, float] = (5.0, 14.0)
    speed_mps: tuple[float, float] = (0.9, 1.5)
    settled: bool = False
    held: tuple[str, ...] = ()
    held_s: tuple[float, float] = (3.0, 9.0)
    do: float = 0.0
    does: tuple[str, ...] = ()
    lies_s: tuple[float, float] = (8.0, 16.0)


@dataclass(frozen=True, slots=True)
class Room:
    """A rectangle of floor that people use, in metres."""

    low_x_m: float
    high_x_m: float
    low_y_m: float
    high_y_m: float

    @property
    def area_m2(self) -> float:
        """Size of the floor."""
        return (self.high_x_m - self.low_x_m) * (self.high_y_m - self.low_y_m)

    @property
    def middle(self) -> tuple[float, float]:
        """`(x, y)` of the middle in metres."""
        return 0.5 * (self.low_x_m + self.high_x_m), 0.5 * (self.low_y_m + self.high_y_m)


@dataclass(frozen=True, slots=True)
class Condition:
    """The peculiarities of one camera of a scene.

    Attributes:
        noise: factor on its keypoint noise.
        blur: log-odds taken from its scores.
        joint_miss: share of joints in plain sight that it misses beyond those all cameras miss.
        person_miss: the same for whole people.
        battery: energy left at the start, as a share of what it draws when always active.
        dies_at: when it goes for good, as a share of the recording; None for never.
    """

    noise: float = 1.0
    blur: float = 0.0
    joint_miss: float = 0.0
    person_miss: float = 0.0
    battery: float | None = None
    dies_at: float | None = None


@dataclass(frozen=True, slots=True)
class Scene:
    """A place and what goes on in it, around the origin of the floor.

    Attributes:
        summary: one line for people.
        people: how many, unless asked otherwise.
        area_m: radius of the floor that people use.
        habits: what people do.
        radius_m: distance of the ring's cameras.
        height_m: height of the ring's cameras.
        cameras: how many stand in the ring, unless asked otherwise.
        fps: slots per second, unless asked otherwise.
        seats: `(x, y, heading)` of each seat, metres and radians.
        upright: whether people stand at the seats.
        beds: `(x, y, heading)` where people sit down on a bed or a sofa, as of a seat.
        statures_m: smallest and largest person; adults by default.
        platforms: raised floors, and by how many metres.
        detector: how its detectors err, unless asked otherwise.
        occluders: what stands there; detectors guess some of the joints it hides.
        walls: opaque, they hide people completely.
        rooms: floors that people use instead of the disc of `area_m`.
        ways: `(x, y)` corners and doors by which people walk around walls.
        exits: `(x, y)` where people come and go; around the disc by default.
        spots: cameras of the scene's own instead of a ring.
        conditions: camera index to what is special about it.
    """

    summary: str
    people: int
    area_m: float
    habits: Habits
    radius_m: float = 4.2
    height_m: float = 2.0
    cameras: int = 5
    fps: float = 25.0
    seats: tuple[tuple[float, float, float], ...] = ()
    upright: bool = False
    beds: tuple[tuple[float, float, float], ...] = ()
    statures_m: tuple[float, float] | None = None
    platforms: tuple[tuple[Room, float], ...] = ()
    detector: DetectorSettings = field(default_factory=DetectorSettings)
    occluders: tuple[Occluder, ...] = ()
    walls: tuple[Box, ...] = ()
    rooms: tuple[Room, ...] = ()
    ways: tuple[tuple[float, float], ...] = ()
    exits: tuple[tuple[float, float], ...] = ()
    spots: tuple[Spot, ...] = ()
    conditions: Mapping[int, Condition] = field(default_factory=dict)

    @property
    def things(self) -> tuple[Occluder, ...]:
        """All obstacles that people walk around."""
        return (*self.occluders, *self.walls)

    def floor_m(self, xy_m: Floats) -> Floats:
        """Return the height of the floor `(*batch)` at `(*batch, 2)`; edges are a step wide."""
        height = np.zeros(xy_m.shape[:-1])
        for room, raised_m in self.platforms:
            x, y = xy_m[..., 0], xy_m[..., 1]
            within = np.minimum(
                np.minimum(x - room.low_x_m, room.high_x_m - x),
                np.minimum(y - room.low_y_m, room.high_y_m - y),
            )
            height = np.maximum(height, raised_m * np.clip(0.5 + within / STEP_M, 0.0, 1.0))
        return height

    def fitted(self, area_m: float) -> Scene:
        """Return the scene for a floor of another radius; seats move along, things stay.

        Things keep their place and size: they belong to a room, not to a rig.
        """
        factor = area_m / self.area_m
        seats = tuple((x * factor, y * factor, heading) for x, y, heading in self.seats)
        return replace(self, area_m=area_m, seats=seats)
