"""Body model: bones and forward kinematics from joint angles and feet.

The body frame is x forward, y left, z up. Every bone has one length for ever: the knee is found
between a hip and an ankle by the law of cosines, everything else by turning rigid pieces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats

MAX_REACH = 0.9995  # share of a straight leg; beyond it the ankle stays behind its target
SIDES = (1.0, -1.0)  # left, right along y

# Shares of stature after Drillis and Contini, as tabulated by Winter (Biomechanics and Motor
# Control of Human Movement); widths are between joint centres, not over the skin.
SHARES = {
    "thigh": 0.245, "shank": 0.246, "ankle_height": 0.045, "hip_half": 0.052, "spine": 0.288,
    "shoulder_half": 0.105, "upper_arm": 0.176, "forearm": 0.150, "neck": 0.105,
}  # fmt: skip
BONE_SPREAD = 0.03  # people of one height differ by so much in every bone
# Face keypoints from the point between the ears, as shares of stature: forward, left, up.
FACE_SHARES = np.array(
    [[0.068, 0.0, -0.010], [0.055, 0.018, 0.010], [0.055, -0.018, 0.010],
     [0.0, 0.044, 0.0], [0.0, -0.044, 0.0]]
)  # fmt: skip
EARS_FORWARD = 0.012  # share of stature by which the ears are before the neck


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Bone lengths of one person in metres; face is `(5, 3)` nose, eyes, ears from the neck."""

    stature: float
    thigh: float
    shank: float
    ankle_height: float
    hip_half: float
    spine: float
    shoulder_half: float
    upper_arm: float
    forearm: float
    face: Floats

    @property
    def leg(self) -> float:
        """Length of the straight leg from hip to ankle."""
        return self.thigh + self.shank


@dataclass(frozen=True, slots=True, eq=False)
class Posture:
    """Angles (radians) and positions (metres) of one body over time.

    Attributes:
        pelvis_m: `(num_times, 3)` the point between the hips.
        pelvis: `(num_times, 3)` yaw in the world, pitch, roll.
        torso: `(num_times, 3)` yaw in the world, pitch (forward), roll.
        head: `(num_times, 3)` yaw in the world, pitch (down), roll.
        knees: `(num_times,)` yaw in the world towards which the knees bend.
        ankles_m: `(num_times, 2, 3)` where the left and right ankle should be.
        arms: `(num_times, 2, 4)` left and right: flexion (forward), abduction (sideways), twist
            (forearm inwards) and bend of the elbow.
    """

    pelvis_m: Floats
    pelvis: Floats
    torso: Floats
    head: Floats
    knees: Floats
    ankles_m: Floats
    arms: Floats


def draw_body(rng: np.random.Generator, statures_m: tuple[float, float] | None = None) -> Body:
    """Draw a person with bones in human proportion.

    Args:
        rng: how people differ.
        statures_m: smallest and largest; without them an adult of about 1.71 m with 9 cm spread.
    """
    stature = float(np.clip(rng.normal(1.71, 0.09), 1.5, 1.95))
    if statures_m is not None:
        stature = float(rng.uniform(*statures_m))
    spread = np.exp(BONE_SPREAD * np.clip(rng.standard_normal(len(SHARES)), -2, 2))
    size = {
        name: float(share * stature * factor)
        for (name, share), factor in zip(SHARES.items(), spread, strict=True)
    }
    face = FACE_SHARES * stature * np.exp(BONE_SPREAD * np.clip(rng.standard_normal(), -2, 2))
    face = face + [EARS_FORWARD * stature, 0.0, size.pop("neck")]
    return Body(stature=stature, face=face, **size)


def joints_of(body: Body, posture: Posture) -> Floats:
    """Return the COCO-17 joints `(num_times, 17, 3)` of a body in metres."""
    pelvis, torso = rotation(posture.pelvis), rotation(posture.torso)
    head = rotation(posture.head)
    joints = np.empty((len(pelvis), 17, 3))
    neck = posture.pelvis_m + body.spine * torso[:, :, 2]
    joints[:, 0:5] = neck[:, None] + np.einsum("tij,kj->tki", head, body.face)
    forward = np.stack(
        [np.cos(posture.knees), np.sin(posture.knees), np.zeros(len(pelvis))], axis=-1
    )
    for index, side in enumerate(SIDES):
        shoulder = neck + side * body.shoulder_half * torso[:, :, 1]
        upper, lower = _arm_directions(posture.arms[:, index], side)
        elbow = shoulder + body.upper_arm * np.einsum("tij,tj->ti", torso, upper)
        wrist = elbow + body.forearm * np.einsum("tij,tj->ti", torso, lower)
        hip = posture.pelvis_m + side * body.hip_half * pelvis[:, :, 1]
        # The knee bends forward.
        along = posture.ankles_m[:, index] - hip
        wanted = np.linalg.norm(along, axis=-1, keepdims=True)
        along = along / wanted
        distance = np.clip(wanted, abs(body.thigh - body.shank) + 0.15, MAX_REACH * body.leg)
        cosine = (body.thigh**2 + distance**2 - body.shank**2) / (2 * body.thigh * distance)
        across = forward - along * (forward * along).sum(axis=-1, keepdims=True)
        across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-9)
        sine = np.sqrt(np.maximum(1 - cosine**2, 0.0))
        knee, ankle = hip + body.thigh * (cosine * along + sine * across), hip + distance * along
        for row, points in zip(
            (5, 7, 9, 11, 13, 15), (shoulder, elbow, wrist, hip, knee, ankle), strict=True
        ):
            joints[:, row + index] = points
    return joints


def rotation(angles: Floats) -> Floats:
    """Return `(num_times, 3, 3)` matrices for yaw, then pitch, then roll `(num_times, 3)`."""
    (cy, cp, cr), (sy, sp, sr) = np.cos(angles).T, np.sin(angles).T
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _arm_directions(angles: Floats, side: float) -> tuple[Floats, Floats]:
    """Return unit directions `(num_times, 3)` of upper arm and forearm in the torso frame."""
    flexion, abduction, twist, bend = angles.T
    sf, cf, sa, ca = np.sin(flexion), np.cos(flexion), np.sin(abduction), np.cos(abduction)
    upper = np.stack([sf * ca, side * sa, -cf * ca], axis=-1)
    forward = np.stack([cf, np.zeros_like(cf), sf], axis=-1)
    inward = np.stack([sf * sa, -side * ca, -cf * sa], axis=-1)
    hinge = forward * np.cos(twist)[:, None] + inward * np.sin(twist)[:, None]
    return upper, upper * np.cos(bend)[:, None] + hinge * np.sin(bend)[:, None]
