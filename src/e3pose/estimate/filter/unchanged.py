"""Views of an unchanged image: evidence that people stand still, not of their place.

A camera whose image is the same as in its last look sends the keypoints of that look again, with
all of their errors. Such a keypoint is no second measurement of a place: however often it comes,
its error stays. What it tells is that the joint stands still. An image that is unchanged for a time
s hides a motion of `STILL_PX` at most, so it measures a velocity of zero in the image,

    J v = 0    with a standard deviation of    STILL_PX / s

The covariance of a place cannot fall below what the look itself left, and grows by little more than
`STILL_PX`, however often the camera looks. Existence, biases, noise and detection maps learn
nothing from it: nobody looked again.
"""

from __future__ import annotations

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.outliers import MEASURED_SIGMAS, ROBUST
from e3pose.estimate.filter.projected import USED_SCORE, projected_variance_px2
from e3pose.estimate.filter.scratch import Passes
from e3pose.model.pose import MOST_UNCHANGED_S
from e3pose.model.projection import MIN_DEPTH_M, shown_at

# tuned: px | first guess: what moves an edge of 20 grey levels across a third of a small pixel | by
#   the truth of `home`, `home-night` and `lab` half: 0.3 % less error; twice: 0.6 % more; no
#   velocity at all: 19 % more, 11 points more missed
STILL_PX = 4.0  # hidden by an unchanged image, in images of `model.noise.IMAGE_PX`


def pace_px(unchanged_s: float) -> float:
    """Return the standard deviation of a velocity of zero, pixels per second as `STILL_PX`."""
    return STILL_PX / min(unchanged_s, MOST_UNCHANGED_S)


@kernel
def pull_still(
    row: int,
    pace_px: float,
    state: Floats,
    covariance: Floats,
    projection: Floats,
    weights: Floats,
    first: bool,
    passes: Passes,
) -> None:
    """Add the information of one detection about each joint's velocity to `seen`.

    Args:
        row: of the detection in `weights`.
        pace_px: standard deviation of its velocities, pixels per second.
        state: `(num_joints, 6)` as predicted.
        covariance: `(num_joints, 6, 6)` of the prediction.
        projection: `(3, 4)`.
        weights: `(num_rows, num_joints)` scores.
        first: whether the prediction may still be off by more than what is hidden.
        passes: of its `seen`, the last nine entries are of the velocity.
    """
    places, moved, seen, measured = passes.places, passes.moved, passes.seen, passes.measured
    variance = pace_px * pace_px
    for joint in range(len(places)):
        if not weights[row, joint] > USED_SCORE:
            continue
        x, y, z = places[joint, 0], places[joint, 1], places[joint, 2]
        depth, _, _, ux, uy, uz, vx, vy, vz = shown_at(projection, x, y, z)
        if not depth > MIN_DEPTH_M:
            continue
        along, up, away = state[joint, 3], state[joint, 4], state[joint, 5]
        du = -(ux * along + uy * up + uz * away)  # of the prediction
        dv = -(vx * along + vy * up + vz * away)
        left_u = du - ux * moved[joint, 3] - uy * moved[joint, 4] - uz * moved[joint, 5]
        left_v = dv - vx * moved[joint, 3] - vy * moved[joint, 4] - vz * moved[joint, 5]
        expected = variance
        if first:
            expected += projected_variance_px2(covariance[joint, 3:, 3:], ux, uy, uz, vx, vy, vz)
        off = (left_u * left_u + left_v * left_v) / expected
        measured[joint] |= off < MEASURED_SIGMAS**2
        weight = 1.0 / ((1.0 + off * ROBUST) * variance)
        seen[joint, 9] += weight * (ux * ux + vx * vx)
        seen[joint, 10] += weight * (ux * uy + vx * vy)
        seen[joint, 11] += weight * (uy * uy + vy * vy)
        seen[joint, 12] += weight * (ux * uz + vx * vz)
        seen[joint, 13] += weight * (uy * uz + vy * vz)
        seen[joint, 14] += weight * (uz * uz + vz * vz)
        seen[joint, 15] += weight * (ux * du + vx * dv)
        seen[joint, 16] += weight * (uy * du + vy * dv)
        seen[joint, 17] += weight * (uz * du + vz * dv)
