"""The state of the filter: its model of the rig, and its belief about people."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.estimate.filter import blindness, failed_pairs
from e3pose.estimate.filter.bones import GIRDLES, Proportions, proportions_of
from e3pose.estimate.filter.motion import alone
from e3pose.estimate.filter.scratch import Columns
from e3pose.estimate.filter.tree import Tree, grow
from e3pose.model.camera import Rig
from e3pose.model.noise import Noise
from e3pose.model.skeleton import SIDES, Skeleton

# tuned: s | first guess: 0.25 s finds simulated people sooner and adds false ones on Shelf | half
#   and twice
WAIT_S = 0.14  # three slots of 1/25 s
# tuned: views | not recorded | waiting views
WAIT_VIEWS = 2.5  # that a detection waits for where slots are long or few cameras look
MAX_TRACKS = 64  # capacity: nobody is started beyond, so ghosts of hostile views cannot pile up
# tuned: m | first guess | half and twice
APART_M = 0.35  # somebody nearer to a track than this is that track


@dataclass(frozen=True, eq=False)
class Model:
    """Constants of the filter.

    Attributes:
        rig: the cameras.
        skeleton: of the keypoints.
        noise: of the detector.
        wait_s: how long a detection that no track explains waits for a view of another camera.
    """

    rig: Rig
    skeleton: Skeleton
    noise: Noise
    wait_s: float = WAIT_S

    @cached_property
    def scales(self) -> Floats:
        """`(num_cameras,)` how much larger a camera's pixels count than the noise was measured in.

        Detectors see images at one input size, so their error is a share of the image.
        """
        return np.asarray(self.rig.image_sizes.max(axis=1) / self.noise.image_px)

    @cached_property
    def corner_m(self) -> Floats:
        """`(2,)` where on the floor the cells of `Belief.detection_map` begin."""
        return blindness.corner_m(self.rig)

    @cached_property
    def tree(self) -> Tree:
        """The tree of the joints."""
        return grow(self.skeleton)

    @cached_property
    def alone(self) -> tuple[Floats, Floats]:
        """Noise and life of velocity of joints that are looked at one by one (`motion.alone`)."""
        return alone(self.tree)

    @cached_property
    def proportions(self) -> Proportions:
        """The bones of the skeleton, and the prior of their lengths."""
        return proportions_of(self.skeleton, self.tree)

    @cached_property
    def core(self) -> Integers:
        """`(num_core,)` joints that tell people apart."""
        return np.array(self.skeleton.core, dtype=np.int64)

    @cached_property
    def girdles(self) -> Integers:
        """`(num_girdles, 2)` left and right joint of the shoulders and of the hips."""
        names = self.skeleton.joints
        pairs = [[f"{side}_{girdle}" for side in SIDES] for girdle in GIRDLES]
        found = [[names.index(name) for name in pair] for pair in pairs if set(pair) <= set(names)]
        return np.array(found, dtype=np.int64).reshape(-1, 2)

    @cached_property
    def sides(self) -> tuple[Integers, Integers]:
        """The other side of each joint, or itself; and 1 for arms, 2 for legs, else 0.

        `(num_joints,)` each. Joints that the skeleton has on one side only have none.
        """
        limbs = self.proportions.limbs
        opposites = np.arange(len(limbs))
        for left, right in self.skeleton.pairs:
            if limbs[left]:
                opposites[left], opposites[right] = right, left
        return opposites, limbs


def wait_s(interval_s: float, num_selected: float) -> float:
    """Return how long an unexplained detection must wait for another camera's view.

    Args:
        interval_s: seconds per slot.
        num_selected: cameras per slot, a mean if it is no whole number.
    """
    slots_between_views = math.ceil(1 / num_selected - 1e-9)
    return max(WAIT_S, WAIT_VIEWS * slots_between_views * interval_s)


@dataclass(frozen=True, slots=True, eq=False)
class Leftovers:
    """Recent detections that no track explains: candidates for new tracks.

    Attributes:
        times_s: `(num_leftovers,)` when they were seen.
        cameras: `(num_leftovers,)` by which camera.
        keypoints_px: `(num_leftovers, num_joints, 2)` undistorted pixels, NaN where missing.
        scores: `(num_leftovers, num_joints)` in [0, 1], 0 where missing.
    """

    times_s: Floats
    cameras: Integers
    keypoints_px: Floats
    scores: Floats

    def __len__(self) -> int:
        return len(self.cameras)

    def take(self, rows: Integers | Flags) -> Leftovers:
        """Return the leftovers at `rows`."""
        return Leftovers(*(getattr(self, item.name)[rows] for item in fields(self)))

    def join(self, other: Leftovers) -> Leftovers:
        """Return these and then the `other` ones."""
        return Leftovers(
            *(
                np.concatenate([getattr(self, item.name), getattr(other, item.name)])
                for item in fields(self)
            )
        )


@dataclass(frozen=True, slots=True, eq=False)
class Belief(Columns):
    """The belief about all people; a value, never changed in place.

    Attributes:
        time_s: of the newest slot; NaN before the first.
        leftovers: detections that wait for a second view.
        failed_pairs: `(num_cameras, ROWS, COLUMNS)` looks of other cameras that met no detection
            waiting there, by its place in the image, lately (`failed_pairs`).
        detection_map: `(num_cameras, NUM_CELLS, NUM_CELLS, 2)` looks of each camera at people who
            were there, by place, and how many of them showed the person (`blindness`).
        noise: `(num_cameras + 1, 3)` logarithm of the factor on the noise file's sigma that each
            camera's keypoints showed, how many taught it, and their mean sharpness: the variance
            of a keypoint of the best score over theirs, by score alone. Last the same of the tilt
            by score, without a sharpness (`learned_noise`).
        next_id: the id that the next new person gets.
    """

    time_s: float
    leftovers: Leftovers
    failed_pairs: Floats
    detection_map: Floats
    noise: Floats
    next_id: int = 1

    def __len__(self) -> int:
        return len(self.track_ids)

    @classmethod
    def empty(cls, model: Model) -> Belief:
        """Return the belief before the first slot."""
        joints, bones = len(model.skeleton), len(model.proportions.bones)
        return cls(
            time_s=np.nan,
            track_ids=np.zeros(0, dtype=np.int64),
            state=np.zeros((0, joints, 6)),
            covariance=np.zeros((0, joints, 6, 6)),
            shared=np.zeros((0, joints, 6, 6)),
            unmeasured_s=np.zeros((0, joints)),
            drift_share=np.ones((0, joints)),
            existence=np.zeros(0),
            hits=np.zeros(0, dtype=np.int64),
            alone=np.zeros(0),
            seen_by=np.zeros((0, len(model.rig)), dtype=bool),
            last_seen_s=np.zeros((0, len(model.rig))),
            delivered=np.zeros((0, len(model.rig))),
            missed=np.zeros((0, len(model.rig))),
            bias_px=np.zeros((0, len(model.rig), joints, 2)),
            confirmed=np.zeros(0, dtype=bool),
            mirrored=np.zeros((0, 2)),
            bones_m=np.zeros((0, bones)),
            bone_counts=np.zeros((0, bones)),
            innovations=np.zeros((0, 2)),
            agility=np.zeros((0, joints)),
            corrected_m=np.zeros((0, joints, 3)),
            leftovers=Leftovers(
                np.zeros(0),
                np.zeros(0, dtype=np.int64),
                np.zeros((0, joints, 2)),
                np.zeros((0, joints)),
            ),
            failed_pairs=failed_pairs.nothing_known(model.rig),
            detection_map=blindness.nothing_known(model.rig),
            noise=np.zeros((len(model.rig) + 1, 3)),
        )

    def without_people(self) -> Belief:
        """Return the belief of the same site without people."""
        nobody = {name: array[:0] for name, array in self.columns().items()}
        leftovers = self.leftovers.take(np.zeros(0, dtype=np.int64))
        return replace(self, leftovers=leftovers, **nobody)  # type: ignore[arg-type]

    def columns(self) -> dict[str, NDArray[np.generic]]:
        """Return the arrays that have one row per track."""
        return {item.name: getattr(self, item.name) for item in fields(Columns)}


class Known(NamedTuple):
    """The columns of `Belief` that publishing and outlook read."""

    state: Floats
    covariance: Floats
    drift_share: Floats
    innovations: Floats
    last_seen_s: Floats
    delivered: Floats
    confirmed: Flags
    bias_px: Floats
    detection_map: Floats
    noise: Floats


_arrays = attrgetter(*Known._fields)


def known_of(belief: Belief) -> Known:
    """Return the arrays of a belief that are published."""
    return Known(*_arrays(belief))
