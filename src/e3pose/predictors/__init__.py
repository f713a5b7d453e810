"""Predictors: recent 3D poses -> 3D poses a few slots ahead."""

from collections.abc import Callable

from e3pose.errors import InputError
from e3pose.predictors.base import Predictor as Predictor
from e3pose.predictors.constant_velocity import ConstantVelocity

PREDICTORS: dict[str, Callable[[], Predictor]] = {
    "constant-velocity": ConstantVelocity,
}


def make_predictor(name: str) -> Predictor:
    """Return the predictor called `name`; raise `InputError` listing the known ones."""
    if name not in PREDICTORS:
        raise InputError(
            f"predictor {name[:40]!r} is unknown, expected one of {', '.join(PREDICTORS)}"
        )
    return PREDICTORS[name]()
