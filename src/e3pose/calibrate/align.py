"""Align a rig with the world: z up, floor at zero, origin and axes as asked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.calibrate.moved_cameras import placed
from e3pose.calibrate.people_3d import ANKLE_HEIGHT, ASSUMED_STATURE_M, People3D
from e3pose.model.camera import Rig

AXES = ("x", "y", "z", "-x", "-y", "-z")
STRAIGHT = 0.93  # of thigh and shank together, from which a leg counts as straight
STILL_MPS = 0.3  # ankles slower than this stand
MIN_MOMENTS = 10
FLOOR_SPREAD_M = 0.4  # standing places must spread this far, both ways, to tilt the floor
FLOOR_TILT = np.radians(15.0)  # by which the floor may lean from the people's vertical
GUESSED_CAMERA_HEIGHT_M = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """A similarity of the world: `new = scale * R @ old + t`."""

    scale: float
    R: Floats
    t: Floats

    def __matmul__(self, first: Move) -> Move:
        """Return the move that does `first`, then this one."""
        t = self.scale * self.R @ first.t + self.t
        return Move(self.scale * first.scale, self.R @ first.R, t)

    def rig(self, rig: Rig) -> Rig:
        """Return a rig moved along; it counts as placed."""
        cameras = []
        for camera in rig.cameras:
            R = camera.R @ self.R.T
            center = self.scale * self.R @ camera.center_m + self.t
            cameras.append(placed(camera, R, -R @ center))
        return Rig(tuple(cameras))


STAY = Move(1.0, np.eye(3), np.zeros(3))


def from_axis(up: str) -> Move:
    """Return the turn that makes the axis called `up` point along z; right-handed.

    Args:
        up: one of `AXES`. For y the x axis stays, as y-up files have it.

    Raises:
        InputError: for another axis.
    """
    if up not in AXES:
        raise InputError(f"--up: found {up[:20]!r}, expected one of {', '.join(AXES)}")
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1.0 if up.startswith("-") else 1.0
    return Move(1.0, turn_up(axis), np.zeros(3))


def turn_up(up: Floats) -> Floats:
    """Return the `(3, 3)` rotation that brings a direction `(3,)` to z; x stays nearly."""
    z = up / np.linalg.norm(up)
    x = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def up_from_cameras(rig: Rig) -> Floats:
    """Guess the vertical `(3,)` from cameras that were mounted level: their x axes lie flat.

    Where those axes all point one way, the mean of the images' up directions is taken.
    """
    sideways = np.stack([camera.R[0] for camera in rig.cameras])
    upward = -np.stack([camera.R[1] for camera in rig.cameras]).mean(axis=0)
    _, size, directions = np.linalg.svd(np.concatenate([sideways, np.zeros((3, 3))]))
    if size[1] < 0.3 or upward @ upward < 1e-6:
        return np.asarray(upward / max(np.linalg.norm(upward), 1e-9))
    up = directions[2]
    return np.asarray(up if up @ upward >= 0 else -up)


def guess(rig: Rig) -> Move:
    """Return a first world: level by the cameras, their mean height two metres."""
    R = turn_up(up_from_cameras(rig))
    centers = rig.centers_m @ R.T
    middle = centers.mean(axis=0) - [0, 0, GUESSED_CAMERA_HEIGHT_M]
    return Move(1.0, R, -middle)


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """The floor as people stand on it.

    Attributes:
        move: brings it to z = 0, with its origin under the middle of where people were.
        moments: how many moments of standing upright tell the vertical.
        tilted: whether standing places spread enough to tell its tilt; otherwise the vertical is
            that of upright people alone.
        spread_m: standard deviation of standing ankles from the floor found.
    """

    move: Move
    moments: int
    tilted: bool
    spread_m: float


def floor_from_people(people: People3D, stature_m: float = ASSUMED_STATURE_M) -> Floor:
    """Find vertical and floor from upright people and from feet that stand.

    Args:
        people: in metres, in any axes.
        stature_m: of the people, for how high an ankle is.

    Raises:
        InputError: when no person stands upright for long enough.
    """
    up, moments = _vertical(people)
    feet = _standing_ankles(people)
    if len(feet) < MIN_MOMENTS:
        raise InputError(
            f"people: found {len(feet)} moments with a foot at rest, expected at least "
            f"{MIN_MOMENTS}; record a person who walks and stands in view of two cameras"
        )
    normal, tilted = _plane(feet, up)
    heights = feet @ normal
    low = np.median(heights[heights <= np.quantile(heights, 0.6)])
    near = np.abs(heights - low) < 0.15
    level = float(np.median(heights[near]))
    R = turn_up(normal)
    middle = R @ np.median(feet, axis=0)
    t = -np.array([middle[0], middle[1], level - ANKLE_HEIGHT * stature_m])
    return Floor(Move(1.0, R, t), moments, tilted, float(heights[near].std()))


def _vertical(people: People3D) -> tuple[Floats, int]:
    hips = people.of("left_hip", "right_hip")
    shoulders = people.of("left_shoulder", "right_shoulder")
    ankles = people.of("left_ankle", "right_ankle")
    bodies = shoulders - ankles
    straight = np.ones(len(bodies), dtype=bool)
    for side in ("left", "right"):
        hip, knee, ankle = (people.of(f"{side}_{joint}") for joint in ("hip", "knee", "ankle"))
        leg = np.linalg.norm(hip - knee, axis=-1) + np.linalg.norm(knee - ankle, axis=-1)
        with np.errstate(invalid="ignore"):
            straight &= np.linalg.norm(hip - ankle, axis=-1) > STRAIGHT * leg
    good = straight & np.isfinite(bodies).all(axis=-1) & np.isfinite(hips).all(axis=-1)
    if good.sum() < MIN_MOMENTS:
        raise InputError(
            f"people: found {int(good.sum())} moments of an upright person, expected at least "
            f"{MIN_MOMENTS}; record a person who stands and walks upright in view of two cameras"
        )
    directions = bodies[good] / np.linalg.norm(bodies[good], axis=-1, keepdims=True)
    up = np.median(directions, axis=0)
    for _ in range(5):  # leaning moments are left out
        up = up / np.linalg.norm(up)
        near = directions @ up > np.cos(np.radians(12))
        if near.sum() < MIN_MOMENTS:
            break
        up = directions[near].mean(axis=0)
    return np.asarray(up / np.linalg.norm(up)), int(good.sum())


def _standing_ankles(people: People3D) -> Floats:
    feet = []
    for side in ("left", "right"):
        ankle = people.of(f"{side}_ankle")
        for person in np.unique(people.person).tolist():
            mine = np.flatnonzero(people.person == person)
            mine = mine[np.argsort(people.slot[mine])]
            # Over a fifth of a second, so that the noise of single slots does not count as motion.
            step = max(1, round(0.2 * people.fps))
            if len(mine) <= step:
                continue
            gaps = (people.slot[mine[step:]] - people.slot[mine[:-step]]) / people.fps
            moved = np.linalg.norm(ankle[mine[step:]] - ankle[mine[:-step]], axis=-1)
            with np.errstate(invalid="ignore"):
                still = (moved < STILL_MPS * gaps) & (gaps < 0.5)
            feet.append((ankle[mine[step:]] + ankle[mine[:-step]])[still] / 2)
    found = np.concatenate(feet) if feet else np.zeros((0, 3))
    return np.asarray(found[np.isfinite(found).all(axis=-1)])


def _plane(feet: Floats, up: Floats) -> tuple[Floats, bool]:
    """Fit a plane to standing ankles, robustly; the vertical if they stand in one place."""
    flat = turn_up(up)
    points = feet @ flat.T
    weights = np.ones(len(points))
    slope = np.zeros(2)
    for _ in range(15):
        centre = np.average(points, axis=0, weights=weights)
        A = points[:, :2] - centre[:2]
        height = points[:, 2] - centre[2]
        cov = (A * weights[:, None]).T @ A / weights.sum()
        if np.linalg.eigvalsh(cov)[0] < FLOOR_SPREAD_M**2:
            return up, False
        slope = np.linalg.solve(cov, (A * weights[:, None]).T @ height / weights.sum())
        error = height - A @ slope
        spread = max(1.4826 * float(np.median(np.abs(error))), 0.005)
        # Feet in the air and on chairs are above, never below: those count less.
        weights = 1 / (1 + (error / spread) ** 2 * np.where(error > 0, 4.0, 1.0))
    if np.arctan(np.linalg.norm(slope)) > FLOOR_TILT:
        return up, False
    normal = np.array([-slope[0], -slope[1], 1.0]) @ flat
    return np.asarray(normal / np.linalg.norm(normal)), True


def from_three_points(origin_m: Floats, ahead_m: Floats, aside_m: Floats) -> Move:
    """Return the world in which three floor points lie: origin, on the x axis, and to its left.

    Args:
        origin_m: `(3,)` becomes the origin.
        ahead_m: `(3,)` lies on the positive x axis then.
        aside_m: `(3,)` lies on the floor, where y is positive.

    Raises:
        InputError: when the points coincide or lie on a line.
    """
    x = ahead_m - origin_m
    z = np.cross(x, aside_m - origin_m)
    if np.linalg.norm(x) < 0.05 or np.linalg.norm(z) < 1e-3:
        raise InputError(
            "--points: found points that are one or lie on a line, expected a corner of the floor"
        )
    x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
    R = np.stack([x, np.cross(z, x), z])
    return Move(1.0, R, -R @ origin_m)


def from_board(T_world_board: Floats, rig: Rig) -> Move:
    """Return the world of a board that lies on the floor: its middle the origin, x along its rows.

    Args:
        T_world_board: `(4, 4)` board to the world as it is.
        rig: whose cameras are above the floor.
    """
    x, y, z = T_world_board[:3, 0], -T_world_board[:3, 1], -T_world_board[:3, 2]
    origin = T_world_board[:3, 3]
    if np.median((rig.centers_m - origin) @ z) < 0:
        y, z = -y, -z
    R = np.stack([x, y, z])
    return Move(1.0, R, -R @ origin)


def with_origin(rig: Rig, origin: str, facing: str) -> Move:
    """Return the shift and turn about z that put origin and x axis where they are wanted.

    Args:
        rig: already level, floor at zero.
        origin: `keep`, a camera id (the floor below it), or `x,y` in metres.
        facing: `keep`, or a camera id or `x,y` in metres towards which the x axis points.

    Raises:
        InputError: for a place that is neither a camera nor `x,y`, or one above the origin to face.
    """
    place = np.zeros(3)
    if origin != "keep":
        place[:2] = _place(rig, "--origin", origin)
    R = np.eye(3)
    if facing != "keep":
        ahead = _place(rig, "--x-axis", facing) - place[:2]
        if np.hypot(*ahead) < 0.01:
            what = (
                f"place {facing} is the origin"
                if "," in facing
                else (f"camera {facing} stands over the origin")
            )
            raise InputError(f"--x-axis: {what}, expected another")
        angle = np.arctan2(ahead[1], ahead[0])
        c, s = np.cos(angle), np.sin(angle)
        R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return Move(1.0, R, -R @ place)


def _place(rig: Rig, option: str, words: str) -> Floats:
    """Return `(2,)` metres: what an option says, or the floor below the camera that it names."""
    if "," not in words:
        return np.asarray(rig.cameras[rig.index(words)].center_m[:2])
    try:
        place = np.array([float(value) for value in words.split(",")])
    except ValueError:
        place = np.zeros(0)
    if place.shape != (2,) or not np.isfinite(place).all():
        raise InputError(f"{option}: found {words[:40]!r}, expected x,y in metres")
    return place
