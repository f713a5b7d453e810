"""The people of a slot with the memory of each: states, stature, trail of the hips."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.events.body import SHANKS, SPEED, USUAL, Joints, Stature, figures, middle, stature_after
from e3pose.events.states import (
    LYING,
    NOT_KNOWN,
    STATES,
    UNKNOWN,
    advance,
    low_of,
    states_of,
)
from e3pose.model.people import People
from e3pose.model.region import distance_m, in_polygon, middles_m
from e3pose.settings.site_file import ZoneTable

FAST_S, SLOW_S = 0.1, 0.4  # time constants of two means of the place, whose difference is a speed
SPEED_SPREAD = 0.2  # m/s
TRAIL_S = 6.0  # so long the height of the hips is remembered
LOST_S = 4.0  # a person who is not shown for longer is gone
YOUNG_S = 1.0  # a track that is younger may be a person whom another track still shows
KIN_M = 1.5  # a new track this near to where somebody was lost may be that person
NEAR_M = 1.5  # an event this near to a zone is told with its name
LONGEST_STEP_S = 1.0
BESIDE_M = 0.2  # hips so far below a surface are not on it
Trail = tuple[tuple[int, float, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The people of a slot as they were published.

    Attributes:
        slot: its number.
        time_ns: nanoseconds since 1970.
        people: in it.
    """

    slot: int
    time_ns: int
    people: People


@dataclass(frozen=True, slots=True, eq=False)
class Person:
    """The memory of a person.

    Attributes:
        track: identity.
        since_ns: first seen.
        seen_ns: last seen.
        stature: mean and precision of its logarithm, by the limbs.
        share: `(num_prototypes + 1,)` probabilities, see `events.states`.
        states: `(num_states,)` probabilities of `events.states.STATES`.
        on_floor: probability that the person lies or sits on the floor itself.
        place_m: `(2,)` on the floor.
        surface_m: height of the bed or seat that the person is over; 0 on the floor.
        near: name of the zone that is nearest, if one is near.
        trail: of the last seconds: time_ns, height of the hips over the floor / stature, and
            inclination of the shanks in degrees, NaN where unknown.
        joints_m: `(num_joints, 3)` as last seen.
        fast_m, slow_m: `(2,)` means of the place.
        was: identity in the slot before: another one where the person was lost and found.
        first: identity that the person had first.
    """

    track: int
    since_ns: int
    seen_ns: int
    stature: tuple[float, float]
    share: Floats
    place_m: Floats
    states: Floats = field(default_factory=lambda: np.eye(len(STATES))[UNKNOWN])
    on_floor: float = 0.0
    surface_m: float = 0.0
    near: str = ""
    trail: Trail = ()
    joints_m: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    fast_m: Floats = field(default_factory=lambda: np.full(2, np.nan))
    slow_m: Floats = field(default_factory=lambda: np.full(2, np.nan))
    was: int = -1
    first: int = -1

    @property
    def lies(self) -> float:
        """Probability that the person lies."""
        return float(self.states[LYING])

    @property
    def speed_mps(self) -> float:
        """Speed over the floor, metres per second; NaN in the first slot."""
        return float(np.linalg.norm(self.fast_m - self.slow_m) / (SLOW_S - FAST_S))


Persons = Mapping[int, Person]  # by track


def follow(
    people: Persons, seen: Seen, joints: Joints, zones: Sequence[ZoneTable]
) -> tuple[Persons, Persons]:
    """Return everybody who is remembered after a slot, and who of them is shown in it.

    Args:
        people: who was remembered before.
        seen: the newest slot.
        joints: of the skeleton.
        zones: of the site.
    """
    places_m = middles_m(seen.people.joints_m)
    inside, near = _zones_of(places_m, zones)
    tracks = seen.people.track_ids.tolist()
    before = [_known(people, track, seen, places_m[row]) for row, track in enumerate(tracks)]
    now = dict(
        zip(tracks, _followed(before, seen, joints, places_m, zones, inside, near), strict=True)
    )
    gone = {
        track: person
        for track, person in people.items()
        if track not in now and seen.time_ns - person.seen_ns < LOST_S * 1e9
    }
    return {**gone, **now}, now


def heirs_in(shown: Persons) -> dict[int, int]:
    """Return the identity that people had before, by the one that they have now; those changed."""
    return {track: person.was for track, person in shown.items() if person.was not in (-1, track)}


def _zones_of(
    places_m: Floats, zones: Sequence[ZoneTable]
) -> tuple[list[tuple[int, ...]], list[str]]:
    """Return the zones that each person is in, by index, and the name of a near one."""
    inside: list[tuple[int, ...]] = [()] * len(places_m)
    near, nearest_m = [""] * len(places_m), np.full(len(places_m), NEAR_M)
    for index, zone in enumerate(zones):
        corners_m = np.array(zone.corners, dtype=np.float64)
        within = in_polygon(places_m, corners_m)
        away_m = np.where(within, 0.0, distance_m(places_m, corners_m))
        for row in range(len(places_m)):
            if within[row]:
                inside[row] = (*inside[row], index)
            if away_m[row] < nearest_m[row]:
                near[row], nearest_m[row] = zone.name, away_m[row]
    return inside, near


def _known(people: Persons, track: int, seen: Seen, place_m: Floats) -> Person:
    """Return the memory of somebody who is shown now.

    Somebody who falls may get a new identity before the one that they had is lost.
    """
    person = people.get(track)
    if person is None:
        new = Person(track, seen.time_ns, seen.time_ns, USUAL, NOT_KNOWN, place_m)
        return _kin(people, seen, place_m) or new
    if seen.time_ns - person.since_ns > YOUNG_S * 1e9:
        return person
    kin = _kin(people, seen, place_m, person.since_ns)
    if kin is None:
        return person
    later = tuple(point for point in person.trail if point[0] > kin.seen_ns)
    return replace(
        person, track=kin.track, first=kin.first, since_ns=kin.since_ns, stature=kin.stature,
        trail=(*kin.trail, *later),
    )  # fmt: skip


def _kin(
    people: Persons, seen: Seen, place_m: Floats, since_ns: int | None = None
) -> Person | None:
    """Return whoever was lost near a new track, and may have got a new identity there.

    Of those who were lost at about the same time, the one who was known for longest.

    Args:
        people: who was remembered before.
        seen: the newest slot.
        place_m: `(2,)` of the new track.
        since_ns: when it was shown first, where that was earlier: a person shown then is none who
            was lost before, and was known before.
    """
    shown = set(seen.people.track_ids.tolist())
    lost = [
        person
        for person in people.values()
        if person.track not in shown
        and np.linalg.norm(person.place_m - place_m) < KIN_M
        and (since_ns is None or person.since_ns < since_ns <= person.seen_ns)
    ]
    newest_ns = max((person.seen_ns for person in lost), default=0)
    last = [person for person in lost if newest_ns - person.seen_ns < YOUNG_S * 1e9]
    return min(last, key=lambda person: (person.since_ns, -person.seen_ns), default=None)


def _followed(
    before: Sequence[Person],
    seen: Seen,
    joints: Joints,
    places_m: Floats,
    zones: Sequence[ZoneTable],
    inside: Sequence[tuple[int, ...]],
    near: Sequence[str],
) -> Iterator[Person]:
    """Yield the memory of each person after a slot that shows them."""
    if not before:
        return
    joints_m = np.asarray(seen.people.joints_m, dtype=np.float64)
    sigma_m = np.asarray(seen.people.sigma_m, dtype=np.float64)
    known = Stature(*np.array([person.stature for person in before]).T)
    stature = stature_after(known, joints, joints_m, sigma_m)
    hips_m, _ = middle(joints_m, sigma_m, joints.hips)
    surfaces = [max((zones[i].height_m for i in within), default=0.0) for within in inside]
    # Beside a bed, or below it, is not on it.
    surface_m = np.where(hips_m[:, 2] > np.array(surfaces) - BESIDE_M, surfaces, 0.0)
    value, spread = figures(joints, joints_m, sigma_m, stature.m, surface_m)
    passed_s = np.array([(seen.time_ns - person.seen_ns) / 1e9 for person in before])
    passed_s = np.clip(passed_s, 1e-3, LONGEST_STEP_S)
    where_m = np.where(np.isfinite(hips_m[:, :1]), hips_m[:, :2], places_m)
    fast_m = _mean(np.array([p.fast_m for p in before]), where_m, passed_s, FAST_S)
    slow_m = _mean(np.array([p.slow_m for p in before]), where_m, passed_s, SLOW_S)
    settled = np.array([seen.time_ns - person.since_ns > SLOW_S * 1e9 for person in before])
    speed = np.linalg.norm(fast_m - slow_m, axis=1) / (SLOW_S - FAST_S)
    value[:, SPEED] = np.where(settled, speed, np.nan)
    spread[:, SPEED] = np.where(settled, SPEED_SPREAD, np.nan)
    share = advance(np.array([person.share for person in before]), value, spread, passed_s)
    states, low = states_of(share, value), np.where(surface_m > 0, 0.0, low_of(share))
    statures = stature.m
    for row, person in enumerate(before):
        yield Person(
            int(seen.people.track_ids[row]), person.since_ns, seen.time_ns,
            (float(stature.mean[row]), float(stature.precision[row])), share[row], places_m[row],
            states[row], float(low[row]), float(surface_m[row]),
            near[row],
            _trail(
                person.trail, seen.time_ns, float(hips_m[row, 2] / statures[row]),
                float(value[row, SHANKS]),
            ),
            joints_m[row], fast_m[row], slow_m[row], person.track,
            person.track if person.first < 0 else person.first,
        )  # fmt: skip


def _trail(before: Trail, time_ns: int, height: float, shanks_deg: float) -> Trail:
    """Return a trail with one more point, and without old ones."""
    if before and time_ns - before[0][0] > (TRAIL_S + 1) * 1e9:
        before = tuple(point for point in before if time_ns - point[0] <= TRAIL_S * 1e9)
    return before if np.isnan(height) else (*before, (time_ns, height, shanks_deg))


def _mean(before: Floats, value: Floats, passed_s: Floats, constant_s: float) -> Floats:
    """Return `(num_persons, 2)` means that forget with a time constant; NaN says nothing."""
    gain = (1 - np.exp(-passed_s / constant_s))[:, None]
    moved = before + gain * (value - before)
    return np.where(np.isfinite(before), np.where(np.isfinite(value), moved, before), value)
