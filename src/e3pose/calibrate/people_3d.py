"""3D joints by person and slot from triangulated points, body heights, and the scale of a rig."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.base.quantities import shell
from e3pose.calibrate.recordings import first_seconds
from e3pose.calibrate.triangulation import place_points
from e3pose.model.camera import Rig
from e3pose.model.noise import Noise
from e3pose.model.skeleton import SIDES, Skeleton
from e3pose.recording.record import Recording

if TYPE_CHECKING:
    from e3pose.calibrate.matched_people import Joints

# Shares of stature after Drillis and Contini, as tabulated by Winter: thigh, shank, and from the
# middle of the hips to that of the shoulders.
THIGH, SHANK, SPINE, ANKLE_HEIGHT = 0.245, 0.246, 0.288, 0.045
ASSUMED_STATURE_M = 1.70  # of adults of whom nothing is known; a twelfth of them is 10 % off
GOOD_SIGMAS = 3.0
MIN_LIMBS = 8  # measurements of a limb


@dataclass(frozen=True, slots=True, eq=False)
class People3D:
    """Matched people in the world of a rig.

    Attributes:
        joints: `(num_moments, num_joints, 3)` NaN where not placed; in the rig's unit.
        person: `(num_moments,)` whose.
        slot: `(num_moments,)` when.
        skeleton: the joints' names.
        fps: slots per second.
    """

    joints: Floats
    person: NDArray[np.int64]
    slot: NDArray[np.int64]
    skeleton: Skeleton
    fps: float

    def of(self, *names: str) -> Floats:
        """Return `(num_moments, 3)` the mean of joints by name; NaN where one is not there."""
        if not {*names} <= {*self.skeleton.joints}:
            return np.full((len(self.joints), 3), np.nan)
        columns = [self.skeleton.index(name) for name in names]
        return np.asarray(self.joints[:, columns].mean(axis=1))

    def scaled(self, scale: float, R: Floats, t: Floats) -> People3D:
        """Return them moved: `scale * R @ joint + t`."""
        moved = scale * self.joints @ R.T + t
        return People3D(moved, self.person, self.slot, self.skeleton, self.fps)


def place_people(rig: Rig, joints: Joints, skeleton: Skeleton, fps: float) -> People3D:
    """Triangulate matched joints, without the joints that views disagree on."""
    points = place_points(rig, joints.keypoints_px, joints.sigma_px)
    errors = np.stack([camera.project(points) for camera in rig.cameras]) - joints.keypoints_px
    size = np.linalg.norm(errors, axis=-1) / joints.sigma_px
    agree = (size < GOOD_SIGMAS).sum(axis=0) >= 2
    points = np.where(agree[:, None], points, np.nan)
    number = len(skeleton)
    return People3D(
        points.reshape(-1, number, 3), joints.person[::number], joints.slot[::number], skeleton, fps
    )


def statures(people: People3D) -> Floats:
    """Return `(num_persons,)` how tall people are by thigh, shank and spine; NaN where unknown."""
    hips = people.of("left_hip", "right_hip")
    shoulders = people.of("left_shoulder", "right_shoulder")
    limbs = [(np.linalg.norm(shoulders - hips, axis=-1), SPINE)]
    for side in ("left", "right"):
        hip, knee, ankle = (people.of(f"{side}_{joint}") for joint in ("hip", "knee", "ankle"))
        limbs.append((np.linalg.norm(knee - hip, axis=-1), THIGH))
        limbs.append((np.linalg.norm(ankle - knee, axis=-1), SHANK))
    found = []
    for person in np.unique(people.person).tolist():
        mine = people.person == person
        lengths, shares = 0.0, 0.0
        for lengths_m, share in limbs:
            known = lengths_m[mine & np.isfinite(lengths_m)]
            if len(known) >= MIN_LIMBS:
                lengths += float(np.median(known))
                shares += share
        found.append(lengths / shares if shares >= 0.5 else np.nan)
    return np.array(found)


PEOPLE_M = (0.8, 2.5)  # statures outside it are those of another unit, or of wrong lenses
CHECKED_S = 20.0  # of a recording are enough to know how tall people are
MIN_MOMENTS = 8
LYING = "people would lie"
LIMB_ENDS = {f"{side}_{joint}" for side in SIDES for joint in ("shoulder", "hip", "knee", "ankle")}


def doubt_people(recording: Recording, noise: Noise, file: object = "CALIBRATION") -> str | None:
    """Return why people cannot be right in the world of a recording's rig; empty if they can.

    None where too little is seen of them.

    People are matched by rays alone, which no unit of length changes.

    Args:
        recording: of placed cameras, with the keypoints of people.
        noise: what scores promise.
        file: the calibration, for the command that mends it.
    """
    from e3pose.calibrate.matched_people import match_people

    known = {*recording.skeleton.joints} >= LIMB_ENDS
    if not known or not recording.rig.placed or len(recording.rig) < 2:
        return None
    used = first_seconds(recording, CHECKED_S)
    joints = match_people(used, noise, used.rig)
    return doubt_placed(place_people(used.rig, joints, used.skeleton, used.fps), file)


def doubt_placed(people: People3D, file: object) -> str | None:
    """Return the same of people in a world."""
    if not {*people.skeleton.joints} >= LIMB_ENDS:
        return None
    found = statures(people)
    if not np.isfinite(found).any():
        return None
    tall_m = float(np.nanmedian(found))
    if not PEOPLE_M[0] <= tall_m <= PEOPLE_M[1]:
        return (
            f"people would be {tall_m:.3g} m tall: are the calibration's lengths metres, and is "
            'the size of its board right? (a TOML file can say [metadata] units = "mm"; '
            "e3pose calibrate align --height gives the scale from people)"
        )
    trunks = people.of("left_shoulder", "right_shoulder") - people.of("left_hip", "right_hip")
    trunks = trunks[np.isfinite(trunks).all(axis=-1)]
    if len(trunks) < MIN_MOMENTS:
        return ""
    up = np.median(trunks / np.linalg.norm(trunks, axis=-1)[:, None], axis=0)
    axis = int(np.argmax(np.abs(up)))
    if axis == 2 and up[2] > 0:
        return ""
    name = ("-" if up[axis] < 0 else "") + "xyz"[axis]
    return (
        f"{LYING}: their up is along {name}, expected z: e3pose calibrate align "
        f"{shell(file)} fixed.toml --up={name}"
    )


ASSUMED_SHARE = 0.06  # how far off a guess from people of average stature may be


@dataclass(frozen=True, slots=True)
class Scale:
    """Metres in a unit of the rig, and where they are from.

    Attributes:
        factor: multiplies lengths.
        known_from: in words.
        share: how far it may be off, as a share.
    """

    factor: float
    known_from: str
    share: float


def from_distance(rig: Rig, first: str, second: str, metres: float) -> Scale:
    """Return the scale at which two cameras are as far apart as measured.

    Args:
        rig: without a scale.
        first: id of a camera.
        second: id of another.
        metres: the distance between their lenses.

    Raises:
        InputError: for one camera twice, or two at one place.
    """
    apart = np.linalg.norm(
        rig.cameras[rig.index(first)].center_m - rig.cameras[rig.index(second)].center_m
    )
    if apart == 0 or first == second:
        raise InputError(
            f"--distance: found {first},{second}, expected two cameras at different positions"
        )
    return Scale(
        metres / float(apart), f"{metres:g} m from {first} to {second}", min(0.01 / metres, 1.0)
    )


def from_limb(people: People3D, first: str, second: str, metres: float) -> Scale:
    """Return the scale at which a limb has its measured length.

    Args:
        people: joints in the rig's unit.
        first: a joint.
        second: the joint at the other end.
        metres: the length between them.

    Raises:
        InputError: when the two were seldom triangulated together.
    """
    apart = np.linalg.norm(people.of(first) - people.of(second), axis=-1)
    known = apart[np.isfinite(apart)]
    length = float(np.median(known)) if len(known) >= MIN_LIMBS else float("nan")
    if not length > 0:
        raise InputError(f"--limb: {first} and {second} were rarely triangulated together")
    return Scale(metres / length, f"{metres:g} m from {first} to {second}", 0.03)


def from_stature(people: People3D, metres: float | None) -> Scale:
    """Return the scale at which people have a body height.

    Args:
        people: joints in the rig's unit.
        metres: mean height of the people; the average of adults if None.

    Raises:
        InputError: when neither legs nor trunk of anybody were triangulated.
    """
    found = statures(people)
    found = found[np.isfinite(found)]
    if not len(found):
        raise InputError(
            "people: no legs and trunk were located, so the scale is unknown; pass "
            "--distance or --limb"
        )
    tall = float(np.median(found))
    if metres is not None:
        return Scale(metres / tall, f"people {metres:g} m tall", 0.03)
    return Scale(
        ASSUMED_STATURE_M / tall, f"people assumed to be {ASSUMED_STATURE_M:g} m tall",
        ASSUMED_SHARE,
    )  # fmt: skip
