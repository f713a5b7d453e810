"""The colours of predictors in pictures."""

from __future__ import annotations

from collections.abc import Mapping

from e3pose_lab.evaluate.drawing import COLOURS, PALE

PREDICTOR_COLOURS: Mapping[str, str] = {
    "attention-lstm": COLOURS[0],
    "constant-velocity": COLOURS[1],
    "damped-velocity": COLOURS[2],
    "zero-velocity": PALE,
}


def colour_of(predictor: str, index: int) -> str:
    """Return the colour of a predictor, the same in every picture."""
    return PREDICTOR_COLOURS.get(predictor, COLOURS[3 + index % 3])
