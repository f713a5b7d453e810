"""The distance of a person in a single view.

One camera shows how far away a person is by the lengths of bones alone. The errors of these lengths
and of the size that the detector sees are the same in every slot, so many views say no more than
one. A filter that takes them for independent becomes sure of a wrong distance, does not recognise
the person in the next camera and sees no need for one. So the update of a slot with a single view
is discounted along the line of sight, in one dimension and for the whole body at once.
"""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.bias import MemoryTerms
from e3pose.estimate.filter.scratch import Constants, Passes, Tracks, Views
from e3pose.estimate.filter.update import update

# tuned: share of the distance | lab/experiments/2026-11-23-one-camera.md | lone view
SIZE_SHARE = 0.02  # standard deviation of a person's size as one camera shows it: of the distance
NEAREST_M = 1e-3  # numerics


@kernel
def update_by_views(
    track: int,
    dt: float,
    constants: Constants,
    views: Views,
    assigned: Integers,
    tracks: Tracks,
    passes: Passes,
) -> None:
    """Update a track; the distance that a single view implies counts as an error that repeats.

    Arguments are those of `update`. Method: `docs/explanation/estimator.md`; figures:
    `lab/experiments/2026-11-23-one-camera.md`.
    """
    alone, shown = -1, 0
    for camera in range(len(views.counts)):
        if views.arrived[camera] and assigned[camera, track] >= 0:
            alone = camera
            shown += 1
    if shown != 1:
        update(track, dt, constants, views, assigned, tracks, passes)
        return
    root = constants.order[0]
    state, covariance = tracks.state[track], tracks.covariance[track]
    axes, old, new, moved_m = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.zeros(3)
    far_m = _axes_of(state[root], constants.centers_m[alone], axes)
    _turn(covariance[root], axes, old)
    per_s = _between(covariance[root], axes[0], axes[0], 3) / old[0, 0]
    for axis in range(3):
        for a in range(3):
            moved_m[axis] -= axes[axis, a] * state[root, a]
    size_variance = update(track, dt, constants, views, assigned, tracks, passes)
    _turn(covariance[root], axes, new)
    for axis in range(3):
        for a in range(3):
            moved_m[axis] += axes[axis, a] * state[root, a]
    repeated_m2 = (SIZE_SHARE**2 + size_variance) * far_m**2
    back_m, wider_m2 = _discount(old, new, moved_m, repeated_m2, dt, constants.memory)
    if wider_m2 > 0.0:
        _move(
            back_m,
            wider_m2,
            per_s,
            constants.centers_m[alone],
            constants.parents,
            state,
            covariance,
            tracks.shared[track],
        )


@kernel
def _discount(
    old: Floats, new: Floats, moved_m: Floats, repeated_m2: float, dt: float, terms: MemoryTerms
) -> tuple[float, float]:
    """Return how far a root must move back from the camera, and the variance that it must gain.

    Args:
        old: `(3, 3)` covariance before the view, on the axes of `_axes_of`.
        new: `(3, 3)` the same after it.
        moved_m: `(3,)` by how much the view moved the root, on these axes.
        repeated_m2: variance of the distance by the size of the person, the same in every view.
        dt: seconds since the slot before.
        terms: how long the detector's errors last.
    """
    # Where the old uncertainty is oblique to the line of sight, the place in the image constrains
    # the distance as well, without any size.
    area = old[1, 1] * old[2, 2] - old[1, 2] ** 2
    right = (old[0, 1] * old[2, 2] - old[0, 2] * old[1, 2]) / area
    up = (old[0, 2] * old[1, 1] - old[0, 1] * old[1, 2]) / area
    before = old[0, 0] - right * right * (old[1, 1] - new[1, 1])
    before -= 2.0 * right * up * (old[1, 2] - new[1, 2]) + up * up * (old[2, 2] - new[2, 2])
    after = new[0, 0]
    if not 0.0 < after < before:
        return 0.0, 0.0
    gained, counted = 1.0 / after - 1.0 / before, 0.0
    if dt > 0.0:
        counted = 1.0 / (1.0 / gained + repeated_m2 / math.tanh(dt / (2.0 * terms.lasting_s)))
    honest = 1.0 / (1.0 / before + counted)
    by_size_m = moved_m[0] - right * moved_m[1] - up * moved_m[2]
    return by_size_m * (honest * counted / (after * gained) - 1.0), honest - after


@kernel
def _axes_of(root: Floats, centre: Floats, axes: Floats) -> float:
    """Fill the rows of `axes`: away from a camera, to its right and up; return the distance."""
    far_m = _line_of(root, centre, axes[0])
    flat = math.sqrt(axes[0, 0] ** 2 + axes[0, 1] ** 2)
    if flat > 1e-6:
        axes[1, 0], axes[1, 1], axes[1, 2] = axes[0, 1] / flat, -axes[0, 0] / flat, 0.0
    else:  # straight below the camera
        axes[1, 0], axes[1, 1], axes[1, 2] = 1.0, 0.0, 0.0
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        axes[2, a] = axes[1, b] * axes[0, c] - axes[1, c] * axes[0, b]
    return far_m


@kernel
def _line_of(place: Floats, centre: Floats, line: Floats) -> float:
    """Fill `line` with the unit vector from a camera to a place; return the distance."""
    far_m = 0.0
    for axis in range(3):
        line[axis] = place[axis] - centre[axis]
        far_m += line[axis] ** 2
    far_m = max(math.sqrt(far_m), NEAREST_M)
    for axis in range(3):
        line[axis] /= far_m
    return far_m


@kernel
def _turn(block: Floats, axes: Floats, turned: Floats) -> None:
    """Fill `turned` `(3, 3)` with the covariance of a position on other axes."""
    for a in range(3):
        for b in range(3):
            turned[a, b] = _between(block, axes[a], axes[b], 0)


@kernel
def _between(block: Floats, first: Floats, second: Floats, offset: int) -> float:
    """Return the covariance of positions along two axes; of a position and a speed at 3."""
    total = 0.0
    for a in range(3):
        for b in range(3):
            total += first[a] * second[b] * block[a, b + offset]
    return total


@kernel
def _move(
    moved_m: float,
    wider_m2: float,
    per_s: float,
    centre: Floats,
    parents: Integers,
    state: Floats,
    covariance: Floats,
    shared: Floats,
) -> None:
    """Move a whole body along a camera's rays and scale its covariance.

    `per_s` is by how much its speed along the line of sight changes with its distance.
    """
    lines = np.empty((len(state), 3))
    for joint in range(len(state)):
        _line_of(state[joint], centre, lines[joint])
        for axis in range(3):
            state[joint, axis] += moved_m * lines[joint, axis]
            state[joint, axis + 3] += per_s * moved_m * lines[joint, axis]
    for joint in range(len(state)):
        _widen(wider_m2, per_s, lines[joint], lines[joint], covariance[joint])
        if parents[joint] >= 0:
            _widen(wider_m2, per_s, lines[joint], lines[parents[joint]], shared[joint])


@kernel
def _widen(wider_m2: float, per_s: float, first: Floats, second: Floats, block: Floats) -> None:
    for a in range(3):
        for b in range(3):
            wider = wider_m2 * first[a] * second[b]
            block[a, b] += wider
            block[a, b + 3] += wider * per_s
            block[a + 3, b] += wider * per_s
            block[a + 3, b + 3] += wider * per_s * per_s
