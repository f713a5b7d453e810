"""One backward step of the Rauch-Tung-Striebel smoother (1965).

With m, P what is known of slot k from views up to it, and m', P' what that makes one expect of the
slot after,

    K = cov(x_k, x_k+1) P'^-1,    m_k <- m + K (m_k+1 - m'),    P_k <- P + K (P_k+1 - P') K'

exactly, as long as motion and views are linear and Gaussian.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """The prediction of a slot for the next one, `num` values at a time.

    Attributes:
        mean: `(*batch, num, num_axes)` of the slot after; axes share their covariance.
        covariance: `(*batch, num, num)` of it.
        gain: `(*batch, num, num)` K above.
    """

    mean: Floats
    covariance: Floats
    gain: Floats


def expect(mean: Floats, covariance: Floats, across: Floats) -> Expected:
    """Return the prediction for the next slot, with its gain K.

    Args:
        mean: `(*batch, num, num_axes)`.
        covariance: `(*batch, num, num)` of it.
        across: `(*batch, num, num)` covariance of the slot before with it.
    """
    solved = np.linalg.solve(covariance, np.swapaxes(across, -1, -2))
    return Expected(mean, covariance, np.asarray(np.swapaxes(solved, -1, -2)))


def step_back(
    mean: Floats,
    covariance: Floats,
    expected: Expected,
    later: Floats,
    later_covariance: Floats,
) -> tuple[Floats, Floats]:
    """Return mean and covariance of a slot given all later ones.

    Args:
        mean: `(*batch, num, num_axes)` from views up to the slot.
        covariance: `(*batch, num, num)` likewise.
        expected: of the slot after, from these.
        later: `(*batch, num, num_axes)` mean of the slot after from all views.
        later_covariance: `(*batch, num, num)` of that.
    """
    K = expected.gain
    less = K @ (later_covariance - expected.covariance) @ np.swapaxes(K, -1, -2)
    return mean + K @ (later - expected.mean), covariance + less
