"""Expected errors are bent as a curve per lead says, and nonsense is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.predict.attention_lstm import read_curves
from e3pose.predict.kernels.tracks import Curves, calibrated


def errors(curves: Curves, lead: int, log_errors: list[float]) -> list[float]:
    return [calibrated(np.float32(log_error), lead, curves) for log_error in log_errors]


def test_between_points_logarithms_are_linear_and_beyond_ratios_hold() -> None:
    curve = [[[-4.0, -3.0, -2.0], [-4.0, -3.0, -2.0]], [[-5.0, -3.0, -2.5], [-4.0, -3.0, -2.0]]]
    curves = read_curves({"error_factor": "[1.0]", "error_curve": json.dumps(curve)})
    given = [-6.0, -4.0, -3.5, -3.0, -2.5, -2.0, 0.0]
    bent = np.log([errors(curves, lead, given) for lead in range(2)])
    np.testing.assert_allclose(bent[0], [-7.0, -5.0, -4.0, -3.0, -2.75, -2.5, -0.5], atol=1e-6)
    np.testing.assert_allclose(bent[1], given, atol=1e-6)


def test_factors_alone_do_and_the_last_serves_later_leads() -> None:
    curves = read_curves({"error_factor": "[2.0, 3.0]"})
    found = [errors(curves, lead, [0.0])[0] for lead in range(4)]
    np.testing.assert_allclose(found, [2, 3, 3, 3])


@each_case(
    ("factor", "curve"),
    [
        ("[]", "null"),
        ("[0.0]", "null"),
        ("[NaN]", "null"),
        ('["a"]', "null"),
        ("null", "null"),
        ("{}", "null"),
        ("[1.0", "null"),
        ("[1.0]", "[1.0]"),
        ("[1.0]", "[[[0.0]], [[0.0]]]"),
        ("[1.0]", "[[[0.0, 0.0]], [[0.0, 1.0]]]"),
        ("[1.0]", "[[[0.0, 1.0]], [[1.0, 0.0]]]"),
        ("[1.0]", "[[[0.0, 1e9]], [[0.0, 1.0]]]"),
        ("[1.0]", "[" * 20_000),
    ],
)
def test_nonsense_is_refused(factor: str, curve: str) -> None:
    with pytest.raises(ValueError):
        read_curves({"error_factor": factor, "error_curve": curve})
