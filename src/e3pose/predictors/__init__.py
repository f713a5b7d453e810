"""Predictors: recent 3D poses -> 3D poses a few slots ahead."""

from collections.abc import Callable

from e3pose.errors import InputError
from e3pose.predictors.base import Prediction as Prediction
from e3pose.predictors.base import Predictor as Predictor
from e3pose.predictors.constant_velocity import ConstantVelocity
from e3pose.predictors.damped_velocity import DampedVelocity
from e3pose.predictors.zero_velocity import ZeroVelocity
from e3pose.skeleton import COCO17, Skeleton

# A predictor is made for the skeleton of the poses that it will be given.
PREDICTORS: dict[str, Callable[[Skeleton], Predictor]] = {
    "zero-velocity": lambda skeleton: ZeroVelocity(),
    "constant-velocity": lambda skeleton: ConstantVelocity(),
    "damped-velocity": lambda skeleton: DampedVelocity(),
}


def make_predictor(name: str, skeleton: Skeleton = COCO17) -> Predictor:
    """Return the predictor called `name`; raise `InputError` listing the known ones."""
    if name not in PREDICTORS:
        raise InputError(
            f"predictor {name[:40]!r} is unknown, expected one of {', '.join(PREDICTORS)}"
        )
    return PREDICTORS[name](skeleton)
