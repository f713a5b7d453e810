"""What a network expects of its own errors -> what they are on motion that it never saw."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MAX_LENGTH = 10_000  # characters of a property: tens of leads, ten points each
MAX_LOG = 20.0


class Calibration:
    """Expected errors by a rising curve per lead, then times a factor per lead.

    Between the points of a curve, logarithms are linear; beyond them the nearest point's ratio
    holds. The last lead's curve and factor serve all later leads.
    """

    def __init__(self, properties: Mapping[str, str]) -> None:
        """Read the properties `error_factor` and, optionally, `error_curve`, both JSON.

        Raises:
            ValueError: when one is not what `e3pose.learn.train.export` writes.
        """
        factor = _numbers(properties["error_factor"])
        if factor.ndim != 1 or not len(factor) or not (factor > 0).all():
            raise ValueError("expected a list of positive numbers")
        self.log_factor = np.log(factor)
        curve = _numbers(properties.get("error_curve", "null"), [[[0.0, 1.0]], [[0.0, 1.0]]])
        if curve.ndim != 3 or len(curve) != 2 or not curve.shape[1] or curve.shape[2] < 2:
            raise ValueError("expected two lists of points per lead")
        rises = np.diff(curve, axis=-1)
        if not (rises[0] > 0).all() or not (rises[1] >= 0).all() or np.abs(curve).max() > MAX_LOG:
            raise ValueError("expected rising points")
        self.curve = curve
        self.slopes = rises[1] / rises[0]

    def __call__(self, log_error: NDArray[np.float32]) -> Floats:
        """Return errors in metres of logarithms `(num_leads, num_tracks, num_joints)`."""
        lead = np.arange(len(log_error))
        x, y = self.curve[:, np.minimum(lead, self.curve.shape[1] - 1)]
        slopes = self.slopes[np.minimum(lead, len(self.slopes) - 1)]
        factor = self.log_factor[np.minimum(lead, len(self.log_factor) - 1)]
        given = log_error.astype(np.float64)
        low, high = x[:, :1, None], x[:, -1:, None]
        inside = np.clip(given, low, high)
        # A piecewise linear function is a sum of clipped ramps.
        ramps = np.clip(inside[..., None] - x[:, None, None, :-1], 0, np.diff(x)[:, None, None])
        bent = np.einsum("lnjk,lk->lnj", ramps, slopes)
        return np.asarray(np.exp(y[:, :1, None] + bent + given - inside + factor[:, None, None]))


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
