"""Markers: what other tools call joints, and where on a body of the model each one sits."""

from __future__ import annotations

from typing import NamedTuple

from e3pose.model.skeleton import MEANS, Skeleton

# What Pose2Sim and OpenCap call the joints of detectors, in which `left_` is `L`.
_BOTH = {
    "nose": "Nose", "neck": "Neck",
    **{f"{side}_{joint}": f"{letter}{name}"
       for side, letter in (("left", "L"), ("right", "R"))
       for joint, name in (
           ("eye", "Eye"), ("ear", "Ear"), ("shoulder", "Shoulder"), ("elbow", "Elbow"),
           ("wrist", "Wrist"), ("hip", "Hip"), ("knee", "Knee"), ("ankle", "Ankle"),
           ("big_toe", "BigToe"), ("small_toe", "SmallToe"), ("heel", "Heel"))},
}  # fmt: skip
NAMES = {
    "pose2sim": {**_BOTH, "mid_hip": "Hip", "top_head": "Head"},
    "opencap": {**_BOTH, "mid_hip": "midHip", "top_head": "HeadTop"},
}
ADDED = ("neck", "mid_hip")  # which both tools have, as means where the skeleton lacks them


class Place(NamedTuple):
    """Where a joint is on the model.

    Attributes:
        body: of the model, without its side.
        at_m: x ahead, y up and z outwards from the body's origin, metres.
        weight: of the marker in inverse kinematics.
    """

    body: str
    at_m: tuple[float, float, float]
    weight: float


# Bodies begin at their joints: so a joint's marker is at the origin, whatever the model's lengths.
# Means of joints and the face say nothing that the others do not; they have no marker.
PLACES = {
    "hip": Place("femur", (0.0, 0.0, 0.0), 1.0),
    "knee": Place("tibia", (0.0, 0.0, 0.0), 1.0),
    "ankle": Place("talus", (0.0, 0.0, 0.0), 1.0),
    "heel": Place("calcn", (0.0, 0.0, 0.0), 0.5),
    "big_toe": Place("toes", (0.06, 0.0, 0.0), 0.5),
    "small_toe": Place("toes", (0.015, 0.0, 0.07), 0.5),
    "shoulder": Place("humerus", (0.0, 0.0, 0.0), 1.0),
    "elbow": Place("ulna", (0.0, 0.0, 0.0), 1.0),
    "wrist": Place("hand", (0.0, 0.0, 0.0), 1.0),
}
SIDES = (("right", "r", 1.0), ("left", "l", -1.0))  # name, suffix, where z is outwards


class Marker(NamedTuple):
    """A marker of the model."""

    name: str
    body: str
    at_m: tuple[float, float, float]
    weight: float


def columns(skeleton: Skeleton, names: str | None) -> list[tuple[str, tuple[int, ...]]]:
    """Return the markers of a file: each with its name, and the joints it is the mean of.

    Args:
        skeleton: of the poses.
        names: a key of `NAMES`; None for those of the joints.
    """
    if names is None:
        return [(joint, (index,)) for index, joint in enumerate(skeleton.joints)]
    known = NAMES[names]
    found: list[tuple[str, tuple[int, ...]]] = [
        (known.get(joint, joint), (row,)) for row, joint in enumerate(skeleton.joints)
    ]
    for joint in ADDED:
        if joint not in skeleton.joints and set(MEANS[joint]) <= set(skeleton.joints):
            found.append((known[joint], tuple(skeleton.index(part) for part in MEANS[joint])))
    return found


def markers(skeleton: Skeleton, names: str) -> list[Marker]:
    """Return the markers of the model for the joints of a skeleton."""
    found = []
    for side, suffix, outwards in SIDES:
        for joint, place in PLACES.items():
            if f"{side}_{joint}" in skeleton.joints:
                x, y, z = place.at_m
                name, body = NAMES[names][f"{side}_{joint}"], f"{place.body}_{suffix}"
                found.append(Marker(name, body, (x, y, outwards * z), place.weight))
    return found
