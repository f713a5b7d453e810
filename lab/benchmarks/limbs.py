"""Limbs of estimated people: how long they are, and how much the left differs from the right.

What people have: shares of stature (D. A. Winter, *Biomechanics and Motor Control of Human
Movement*, after Drillis and Contini), for statures of 0.8 m, a child who walks, to 2.2 m, and 15 %
more or less, for people differ and keypoints are not joints. Shoulders and hips of keypoints are
closer together than those of bodies, and seen from few sides only: down to half of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.skeleton import BODY_LIMBS, Skeleton

STATURES_M = 0.8, 2.2
SHARES = {  # of stature, and what more or less it may be
    "upper arm": (0.186, 1.15),
    "forearm": (0.146, 1.15),
    "thigh": (0.245, 1.15),
    "shank": (0.246, 1.15),
    "trunk": (0.288, 1.15),
    "shoulders": (0.235, 2.0),
    "hips": (0.15, 2.0),
}
KINDS = {
    ("elbow", "shoulder"): "upper arm",
    ("elbow", "wrist"): "forearm",
    ("hip", "knee"): "thigh",
    ("ankle", "knee"): "shank",
    ("hip", "shoulder"): "trunk",
    ("shoulder", "shoulder"): "shoulders",
    ("hip", "hip"): "hips",
}
PAIRED = ("upper arm", "forearm", "thigh", "shank")
UNLIKE = 0.15  # of the mean of left and right
SHORT_M = 0.15  # of a forearm


@dataclass(slots=True)
class Limbs:
    """Lengths of the limbs of people of a skeleton."""

    HEADER = " range  upper arm  forearm  thigh  shank  short forearms"

    skeleton: Skeleton
    poses_m: list[Floats] = field(default_factory=list)

    def add(self, joints_m: Floats) -> None:
        """Add people `(num_persons, num_joints, 3)`, NaN where missing."""
        self.poses_m.append(joints_m)

    def lengths_m(self) -> dict[str, Floats]:
        """Return lengths by kind, `(num_persons, 2)` left and right; of one limb `(..., 1)`."""
        poses_m = np.concatenate([np.zeros((0, len(self.skeleton), 3)), *self.poses_m])
        found: dict[str, list[Floats]] = {}
        for pair in BODY_LIMBS:
            if set(pair) <= set(self.skeleton.joints):
                a, b = (self.skeleton.joints.index(joint) for joint in pair)
                first, second = sorted(joint.split("_")[1] for joint in pair)
                length_m = np.linalg.norm(poses_m[:, a] - poses_m[:, b], axis=-1)
                found.setdefault(KINDS[first, second], []).append(length_m)
        return {kind: np.stack(lengths, axis=1) for kind, lengths in found.items()}

    def line(self) -> str:
        """Return the figures in percent, as in `HEADER`."""
        lengths_m = self.lengths_m()
        outside, limbs = 0, 0
        for kind, lengths in lengths_m.items():
            share, factor = SHARES[kind]
            known = lengths[np.isfinite(lengths)]
            low_m, high_m = STATURES_M[0] * share / factor, STATURES_M[1] * share * factor
            outside += int(((known < low_m) | (known > high_m)).sum())
            limbs += known.size
        unlike = []
        for kind in PAIRED:
            left, right = lengths_m[kind].T if kind in lengths_m else np.full((2, 1), np.nan)
            apart = np.abs(left - right) / ((left + right) / 2)
            unlike.append(100 * np.mean(apart[np.isfinite(apart)] > UNLIKE))
        forearms = lengths_m.get("forearm", np.full(1, np.nan))
        short = 100 * np.mean(forearms[np.isfinite(forearms)] < SHORT_M)
        return (
            f"{100 * outside / max(limbs, 1):6.2f}  {unlike[0]:9.1f}  {unlike[1]:7.1f}  "
            f"{unlike[2]:5.1f}  {unlike[3]:5.1f}  {short:14.1f}"
        )
