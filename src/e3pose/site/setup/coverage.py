"""Coverage of the room by a walk: by camera, by pair of cameras and, once calibrated, by place.

Before a calibration nobody knows where on the floor a person is. What is known then is where in
each picture people were, and which cameras saw somebody at the same time: that is what a
calibration from people needs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from e3pose.calibrate.triangulation import place_points
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton

COLUMNS, ROWS = 8, 6  # cells of a picture
MIN_SCORE, MIN_JOINTS = 0.3, 6  # of a pose that counts
ENOUGH_S = 30.0  # with somebody in two cameras
PAIR_S = 6.0  # that a camera has in common with another one
WIDE = 0.6  # share of a picture's columns in which people were
CELL_M = 0.5
OFF_SHARE = 0.02  # of an image's longer side: joints of one person agree within this
SIDES = ("left", "middle", "right")


@dataclass(slots=True, eq=False)
class Coverage:
    """Coverage of a walk so far; `add` extends it.

    Attributes:
        rig: the cameras; floor places count only where it is placed.
        skeleton: of the keypoints.
        fps: slots per second of the scene.
        slots: that were added.
        seen: `(num_cameras, ROWS, COLUMNS)` how often somebody's lowest joint was in a cell.
        people: `(num_cameras,)` poses.
        together: `(num_cameras, num_cameras)` slots in which both saw somebody; on the diagonal,
            slots in which the camera did.
        shared: slots in which two cameras saw somebody.
        floor: cells of the floor, by number, and how many slots somebody was there.
        newest: by camera, joints of the people seen last, pixels.
    """

    rig: Rig
    skeleton: Skeleton
    fps: float
    slots: int = 0
    seen: NDArray[np.int64] = field(init=False)
    people: NDArray[np.int64] = field(init=False)
    together: NDArray[np.int64] = field(init=False)
    shared: int = 0
    floor: Counter[tuple[int, int]] = field(default_factory=Counter)
    newest: dict[int, list[list[list[float] | None]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        number = len(self.rig)
        self.seen = np.zeros((number, ROWS, COLUMNS), dtype=np.int64)
        self.people = np.zeros(number, dtype=np.int64)
        self.together = np.zeros((number, number), dtype=np.int64)

    def add(self, views: Mapping[int, Poses2D], sizes: Sequence[tuple[int, int]]) -> None:
        """Count a slot.

        Args:
            views: by camera of the rig, the people it saw.
            sizes: `(width, height)` of each camera's images.
        """
        self.slots += 1
        there: list[int] = []
        for camera, poses in views.items():
            good = _good(poses)
            self.newest[camera] = [_listed(pose) for pose in good]
            self.people[camera] += len(good)
            if len(good):
                there.append(camera)
            for pose in good:
                self._mark(camera, pose, sizes[camera])
        for a in there:
            for b in there:
                self.together[a, b] += 1
        self.shared += len(there) >= 2
        if self.rig.placed and len(there) >= 2:
            for x, y in self._places({camera: _good(views[camera]) for camera in there}):
                self.floor[int(np.floor(x / CELL_M)), int(np.floor(y / CELL_M))] += 1

    def _mark(self, camera: int, pose: NDArray[np.float64], size: tuple[int, int]) -> None:
        """Count a person in the cell of the lowest joint that is known."""
        lowest = pose[np.nanargmax(pose[:, 1])]
        column = int(np.clip(lowest[0] / size[0] * COLUMNS, 0, COLUMNS - 1))
        row = int(np.clip(lowest[1] / size[1] * ROWS, 0, ROWS - 1))
        self.seen[camera, row, column] += 1

    def _places(self, views: Mapping[int, NDArray[np.float64]]) -> list[tuple[float, float]]:
        """Return floor positions of people on whom two cameras agree, best first."""
        found: list[tuple[float, float]] = []
        for a, b in combinations(sorted(views), 2):
            agreeing = [
                (off_px, i, j, place)
                for i, first in enumerate(views[a])
                for j, second in enumerate(views[b])
                for off_px, place in self._place(a, first, b, second)
            ]
            used: set[tuple[int, int]] = set()
            for _, i, j, (x, y) in sorted(agreeing):
                if not {(a, i), (b, j)} & used:
                    used |= {(a, i), (b, j)}
                    if all(np.hypot(x - u, y - v) > CELL_M for u, v in found):
                        found.append((x, y))
        return found

    def _place(
        self, a: int, first: NDArray[np.float64], b: int, second: NDArray[np.float64]
    ) -> list[tuple[float, tuple[float, float]]]:
        """Return how far off two views of a person are, as a share of an image, and the place."""
        pixels = np.full((len(self.rig), len(first), 2), np.nan)
        pixels[a], pixels[b] = first, second
        points = place_points(self.rig, pixels, np.ones(pixels.shape[:2]))
        known = np.isfinite(points).all(axis=-1)
        if known.sum() < MIN_JOINTS:
            return []
        shares = []
        for camera in (a, b):
            lens = self.rig.cameras[camera]
            off = np.linalg.norm(lens.project(points[known]) - pixels[camera, known], axis=-1)
            shares.append(float(np.median(off)) / max(lens.image_size))
        if not max(shares) < OFF_SHARE:
            return []
        x, y = np.median(points[known, :2], axis=0).tolist()
        return [(max(shares), (float(x), float(y)))]

    @property
    def seconds(self) -> float:
        """Seconds in which two cameras saw people."""
        return self.shared / self.fps

    def pair_s(self, a: int, b: int) -> float:
        """Return the seconds in which both cameras saw people."""
        return float(self.together[a, b] / self.fps)

    def share(self, camera: int) -> float:
        """Return the share of the width of a camera's picture in which people were, [0, 1]."""
        return float((self.seen[camera] > 0).any(axis=0).mean())


def hints(covered: Coverage) -> list[str]:
    """Return where to go next, most urgent first; nothing when it is enough."""
    names, words = covered.rig.camera_ids, []
    number = len(names)
    unseen = [i for i in range(number) if covered.people[i] == 0]
    words += [f"{names[i]} has seen nobody yet: walk in front of it." for i in unseen]
    for i in range(number):
        others = [j for j in range(number) if j != i and j not in unseen]
        if i in unseen or not others:
            continue
        best = max(others, key=lambda j: covered.pair_s(i, j))
        if (shared_s := covered.pair_s(i, best)) < PAIR_S:
            words.append(
                f"{names[i]} shares only {shared_s:.0f} s with another camera ({names[best]}): "
                "walk where both see you."
            )
    if not words and (apart := _apart(covered)):
        one, rest = ", ".join(names[i] for i in apart[0]), ", ".join(names[i] for i in apart[1])
        words.append(f"Nobody was seen by {one} and {rest} at once: walk from one to the other.")
    for i in range(number):
        if i not in unseen and covered.share(i) < WIDE:
            thirds = np.array_split((covered.seen[i] > 0).sum(axis=0), 3)
            side = SIDES[int(np.argmin([third.mean() for third in thirds]))]
            words.append(f"Walk further to the {side} of {names[i]}.")
    if covered.seconds < ENOUGH_S:
        words.append(f"Go on for {ENOUGH_S - covered.seconds:.0f} s.")
    return words


def _apart(covered: Coverage) -> tuple[list[int], list[int]] | None:
    """Return two groups of cameras that hardly saw anybody together; None if there are none."""
    number = len(covered.rig)
    group, rest = {0}, set(range(1, number))
    while grown := {j for j in rest if any(covered.pair_s(i, j) >= PAIR_S for i in group)}:
        group |= grown
        rest -= grown
    return (sorted(group), sorted(rest)) if rest else None


def _good(poses: Poses2D) -> NDArray[np.float64]:
    """Return `(n, num_joints, 2)` pixels of well-visible people; NaN where uncertain."""
    sure = np.where((poses.scores >= MIN_SCORE)[..., None], poses.keypoints_px, np.nan)
    known = np.isfinite(sure).all(axis=-1)
    return np.asarray(sure[known.sum(axis=-1) >= MIN_JOINTS])


def _listed(pose: NDArray[np.float64]) -> list[list[float] | None]:
    return [[round(float(x), 1), round(float(y), 1)] if np.isfinite(x) else None for x, y in pose]
