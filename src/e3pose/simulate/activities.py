"""Activities and paths of a group of people over time.

Each person lives a small script, drawn at random from the scene's habits: walk there, stand and
gesture, take a seat, leave through a door and come back.

People avoid collisions, one short time step at a time: they head for where they want to go, foresee
who or what they would pass too closely within the next seconds and give way sideways, and never
close in on anything that is already at arm's length.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.simulate.episodes import BLEND_S, EPISODES, FALLS, ON_BED, Episode, plan_episode
from e3pose.simulate.gestures import CALM, GESTURES, RAMP_S, Gesturing
from e3pose.simulate.occluders import Occluder
from e3pose.simulate.place import Scene

CLEARANCE_M = 0.3  # a body's half width and a little
STEP_M = 0.1
ENDS_M = 0.35  # people may start and stop nearer to a wall than they walk along it

PERSON_RADIUS_M = 0.27  # two people pass with the middles of their bodies 0.54 m apart at the least
SEAT_RADIUS_M = 0.34
MARGIN_M = 0.12  # people plan to pass with this much more than they need
FORESIGHT_S = 2.2
GIVE_WAY_MPS2 = 4.0
RESPONSE_S = 0.45
MAX_ACCELERATION_MPS2 = 3.0
MAX_SPEED_MPS = 1.9
PUSH_PER_S = 3.0  # speed of backing off per metre of overlap
TURN_RATE = 2.0  # radians per second at most
TURN_RESPONSE_S = 0.3
TURN_ACCELERATION = 9.0
NOWHERE = 1e6  # where people who are away wait


class Ways:
    """The shortest paths of a scene along its corners and doors.

    Args:
        corners: `(num_corners, 2)` metres, where people turn; none for straight lines everywhere.
        things: what stands in the way.
    """

    def __init__(self, corners: Floats, things: Sequence[Occluder]) -> None:
        self.corners = corners
        self.things = things
        number = len(corners)
        self.lengths = np.full((number, number), np.inf)
        for first in range(number):
            for second in range(first, number):
                if self.clear(corners[first], corners[second]):
                    length = float(np.hypot(*(corners[first] - corners[second])))
                    self.lengths[first, second] = self.lengths[second, first] = length
        # Floyd and Warshall; `onward[a, b]` is where to turn next on the way from a to b.
        self.onward = np.tile(np.arange(number), (number, 1))
        for middle in range(number):
            around = self.lengths[:, middle, None] + self.lengths[None, middle]
            shorter = around < self.lengths - 1e-9
            self.lengths = np.where(shorter, around, self.lengths)
            self.onward = np.where(shorter, self.onward[:, middle, None], self.onward)

    def clear(self, start: Floats, end: Floats) -> bool:
        """Return whether somebody can walk straight from `(2,)` to `(2,)` metres."""
        length = float(np.hypot(*(end - start)))
        along = np.arange(min(ENDS_M, length / 2), max(length - ENDS_M, length / 2) + 1e-9, STEP_M)
        points = start + np.outer(along / max(length, 1e-9), end - start)
        return all(
            bool((np.linalg.norm(thing.nearest(points) - points, axis=1) >= CLEARANCE_M).all())
            for thing in self.things
        )

    def route(self, start: Floats, goal: Floats) -> list[Floats]:
        """Return the points `(2,)` to head for one after another; the last is the goal.

        Without corners, or where no way is known, it is the goal alone.
        """
        if len(self.corners) == 0 or self.clear(start, goal):
            return [goal]
        near = [i for i, corner in enumerate(self.corners) if self.clear(start, corner)]
        far = [i for i, corner in enumerate(self.corners) if self.clear(corner, goal)]
        lengths = {
            (first, last): float(
                np.hypot(*(self.corners[first] - start))
                + self.lengths[first, last]
                + np.hypot(*(goal - self.corners[last]))
            )
            for first in near
            for last in far
        }
        if not lengths or min(lengths.values()) == np.inf:
            return [goal]
        here, last = min(lengths, key=lambda pair: lengths[pair])
        points = [self.corners[here]]
        while here != last:
            here = int(self.onward[here, last])
            points.append(self.corners[here])
        return [*points, goal]


GRID_HZ = 50.0  # lives do not depend on the frame rate of the recording
SIT_S = 1.7  # time to sit down, and to get up
SEAT_FRONT_M = 0.42  # people turn and sit down so far before the middle of the seat
ARRIVED_M = 0.06
PASSED_M = 0.35  # near enough for somebody who walks on
ROOM_M = 0.75  # places to stand are so far from other people
DOOR_FACTOR = 1.9  # doors are so many times the radius of the area away
PATIENCE_S = 5.0
NUM_EXITS = 3
CORNER_M = 0.5  # near enough to a corner or door to turn for the next
INSET_M = 0.55  # places to stand are so far from the edge of a room


@dataclass(slots=True)
class Life:
    """One person over the grid.

    Attributes:
        xy: `(num_times, 2)` metres.
        heading: `(num_times,)` radians.
        present: `(num_times,)` whether the person is in the scene.
        seated: `(num_times,)` 0 standing to 1 seated.
        gestures: what the arms do.
        episodes: falls and the like.
    """

    xy: Floats
    heading: Floats
    present: NDArray[np.bool_]
    seated: Floats
    gestures: list[Gesturing] = field(default_factory=list)
    episodes: list[Episode] = field(default_factory=list)


@dataclass(slots=True)
class _Task:
    """The task of a person: `kind` is walk, face, wait, sit or away."""

    kind: str
    until_s: float
    then: list[tuple[str, float]] = field(default_factory=list)


class Play:
    """A scene with its people, played on a grid of `GRID_HZ`."""

    def __init__(self, scene: Scene, number: int, rng: np.random.Generator) -> None:
        self.scene = scene
        self.rng = rng
        self.group = Group.of(number)
        self.seats = np.array(scene.seats, dtype=np.float64).reshape(-1, 3)
        angles = 2 * np.pi * (np.arange(NUM_EXITS) + rng.uniform()) / NUM_EXITS
        self.exits = DOOR_FACTOR * scene.area_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        if scene.exits:
            self.exits = np.array(scene.exits)
        self.ways = Ways(np.array(scene.ways).reshape(-1, 2), scene.things)
        self.routes: list[list[Floats]] = [[] for _ in range(number)]  # corners still to turn at
        self.stops = [True] * number  # whether people stop where they are going
        self.tasks = [_Task("away", 0.0) for _ in range(number)]

    def run(self, seconds: float, progress: Callable[[float], None]) -> tuple[Floats, list[Life]]:
        """Play; return the grid `(num_times,)` in seconds and everybody's life."""
        number = len(self.tasks)
        times = np.arange(int(np.ceil(seconds * GRID_HZ)) + 2) / GRID_HZ
        xy, heading = np.empty((len(times), number, 2)), np.empty((len(times), number))
        present = np.zeros((len(times), number), dtype=bool)
        self.lives = [
            Life(xy[:, i], heading[:, i], present[:, i], np.zeros(len(times)))
            for i in range(number)
        ]
        self.times = times
        self._begin()
        for index, time_s in enumerate(times):
            for person, task in enumerate(self.tasks):
                group = self.group
                if (
                    self.routes[person]
                    and np.hypot(*(group.goal[person] - group.xy[person])) < CORNER_M
                ):
                    self._head_on(person)
                if self._finished(person, task, float(time_s)):
                    self.tasks[person] = self._next(person, task, float(time_s))
            xy[index], heading[index] = self.group.xy, self.group.heading
            present[index] = [task.kind != "away" for task in self.tasks]
            if number:
                advance(self.group, self._seat_xy(), self.scene.things, 1 / GRID_HZ)
            if index % 250 == 0:
                progress(index / len(times))
        return times, self.lives

    def _begin(self) -> None:
        """Most people are there from the start; if people come and go, some arrive later."""
        settled = self.scene.habits.settled
        places = self.rng.permutation(len(self.seats)).tolist() if settled else []
        for person in range(len(self.tasks)):
            if person < len(places):
                seat = places[person]  # where the person has been for long
                self.group.own_seat[person] = seat
                self.group.xy[person] = self._front(seat)
                self.group.heading[person] = self.seats[seat, 2]
                duration = float(self.rng.uniform(*self._stay_s()))
                if self.scene.upright:
                    self._gestures(person, -RAMP_S, duration + RAMP_S, tuple(GESTURES))
                else:
                    self._sit(person, -SIT_S, duration + SIT_S)
                self.tasks[person] = _Task("wait", duration)
                continue
            later = self.scene.habits.leave > 0 and person % 4 == 3
            place = None if later else self._free_place(person, ROOM_M)
            if place is None:
                self.tasks[person] = _Task("away", float(self.rng.uniform(1, 10)))
            else:
                self.group.xy[person] = place
                self.group.heading[person] = self.rng.uniform(-np.pi, np.pi)
                self.tasks[person] = _Task("wait", float(self.rng.uniform(0, 1.5)))

    def _stay_s(self) -> tuple[float, float]:
        habits = self.scene.habits
        return habits.stand_s if self.scene.upright else habits.sit_s

    def _front(self, seat: int) -> Floats:
        """Return where people stand before they sit down, or all the time."""
        x, y, heading = self.seats[seat]
        before = 0.0 if self.scene.upright else SEAT_FRONT_M
        return np.array([x, y]) + before * np.array([np.cos(heading), np.sin(heading)])

    def _finished(self, person: int, task: _Task, time_s: float) -> bool:
        if time_s >= task.until_s:
            return True
        group = self.group
        if task.kind == "walk" and not self.routes[person]:
            near = ARRIVED_M if group.stops[person] else PASSED_M
            return bool(np.hypot(*(group.goal[person] - group.xy[person])) < near)
        if task.kind == "face":
            error = (group.facing[person] - group.heading[person] + np.pi) % (2 * np.pi) - np.pi
            return bool(abs(error) < 0.06 and abs(group.turning[person]) < 0.1)
        return False

    def _next(self, person: int, task: _Task, time_s: float) -> _Task:
        """Choose what follows a finished task."""
        group, rng = self.group, self.rng
        group.pace[person] = 0.0
        if task.kind == "away":
            # Come in through a door that nobody stands in, or wait a moment longer.
            door = self.exits[self.rng.integers(len(self.exits))]
            if np.hypot(*(self.group.xy - door).T).min() < 4 * PERSON_RADIUS_M:
                return _Task("away", time_s + 0.5)
            self.group.xy[person] = door
            self.group.heading[person] = np.arctan2(-door[1], -door[0])
            self.group.turning[person] = 0.0
            return self._wander(person, time_s)
        if task.kind == "walk" and task.then:
            late = time_s >= task.until_s
            if task.then[0][0] == "away":
                if late:
                    return self._wander(person, time_s)
                self.group.xy[person] = NOWHERE * (1 + person)
                self.routes[person] = []
                self.group.velocity[person] = 0.0
                return _Task("away", time_s + float(self.rng.uniform(3, 10)))
            if task.then[0][0] in EPISODES and not late:  # in the middle of walking
                return self._do(person, time_s, *task.then[0])
            if late:  # somebody was in the way
                group.own_seat[person] = -1
                return self._wander(person, time_s)
            group.facing[person] = task.then[0][1]
            return _Task("face", time_s + PATIENCE_S, task.then[1:])
        if task.kind == "face" and task.then:
            kind, duration = task.then[0]
            if kind in EPISODES:
                return self._do(person, time_s, kind, duration)
            if kind == "sit":
                self._sit(person, time_s, duration)
            elif rng.uniform() < 0.7:
                self._gestures(person, time_s, duration, tuple(GESTURES))
            return _Task("wait", time_s + duration)
        group.own_seat[person] = -1
        return self._choose(person, time_s)

    def _choose(self, person: int, time_s: float) -> _Task:
        habits, rng = self.scene.habits, self.rng
        draw = rng.uniform()
        if draw < habits.leave:
            door = self.exits[rng.integers(len(self.exits))]
            return self._walk(person, time_s, door, [("away", 0.0)], stops=False)
        draw -= habits.leave
        if draw < habits.do:
            return self._go_and_do(person, time_s)
        draw -= habits.do
        free = sorted(set(range(len(self.seats))) - set(self.group.own_seat.tolist()))
        if draw < habits.sit and free:
            seat = int(rng.choice(free))
            self.group.own_seat[person] = seat
            heading = float(self.seats[seat, 2])
            duration = float(rng.uniform(*self._stay_s())) + 2 * SIT_S
            then = [("face", heading), ("stand" if self.scene.upright else "sit", duration)]
            return self._walk(person, time_s, self._front(seat), then, stops=True)
        place = self._free_place(person, ROOM_M) if draw < habits.sit + habits.stand else None
        if place is not None:
            # People who stop look roughly to the middle, where the others are.
            facing = np.arctan2(*(self._middle(place) - place)[::-1]) + rng.normal(0, 0.6)
            duration = float(rng.uniform(*habits.stand_s))
            then = [("face", float(facing)), ("stand", duration)]
            return self._walk(person, time_s, place, then, stops=True)
        return self._wander(person, time_s)

    def _go_and_do(self, person: int, time_s: float) -> _Task:
        """Walk to a place, or to a bed, and do one of the habits' episodes there."""
        habits, rng, beds = self.scene.habits, self.rng, self.scene.beds
        kind = str(rng.choice(habits.does))
        stays_s = float(rng.uniform(*habits.lies_s))
        if kind in ON_BED:
            x, y, heading = beds[int(rng.integers(len(beds)))]
            place, facing = np.array([x, y]), heading
        else:
            free = self._free_place(person, ROOM_M)
            if free is None:
                return self._wander(person, time_s)
            place, facing = free, float(rng.uniform(-np.pi, np.pi))
        if kind in FALLS and kind not in ON_BED and rng.uniform() < 0.5:
            return self._walk(person, time_s, place, [(kind, stays_s)], stops=False)
        return self._walk(person, time_s, place, [("face", facing), (kind, stays_s)], stops=True)

    def _do(self, person: int, time_s: float, kind: str, stays_s: float) -> _Task:
        episode = plan_episode(kind, time_s, self.rng, stays_s)
        self.lives[person].episodes.append(episode)
        return _Task("wait", episode.stop_s + BLEND_S)

    def _wander(self, person: int, time_s: float) -> _Task:
        """Walk somewhere and on from there without a stop."""
        here = self.group.xy[person]
        if self.scene.habits.cross:
            angle = np.arctan2(here[1], here[0]) + np.pi + self.rng.normal(0, 0.35)
            place = 0.95 * self.scene.area_m * np.array([np.cos(angle), np.sin(angle)])
        elif self.scene.rooms:  # people stay in a room as often as they change it
            place = self._place()
        else:
            places = [self._place() for _ in range(4)]
            place = max(places, key=lambda p: float(np.hypot(*(p - here))))
        return self._walk(person, time_s, place, [], stops=False)

    def _walk(
        self,
        person: int,
        time_s: float,
        goal: Floats,
        then: list[tuple[str, float]],
        stops: bool,
    ) -> _Task:
        group = self.group
        self.routes[person] = self.ways.route(group.xy[person], goal)
        self.stops[person] = stops
        way = np.diff([group.xy[person], *self.routes[person]], axis=0)
        self._head_on(person)
        group.pace[person] = self.rng.uniform(*self.scene.habits.speed_mps)
        group.facing[person] = np.nan
        way_s = float(np.hypot(way[:, 0], way[:, 1]).sum() / group.pace[person])
        return _Task("walk", time_s + 1.6 * way_s + PATIENCE_S, then)

    def _head_on(self, person: int) -> None:
        """Head for the next corner of the way, or for its end."""
        self.group.goal[person] = self.routes[person].pop(0)
        self.group.stops[person] = self.stops[person] and not self.routes[person]

    def _sit(self, person: int, time_s: float, duration: float) -> None:
        """Sit down now and be up again after `duration` seconds, with a calm gesture in between."""
        down = np.clip((self.times - time_s) / SIT_S, 0, 1)
        up = np.clip((time_s + duration - self.times) / SIT_S, 0, 1)
        seated = np.minimum(down, up)
        life = self.lives[person]
        life.seated = np.maximum(life.seated, seated)
        if self.rng.uniform() < 0.8:
            self._gestures(person, time_s + SIT_S, duration - 2 * SIT_S, CALM)

    def _gestures(
        self, person: int, start_s: float, duration: float, names: tuple[str, ...]
    ) -> None:
        """Fill a stop or a time on a seat with gestures and rests in between."""
        names = self.scene.habits.held or names
        end_s = start_s + duration
        while end_s - start_s > 2 * RAMP_S:
            name = names[int(self.rng.integers(len(names)))]
            stop_s = min(end_s, start_s + float(self.rng.uniform(*self.scene.habits.held_s)))
            left = bool(self.rng.uniform() < 0.4)
            self.lives[person].gestures.append(Gesturing(name, start_s, stop_s, left))
            start_s = stop_s + float(self.rng.uniform(0, 4))

    def _place(self) -> Floats:
        """Return a floor point inside the area that is clear of seats and occluders."""
        place = np.zeros(2)
        for _ in range(50):
            place = self._anywhere()
            things = [thing.nearest(place) for thing in self.scene.things] + list(self._seat_xy())
            if all(np.hypot(*(thing - place)) > 2.2 * PERSON_RADIUS_M for thing in things):
                break
        return place

    def _anywhere(self) -> Floats:
        rooms, rng = self.scene.rooms, self.rng
        if not rooms:
            angle, radius = rng.uniform(-np.pi, np.pi), np.sqrt(rng.uniform())
            return np.asarray(self.scene.area_m * radius * np.array([np.cos(angle), np.sin(angle)]))
        sizes = np.array([room.area_m2 for room in rooms])
        room = rooms[int(rng.choice(len(rooms), p=sizes / sizes.sum()))]
        x = rng.uniform(room.low_x_m + INSET_M, room.high_x_m - INSET_M)
        y = rng.uniform(room.low_y_m + INSET_M, room.high_y_m - INSET_M)
        return np.array([x, y])

    def _middle(self, place: Floats) -> Floats:
        """Return the middle of the room, or of the scene, that a place is in."""
        if not self.scene.rooms:
            return np.zeros(2)
        middles = np.array([room.middle for room in self.scene.rooms])
        return np.asarray(middles[np.hypot(*(middles - place).T).argmin()])

    def _free_place(self, person: int, room_m: float) -> Floats | None:
        """Return a place away from other people and their goals, or None if it is too full."""
        others = np.arange(len(self.tasks)) != person
        goals = np.array(
            [route[-1] if route else self.group.goal[i] for i, route in enumerate(self.routes)]
        )
        taken = np.concatenate([self.group.xy[others], goals[others]])
        for _ in range(30):
            place = self._place()
            if len(taken) == 0 or np.hypot(*(taken - place).T).min() > room_m:
                return place
        return None

    def _seat_xy(self) -> Floats:
        return self.seats[:, :2]


@dataclass(slots=True)
class Group:
    """Everybody's state; the arrays change as time goes by.

    Attributes:
        xy: `(num_people, 2)` metres.
        velocity: `(num_people, 2)` metres per second.
        heading: `(num_people,)` radians.
        turning: `(num_people,)` radians per second.
        goal: `(num_people, 2)` metres.
        pace: `(num_people,)` wanted speed; 0 stands still.
        facing: `(num_people,)` desired heading of a standing person, NaN for any.
        stops: `(num_people,)` whether they slow down at the goal.
        own_seat: `(num_people,)` the seat that is no obstacle to them, -1 for none.
    """

    xy: Floats
    velocity: Floats
    heading: Floats
    turning: Floats
    goal: Floats
    pace: Floats
    facing: Floats
    stops: NDArray[np.bool_]
    own_seat: NDArray[np.int64]

    @classmethod
    def of(cls, number: int) -> Group:
        """Return `number` people, all of them nowhere."""
        nowhere = NOWHERE * (1 + np.arange(number, dtype=np.float64))
        xy = np.repeat(nowhere[:, None], 2, axis=1)
        flat = np.zeros(number)
        return cls(
            xy, np.zeros((number, 2)), flat.copy(), flat.copy(), xy.copy(), flat.copy(),
            np.full(number, np.nan), np.ones(number, dtype=bool), np.full(number, -1),
        )  # fmt: skip


def advance(
    group: Group, seats_xy: Floats, occluders: Sequence[Occluder], interval_s: float
) -> None:
    """Let a short time pass: everybody turns, speeds up or gives way, and moves."""
    walking = group.pace > 0
    if not walking.any() and not group.velocity.any():
        _turn(group, walking, group.velocity, interval_s)
        return
    to_goal = group.goal - group.xy
    distance = np.maximum(np.hypot(to_goal[:, 0], to_goal[:, 1]), 1e-9)
    pace = np.where(group.stops, np.minimum(group.pace, 1.3 * distance + 0.05), group.pace)
    direction = to_goal / distance[:, None]
    error = _turn(group, walking & (distance > 0.15), direction, interval_s)
    # Nobody walks backwards: far off course, people first turn on the spot.
    pace = np.where(walking, pace * np.minimum(np.maximum(1.25 * np.cos(error), 0.0), 1.0), 0.0)
    acceleration = (direction * pace[:, None] - group.velocity) / RESPONSE_S
    others = _neighbours(group, seats_xy, occluders)
    acceleration += walking[:, None] * _give_way(group.velocity, *others)
    size = np.maximum(np.hypot(acceleration[:, 0], acceleration[:, 1]), 1e-9)
    acceleration *= np.minimum(1.0, MAX_ACCELERATION_MPS2 / size)[:, None]
    velocity = group.velocity + acceleration * interval_s
    speed = np.maximum(np.hypot(velocity[:, 0], velocity[:, 1]), 1e-9)
    velocity *= np.minimum(1.0, MAX_SPEED_MPS / speed)[:, None]
    velocity[(~walking) & (speed < 0.05)] = 0.0
    velocity = _keep_apart(velocity, walking, *others)
    group.velocity = velocity
    group.xy = group.xy + velocity * interval_s


def _turn(group: Group, walking: NDArray[np.bool_], direction: Floats, interval_s: float) -> Floats:
    """Turn everybody towards where they go or want to face; return the error left in radians."""
    moving = np.hypot(group.velocity[:, 0], group.velocity[:, 1]) > 0.4
    ahead = np.where(moving[:, None], group.velocity, direction)
    wanted = np.arctan2(ahead[:, 1], ahead[:, 0])
    asked = ~walking & np.isfinite(group.facing)
    wanted = np.where(asked, group.facing, wanted)
    error = np.where(walking | asked, _wrapped(wanted - group.heading), 0.0)
    rate = np.minimum(np.maximum(error / TURN_RESPONSE_S, -TURN_RATE), TURN_RATE)
    change = TURN_ACCELERATION * interval_s
    group.turning = group.turning + np.minimum(np.maximum(rate - group.turning, -change), change)
    group.heading = group.heading + group.turning * interval_s
    course = np.arctan2(direction[:, 1], direction[:, 0]) - group.heading
    return np.where(walking & ~moving, _wrapped(course), 0.0)


def _neighbours(
    group: Group, seats_xy: Floats, occluders: Sequence[Occluder]
) -> tuple[Floats, Floats, Floats]:
    """Return offsets `(num_people, num_others, 2)`, velocities `(num_others, 2)` and clearances."""
    number, fixed = len(group.xy), len(group.xy) + len(seats_xy)
    offset = np.empty((number, fixed + len(occluders), 2))
    np.subtract(np.concatenate([group.xy, seats_xy]), group.xy[:, None], out=offset[:, :fixed])
    for index, occluder in enumerate(occluders, fixed):
        offset[:, index] = occluder.nearest(group.xy) - group.xy
    velocity = np.zeros(offset.shape[1:])
    velocity[:number] = group.velocity
    clearance = np.full(offset.shape[:2], PERSON_RADIUS_M)
    clearance[:, :number] = 2 * PERSON_RADIUS_M
    clearance[:, number:fixed] = PERSON_RADIUS_M + SEAT_RADIUS_M
    people = np.arange(number)
    clearance[people, people] = -1.0
    seated = group.own_seat >= 0
    clearance[people[seated], number + group.own_seat[seated]] = -1.0
    return offset, velocity, clearance


def _give_way(velocity: Floats, offset: Floats, other: Floats, clearance: Floats) -> Floats:
    """Return the acceleration `(num_people, 2)` sideways that avoids passing too closely."""
    closing = velocity[:, None] - other
    squared, ahead = closing * closing, offset * closing
    rate = np.maximum(squared[..., 0] + squared[..., 1], 1e-6)
    when = np.minimum(np.maximum((ahead[..., 0] + ahead[..., 1]) / rate, 0.0), FORESIGHT_S)
    miss = offset - closing * when[..., None]
    gap = np.hypot(miss[..., 0], miss[..., 1])
    urgency = np.minimum(np.maximum(1 - gap / (clearance + MARGIN_M), 0.0), 1.0)
    urgency *= (when > 0) & (clearance > 0)
    if not urgency.any():
        return np.zeros_like(velocity)
    urgency *= np.exp(-when / 1.2)
    away = -miss / np.maximum(gap, 1e-9)[..., None]
    # Head-on, both step to their right.
    right = np.stack([closing[..., 1], -closing[..., 0]], axis=-1) / np.sqrt(rate)[..., None]
    away = np.where((gap < 0.05)[..., None], right, away)
    return np.asarray(GIVE_WAY_MPS2 * (away * urgency[..., None]).sum(axis=1))


def _keep_apart(
    velocity: Floats,
    walking: NDArray[np.bool_],
    offset: Floats,
    other: Floats,
    clearance: Floats,
) -> Floats:
    """Return velocities without the part that closes in on near things."""
    distance = np.hypot(offset[..., 0], offset[..., 1])
    near = walking[:, None] & (distance < clearance + 0.10)
    if not near.any():
        return velocity
    velocity = velocity.copy()
    for person, thing in np.argwhere(near):
        towards = offset[person, thing] / max(float(distance[person, thing]), 1e-9)
        share = 0.5 if thing < len(walking) and walking[thing] else 1.0
        closing = float((velocity[person] - other[thing]) @ towards)
        gap = float(distance[person, thing] - clearance[person, thing])
        allowed = PUSH_PER_S * gap  # slow down with the distance left; back off when overlapping
        if closing > allowed:
            velocity[person] -= share * (closing - allowed) * towards
    return velocity


def _wrapped(angle: Floats) -> Floats:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
