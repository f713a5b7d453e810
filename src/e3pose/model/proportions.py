"""Proportions of people: how long limbs are for a stature, and how much that varies.

The logarithms of a person's lengths are normal: stature, which all limbs share, and what each kind
of limb differs from its share of the stature. Left and right are one kind.

    log length = log stature + log share + p
    log stature ~ N(log 1.68 m, 0.12^2),    p ~ N(0, spread^2)

Shares are those of keypoints, not of bones of the anatomist: a detector's hips are closer together
than hip joints, and higher. They are means of motion capture (CMU, two people), of joints that many
cameras triangulated (Panoptic, four people) and of keypoints (the first half of 160906_pizza1, five
people); for arms and legs they are within 4 % of those of Winter (*Biomechanics and Motor Control
of Human Movement*, after Drillis and Contini): 0.186, 0.146, 0.245 and 0.246. The spread is that
of people of one stature, 3 to 4 % (Gordon et al., *Anthropometric Survey of U.S. Army Personnel*,
1989), with that of the conventions, 4 % for arms and legs and more for the trunk, which bends.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from e3pose.model.skeleton import BODY_LIMBS, Skeleton

STATURE_M = 1.68  # physical: of adults
STATURE_SPREAD = 0.12  # physical: of its logarithm: adults 0.055, and children of 1.1 m
LEAST_M, MOST_M = 0.75, 2.3  # physical: stature of somebody who walks
# tuned: of a logarithm | by reasoning: a first guess | proportions
UNLIKE = 0.02  # spread of the logarithm of either side about that of both
# tuned: m | lab/experiments/2026-11-21-who-comes-back.md | is the spread of learned lengths about
#   the true ones, after 10 to 80 slots
SLIDE_M, NOISE_M = 0.010, 0.025  # a length that n slots taught is off by sqrt(SLIDE^2 + NOISE^2/n)


class Kind(NamedTuple):
    """A kind of limb.

    Attributes:
        share: of the stature.
        spread: standard deviation of the logarithm of its length, given the stature.
        give: by how much, as a factor, a shown limb may differ from its expected length. Bones are
            rigid; shoulders and hips shrug and bend.
    """

    share: float
    spread: float
    give: float


# tuned: factor | Panoptic motion: trunks and shoulders within 20 % in 99.8 % of slots, and room for
#   more | proportions
RIGID, SUPPLE = 1.07, 1.4
KINDS = {
    ("elbow", "shoulder"): Kind(0.170, 0.055, RIGID),
    ("elbow", "wrist"): Kind(0.147, 0.055, RIGID),
    ("hip", "knee"): Kind(0.245, 0.055, RIGID),
    ("ankle", "knee"): Kind(0.245, 0.055, RIGID),
    ("hip", "shoulder"): Kind(0.31, 0.08, SUPPLE),
    ("shoulder", "shoulder"): Kind(0.20, 0.09, SUPPLE),
    ("hip", "hip"): Kind(0.118, 0.15, SUPPLE),
}
_NUMBERS = {names: number for number, names in enumerate(KINDS)}
_LIMBS = frozenset(frozenset(limb) for limb in BODY_LIMBS)


def size_of(skeleton: Skeleton) -> float:
    """Return how large a skeleton is at rest beside a person; 1 where not all of its rest is known.

    Hands and faces alone are so followed as people are, and so are animals.
    """
    places_m = np.zeros((len(skeleton), 3))
    rest_m = np.array(skeleton.rest_m or places_m * np.nan)
    for joint in sorted(range(len(skeleton)), key=skeleton.depth)[1:]:
        places_m[joint] = places_m[skeleton.parents[joint]] + rest_m[joint]
    extent_m = float(np.ptp(places_m, axis=0).max())
    return extent_m / STATURE_M if extent_m > 0 else 1.0


def kind_of(first: str, second: str) -> int:
    """Return the row of `KINDS` of the limb between two joints; -1 where it has none."""
    if frozenset((first, second)) not in _LIMBS:
        return -1
    names = sorted(joint.removeprefix("left_").removeprefix("right_") for joint in (first, second))
    return _NUMBERS[names[0], names[1]]
