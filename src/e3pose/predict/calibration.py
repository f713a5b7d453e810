"""What a network expects of its own errors -> what they are on motion that it never saw."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.predict.kernels.tracks import Curves

MAX_LENGTH = 10_000  # characters of a property: tens of leads, ten points each
MAX_LOG = 20.0


def read_curves(properties: Mapping[str, str]) -> Curves:
    """Return rising curves per lead, and factors per lead, that expected errors are bent by.

    Between the points of a curve, logarithms are linear; beyond them the nearest point's ratio
    holds. The last lead's curve and factor serve all later leads.

    Args:
        properties: `error_factor` and, optionally, `error_curve`, both JSON.

    Raises:
        ValueError: when one is not what `e3pose_lab.train.export` writes.
    """
    factor = _numbers(properties["error_factor"])
    if factor.ndim != 1 or not len(factor) or not (factor > 0).all():
        raise ValueError("expected a list of positive numbers")
    curve = _numbers(properties.get("error_curve", "null"), [[[0.0, 1.0]], [[0.0, 1.0]]])
    if curve.ndim != 3 or len(curve) != 2 or not curve.shape[1] or curve.shape[2] < 2:
        raise ValueError("expected two lists of points per lead")
    rises = np.diff(curve, axis=-1)
    if not (rises[0] > 0).all() or not (rises[1] >= 0).all() or np.abs(curve).max() > MAX_LOG:
        raise ValueError("expected rising points")
    return Curves(curve[0], curve[1], rises[1] / rises[0], np.log(factor))


def _numbers(text: str, default: object = None) -> Floats:
    """Return finite numbers in JSON as an array, `default` for null."""
    if len(text) > MAX_LENGTH:
        raise ValueError("expected fewer numbers")
    content = json.loads(text)
    try:
        numbers = np.array(default if content is None else content, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError("expected numbers") from error
    if not np.isfinite(numbers).all():
        raise ValueError("expected finite numbers")
    return numbers
