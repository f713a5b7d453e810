"""Detect a displaced camera by comparing published people with its detections.

Every pair of a person and a 2D pose whose joints differ by a constant offset votes for that offset,
whether they are the same person or not. If the camera stands as calibrated, votes cluster around
zero; if it was turned, around one small rotation, which explains them over the whole image. Votes
of different people scatter. Raw detections are compared, so that the estimator's outlier rejection
hides no displaced camera. Views that are late, by a clock or a buffer, show people where they were:
that offset grows with their motion, and a delay is fitted beside the rotation. Where a delay could
explain the offset by itself, as of people who all walk one way, the camera counts as in its place.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.base.child_process import call_apart
from e3pose.base.errors import InputError
from e3pose.base.kernel import INTERPRETING
from e3pose.calibrate.people_3d import doubt_people
from e3pose.model.camera import Camera, Rig
from e3pose.model.noise import SURE_SCORE, Noise
from e3pose.model.people import People
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton
from e3pose.model.slot_record import SlotRecord
from e3pose.recording import Recording
from e3pose.recording.detections.views import series_from_frames

WINDOW_S = 20.0  # votes older than this are dropped
SPAN_S = 8.0  # of votes needed: people who stand still carry little information
MOST_VOTES = 300  # of a camera
MIN_VOTES = 30
MOST_TRIED = 60  # votes tried as cluster centres
MIN_JOINTS = 6
MOST_SIGMA_M = 0.1  # of joints that are compared
ALIKE = 0.1  # of a person's size: scatter of the joints' offsets in a vote
MOST_OFFSET = 0.25  # normalised: 14 degrees
NEAR = 0.012  # normalised: votes that agree, 0.7 degrees
MIN_SHARE = 0.4  # of the poses of a view whose votes the rotation must explain
ROLL_SIGMA = 0.03  # radians of roll, which people near the image centre determine badly
PARTS = 4  # of the window, in time, that must agree
# Cameras of simulated rigs that stand as calibrated seem turned by up to 0.1 degrees, those of
# a published calibration of a real room by up to 0.2.
MOVED_DEG = 0.25
LEAST_DEG = 0.12  # in each part of the window
LOOK_S = 0.2  # views of a camera in between are left out
ASK_S = 1.0
WORLD_S, WORLD_EVERY_S = 10.0, 600.0  # of views to compare the calibration with people
WORLD_LIMIT_S = 60.0  # for that
ASKED = 3  # checks in a row that must find the same camera before it is reported


@dataclass(frozen=True, slots=True, eq=False)
class Votes:
    """Recent votes by camera.

    Attributes:
        votes: by camera `(n, 8)`: seconds, number of the 2D pose, x, y, offset and motion of the
            person a second, normalised.
    """

    votes: tuple[Floats, ...]

    @classmethod
    def begin(cls, num_cameras: int) -> Votes:
        """Return a watch without votes."""
        return cls((np.zeros((0, 8)),) * num_cameras)


@dataclass(frozen=True, slots=True)
class Displacement:
    """A camera that does not stand as calibrated.

    Attributes:
        camera: its index.
        degrees: by how much it seems turned.
    """

    camera: int
    degrees: float


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """The view of a camera in a slot, and the people published for it.

    Attributes:
        time_s: of the slot, in the scene.
        view: the detections, pixels of the real image.
        people: as they were published.
    """

    time_s: float
    view: Poses2D
    people: People


def observe(watch: Votes, rig: Rig, observations: Mapping[int, Sequence[Observation]]) -> Votes:
    """Return the watch with the votes of some more slots.

    Args:
        watch: earlier votes.
        rig: the calibration to check.
        observations: by camera, oldest first.
    """
    votes = list(watch.votes)
    for index, seen in observations.items():
        kept = votes[index]
        kept = kept[kept[:, 0] > seen[-1].time_s - WINDOW_S]
        kept = np.concatenate([kept, _votes(rig.cameras[index], seen)])
        if len(kept) > MOST_VOTES:  # subsampled, so that a crowd does not shorten the window
            kept = kept[np.linspace(0, len(kept) - 1, MOST_VOTES).astype(int)]
        votes[index] = kept
    return Votes(tuple(votes))


def _votes(camera: Camera, observations: Sequence[Observation]) -> Floats:
    """Return `(n, 8)` votes (see `Votes`) of the matching people and poses of one slot."""
    (expected, motion), found = _expected(camera, observations), _found(camera, observations)
    people, poses = _pairs(observations)
    offsets = found[poses] - expected[people]  # (num_pairs, num_joints, 2)
    known = np.isfinite(offsets[..., 0]).sum(axis=-1) >= MIN_JOINTS
    if not known.any():
        return np.zeros((0, 8))
    offsets, poses, motion = offsets[known], poses[known], motion[people[known]]
    places = found[poses]
    middle = _medians(offsets)
    scatter = _medians(np.abs(offsets - middle[:, None]).max(axis=-1, keepdims=True))[:, 0]
    place = _medians(places)
    height = 2 * _medians(np.abs(places - place[:, None]).max(axis=-1, keepdims=True))[:, 0]
    alike = (scatter < ALIKE * height) & (np.linalg.norm(middle, axis=1) < MOST_OFFSET)
    counts = [len(observation.view) for observation in observations]
    numbers = np.concatenate([np.arange(count) for count in counts])
    times_s = np.repeat([observation.time_s for observation in observations], counts)
    votes = np.column_stack([times_s[poses], numbers[poses], place, middle, motion])
    return np.asarray(votes[alike])


def _expected(camera: Camera, observations: Sequence[Observation]) -> tuple[Floats, Floats]:
    """Return projections of accurate joints, normalised, and how people move in them a second.

    Returns:
        `(num_people, num_joints, 2)`, NaN where not accurate, and `(num_people, 2)`, 0 if unknown.
    """
    joints_m = np.concatenate([observation.people.joints_m for observation in observations])
    sigma_m = np.concatenate([observation.people.sigma_m for observation in observations])
    in_camera = joints_m @ camera.R.T + camera.t
    with np.errstate(invalid="ignore", divide="ignore"):
        clear = (in_camera[..., 2:] > 0.1) & (sigma_m < MOST_SIGMA_M)[..., None]
        expected = np.where(clear, in_camera[..., :2] / in_camera[..., 2:], np.nan)
        velocity = np.concatenate([_velocity_mps(each.people) for each in observations])
        velocity = velocity @ camera.R.T
        motion = (velocity[..., :2] - expected * velocity[..., 2:]) / in_camera[..., 2:]
    known = np.isfinite(motion)
    total = np.where(known, motion, 0.0).sum(axis=1)
    return expected, total / np.maximum(known.sum(axis=1), 1)


def _velocity_mps(people: People) -> Floats:
    return np.zeros_like(people.joints_m) if people.dynamics is None else people.dynamics[..., :3]


def _found(camera: Camera, observations: Sequence[Observation]) -> Floats:
    """Return `(num_poses, num_joints, 2)`: detections, normalised."""
    keypoints_px = np.concatenate([observation.view.keypoints_px for observation in observations])
    scores = np.concatenate([observation.view.scores for observation in observations])
    return camera.normalise(np.where((scores >= SURE_SCORE)[..., None], keypoints_px, np.nan))


def _pairs(observations: Sequence[Observation]) -> tuple[Integers, Integers]:
    """Return `(num_pairs,)` rows of people and of poses: all with all of the same slot."""
    people, poses = [], []
    first_person = first_pose = 0
    for observation in observations:
        num_poses = len(observation.view)
        person, pose = np.divmod(np.arange(len(observation.people) * num_poses), num_poses)
        people.append(first_person + person)
        poses.append(first_pose + pose)
        first_person, first_pose = (
            first_person + len(observation.people),
            first_pose + num_poses,
        )
    return np.concatenate(people), np.concatenate(poses)


def _medians(values: Floats) -> Floats:
    """Return lower medians over the second axis, without NaN, which all of a last axis are or none.

    NaN sorts last, so that no other array is needed.
    """
    known = np.isfinite(values[..., 0]).sum(axis=1)
    rows = np.maximum((known - 1) // 2, 0)
    return np.asarray(np.sort(values, axis=1)[np.arange(len(values)), rows])


def turned_deg(watch: Votes) -> tuple[Floats, Floats]:
    """Return `(num_cameras,)` degrees by which each camera seems turned, and lower bounds.

    NaN where too little is seen; the bound is the minimum over parts of the window, and 0 of a
    camera that is turned by no more than `MOVED_DEG`, or may be as its views may be late.
    """
    found = np.array([_turn(votes) for votes in watch.votes])
    return found[:, 0], found[:, 1]


def moved(degrees: Floats, least: Floats) -> Displacement | None:
    """Return the camera that is most clearly displaced, if one is.

    Only one at a time: a displaced camera shifts the estimated people, so that the other cameras
    seem turned too, by less.

    Args:
        degrees: as `turned_deg` returns them.
        least: likewise.
    """
    worst = int(np.nan_to_num(degrees).argmax())
    sure = degrees[worst] > MOVED_DEG and least[worst] > LEAST_DEG
    return Displacement(worst, float(degrees[worst])) if sure else None


def _turn(votes: Floats) -> tuple[float, float]:
    poses = len(set(map(tuple, votes[:, :2].tolist())))
    if poses < MIN_VOTES or votes[-1, 0] - votes[0, 0] < SPAN_S:  # oldest first
        return np.nan, np.nan
    offsets, slopes = votes[:, 4:6], _slopes(votes[:, 2:4], votes[:, 6:])
    tried = offsets[:: -(-len(offsets) // MOST_TRIED)]
    # Axis by axis: a last axis of two is ten times as slow.
    x, y = (tried[:, axis, None] - offsets[:, axis] for axis in range(2))
    middle = tried[(x**2 + y**2 < NEAR**2).sum(axis=1).argmax()]  # with most neighbours
    good = np.linalg.norm(offsets - middle, axis=1) < 2 * NEAR
    fit = np.zeros(4)
    for _ in range(4):
        fit, before = _fit(slopes[good], offsets[good]), good
        good = np.linalg.norm(offsets - slopes @ fit, axis=1) < 2 * NEAR
        if good.sum() < MIN_VOTES / 2:
            return np.nan, np.nan
        if (good == before).all():
            break
    if good.sum() < MIN_SHARE * poses:
        return np.nan, np.nan
    rotation = fit[:3]
    size = float(np.linalg.norm(rotation))
    # Where turns are hardly expected, a delay explains all that it can.
    unturned = _fit(slopes[good], offsets[good], np.radians(LEAST_DEG))[:3]
    least = min(size, float(np.linalg.norm(unturned)))
    if np.degrees(least) <= MOVED_DEG:
        return float(np.degrees(least)), 0.0
    parts = np.array_split(np.flatnonzero(good), PARTS)
    along = [float(_fit(slopes[part], offsets[part])[:3] @ rotation) / size for part in parts]
    return float(np.degrees(size)), float(np.degrees(min(along)))


def _slopes(places: Floats, motion: Floats) -> Floats:
    """Return `(n, 2, 4)`: derivatives of normalised places by a small rotation, and by time."""
    (x, y), (along_x, along_y) = places.T, motion.T
    return np.stack([
        np.stack([x * y, -(1 + x * x), y, along_x], axis=-1),
        np.stack([1 + y * y, -x * y, -x, along_y], axis=-1),
    ], axis=1)  # fmt: skip


def _fit(slopes: Floats, offsets: Floats, turn_sigma: float = np.inf) -> Floats:
    """Return the rotation in radians and the seconds `(4,)` that fit votes best.

    Args:
        slopes: of `_slopes`.
        offsets: `(n, 2)` normalised.
        turn_sigma: radians about each axis that are expected.
    """
    rows = slopes.reshape(-1, 4)
    expected = np.array([turn_sigma, turn_sigma, min(turn_sigma, ROLL_SIGMA), np.inf])
    normal = rows.T @ rows + np.diag((NEAR / expected) ** 2 + 1e-12)
    return np.asarray(np.linalg.solve(normal, rows.T @ offsets.reshape(-1)))


class WorldCheck:
    """Compares the scale and axes of a live edge with people, until they are found wrong."""

    def __init__(self, rig: Rig, skeleton: Skeleton, noise: Noise, file: Path) -> None:
        """Start without views.

        Args:
            rig: the calibration of the edge.
            skeleton: of the views.
            noise: what scores promise.
            file: the calibration, for the command that mends it.
        """
        self.rig, self.skeleton, self.noise, self.file = rig, skeleton, noise, file
        self.words = ""  # what is wrong
        self.reported = False
        self._begin_s = -np.inf
        self._views: list[dict[int, Poses2D]] = []
        self.thread = threading.Thread()

    def observe(self, time_s: float, views: Mapping[int, Poses2D]) -> None:
        """Add the views of a slot; ten seconds of each ten minutes are checked beside."""
        if self.words or time_s < self._begin_s or INTERPRETING.on:  # another process compiles
            return
        if not self._views:
            self._begin_s, self._views = time_s, [{} for _ in self.rig.cameras]
        slot = int((time_s - self._begin_s) / LOOK_S)
        if slot < WORLD_S / LOOK_S:
            for index, view in views.items():
                self._views[index].setdefault(slot, view)
            return
        self.thread = threading.Thread(target=self._check, args=(self._views,), daemon=True)
        self._begin_s, self._views = self._begin_s + WORLD_EVERY_S, []
        self.thread.start()

    def _check(self, views: Sequence[Mapping[int, Poses2D]]) -> None:
        """Compare in a process of its own: what that imports takes as much memory as the edge."""
        if not any(views):
            return
        num_slots, series = series_from_frames(views, 1 / LOOK_S, len(self.skeleton), "recent")
        recent = Recording("recent", self.rig, 1 / LOOK_S, num_slots, self.skeleton, series)
        with suppress(InputError, OSError):  # nothing is known then
            self.words = call_apart(_doubt, recent, self.noise, self.file, limit_s=WORLD_LIMIT_S)


def _doubt(recent: Recording, noise: Noise, file: Path) -> str:
    return doubt_people(recent, noise, file) or ""


class DisplacementWatch:
    """Looks for displaced cameras of a live edge; `observe` is for one thread, `found` for any."""

    def __init__(self, rig: Rig, world: WorldCheck | None = None) -> None:
        """Start without observations.

        Args:
            rig: the calibration of the edge.
            world: checks its scale and axes; None for no check.
        """
        self.rig, self.world = rig, world
        self.found: Displacement | None = None
        self._watch = Votes.begin(len(rig))
        self._observed_s = dict.fromkeys(range(len(rig)), -np.inf)
        self._observations: dict[int, list[Observation]] = {}  # since the last check
        self._ask_s = -np.inf
        self._answers: list[Displacement | None] = [None] * ASKED

    def observe(self, record: SlotRecord, views: Mapping[int, Poses2D]) -> None:
        """Add a slot.

        Args:
            record: its people.
            views: by camera, its detections.
        """
        now_s = record.time_s
        if self.world is not None:
            self.world.observe(now_s, views)
        for index, view in views.items():
            if now_s - self._observed_s[index] >= LOOK_S:
                self._observed_s[index] = now_s
                observation = Observation(now_s, view, record.people)
                self._observations.setdefault(index, []).append(observation)
        if now_s - self._ask_s >= ASK_S:
            self._ask_s = now_s
            self._watch, self._observations = observe(self._watch, self.rig, self._observations), {}
            self._answers = [*self._answers[1:], self._ask()]

    def _ask(self) -> Displacement | None:
        degrees, least = turned_deg(self._watch)
        found, before = moved(degrees, least), self.found
        if before is None or degrees[before.camera] < MOVED_DEG:
            return found
        # There is no evidence that it is back, and it makes others seem turned.
        same = found is not None and found.camera == before.camera
        return found if same else before

    def events(self) -> list[tuple[str, str, str | None]]:
        """Return the events since the last call: kind, message and camera."""
        events: list[tuple[str, str, str | None]] = []
        if self.world is not None and self.world.words and not self.world.reported:
            events.append(("world-doubted", self.world.words, None))
            self.world.reported = True
        before, answers = self.found, self._answers
        cameras = {None if answer is None else answer.camera for answer in answers}
        if len(cameras) > 1:
            return events
        self.found = answers[-1]
        if (before and before.camera) == (self.found and self.found.camera):
            return events
        if before is not None:
            name = self.rig.camera_ids[before.camera]
            words = f"{self.rig.titles[name]} stands as calibrated again"
            events.append(("camera-in-place", words, name))
        if self.found is not None:
            name = self.rig.camera_ids[self.found.camera]
            words = f"{self.rig.titles[name]} {moved_words(self.found.degrees, name)}"
            events.append(("camera-moved", words, name))
        return events


def moved_words(degrees: float, camera_id: str) -> str:
    """Return the message about a displaced camera, with the command that recalibrates it."""
    return (
        f"has moved: turned by {degrees:.1f} degrees or more; "
        f"`e3pose calibrate extrinsics SITE --only {camera_id}` recalibrates it"
    )
