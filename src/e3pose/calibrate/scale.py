"""Scale of a rig: from a known distance, a limb, a body height, or a default height."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.base.errors import InputError
from e3pose.calibrate.people_3d import (
    ASSUMED_STATURE_M,
    People3D,
    limb_length,
    statures,
)
from e3pose.model.camera import Rig

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
    length = limb_length(people, first, second)
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
