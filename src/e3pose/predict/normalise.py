"""The attention-LSTM's input for a person: the same numbers in training and at run time.

Twelve limb joints, neck and head, wherever the person stands and whichever way they face; gaps
closed and marked; speeds in units of the person's own recent speed, so that slow and fast motion
look alike and an error means the same for both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from e3pose.model.skeleton import MEANS, Skeleton

COMMON_JOINTS = (
    "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
    "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    "neck", "head",
)  # fmt: skip
NUM_COMMON = len(COMMON_JOINTS)
# The first of these that a skeleton has stands for the common joint; MEANS are tried last.
STAND_INS = {"neck": ("neck", "bottom_head"), "head": ("nose", "top_head")}
LEFT_RIGHT = ((0, 1), (6, 7))  # pairs that tell which way a person faces
NUM_FEATURES = 7 * NUM_COMMON  # of one person in one slot: position, motion, whether measured
NUM_CONTEXT = 4  # of one person: speed, slot length, roughness of that speed and in itself


def common_columns(skeleton: Skeleton) -> NDArray[np.int64]:
    """Return `(NUM_COMMON, 2)`: the columns of `skeleton` whose mean each common joint is.

    -1 where there is no such column: a common joint that is one joint has one, and one that the
    skeleton does not have none.
    """
    columns = np.full((NUM_COMMON, 2), -1, dtype=np.int64)
    for row, joint in zip(columns, COMMON_JOINTS, strict=True):
        for name in STAND_INS.get(joint, (joint,)):
            if name in skeleton.joints:
                row[0] = skeleton.joints.index(name)
                break
        else:
            parts = MEANS.get(joint, ())
            if parts and set(parts) <= set(skeleton.joints):
                row[:] = [skeleton.joints.index(part) for part in parts]
    return columns
