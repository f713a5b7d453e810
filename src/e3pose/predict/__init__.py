"""Predictors: recent 3D poses -> 3D poses a few slots ahead."""

import logging
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.plugins import maker
from e3pose.model.skeleton import COCO17, Skeleton
from e3pose.predict.attention_lstm import PUBLISHED, AttentionLstm
from e3pose.predict.base import Prediction as Prediction
from e3pose.predict.base import Predictor as Predictor
from e3pose.predict.velocities import ConstantVelocity, DampedVelocity, ZeroVelocity

GROUP = "e3pose.predictors"  # the entry points of other packages
FALLBACK = "constant-velocity"
WEIGHTS_ENDING = ".onnx"  # what `e3pose train` and `e3pose learn` leave behind


# A predictor is made for the skeleton of the poses that it will be given.
PREDICTORS: dict[str, Callable[[Skeleton], Predictor]] = {
    "zero-velocity": lambda skeleton: ZeroVelocity(),
    "constant-velocity": lambda skeleton: ConstantVelocity(),
    "damped-velocity": lambda skeleton: DampedVelocity(),
    "attention-lstm": lambda skeleton: AttentionLstm(skeleton),
    "attention-lstm-paper": lambda skeleton: AttentionLstm(skeleton, PUBLISHED),
}


def make_predictor(name: str, skeleton: Skeleton = COCO17) -> Predictor:
    """Return the predictor called `name`, or that of a file of weights, `.onnx`.

    Raises:
        InputError: listing the known names, or saying what is wrong with the file.
    """
    if name.endswith(WEIGHTS_ENDING):
        return AttentionLstm(skeleton, Path(name))
    more = f", a file of weights that ends in {WEIGHTS_ENDING}"
    return maker(GROUP, "predictor", name, PREDICTORS, more)(skeleton)


def make_predictor_or_fallback(name: str, skeleton: Skeleton = COCO17) -> Predictor:
    """Return the predictor called `name`, or `FALLBACK`, saying so, where it cannot be had.

    It cannot be had when its weights are missing, damaged or made for other joints, or when the
    library that runs it is not installed; a running edge goes on all the same.
    """
    try:
        return make_predictor(name, skeleton)
    except (InputError, ImportError) as error:
        _say_once(f"predictor {name} is not available, using {FALLBACK} unsteered: {error}")
        return PREDICTORS[FALLBACK](skeleton)


def make_predictors(name: str, steering: str, skeleton: Skeleton) -> tuple[Predictor, Predictor]:
    """Return the predictor called `name` and the one that steers: one object if they are the same.

    Each has a stand-in where it cannot be had.
    """
    found = {each: make_predictor_or_fallback(each, skeleton) for each in {name, steering}}
    return found[name], found[steering]


@lru_cache(maxsize=64)
def _say_once(message: str) -> None:
    logging.getLogger(__name__).warning(message)
