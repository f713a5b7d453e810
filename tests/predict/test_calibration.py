"""Expected errors are bent as a curve per lead says, and nonsense is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

from e3pose.predict.calibration import Calibration


def test_between_points_logarithms_are_linear_and_beyond_ratios_hold() -> None:
    curve = [[[-4.0, -3.0, -2.0], [-4.0, -3.0, -2.0]], [[-5.0, -3.0, -2.5], [-4.0, -3.0, -2.0]]]
    calibration = Calibration({"error_factor": "[1.0]", "error_curve": json.dumps(curve)})
    given = np.array([-6.0, -4.0, -3.5, -3.0, -2.5, -2.0, 0.0], dtype=np.float32)
    bent = np.log(calibration(given[None, None].repeat(2, axis=0)))
    np.testing.assert_allclose(bent[0, 0], [-7.0, -5.0, -4.0, -3.0, -2.75, -2.5, -0.5], atol=1e-6)
    np.testing.assert_allclose(bent[1, 0], given, atol=1e-6)


def test_factors_alone_do_and_the_last_serves_later_leads() -> None:
    calibration = Calibration({"error_factor": "[2.0, 3.0]"})
    errors = calibration(np.zeros((4, 2, 5), dtype=np.float32))
    np.testing.assert_allclose(errors[:, 1, 3], [2, 3, 3, 3])
    assert calibration(np.zeros((4, 0, 5), dtype=np.float32)).shape == (4, 0, 5)


@pytest.mark.parametrize(
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
        Calibration({"error_factor": factor, "error_curve": curve})
