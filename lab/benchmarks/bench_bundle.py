"""Our bundle adjustment beside SciPy's `least_squares`: the minimum found, and seconds as a ratio.

    python lab/benchmarks/bench_bundle.py

Cameras in a ring see points with 2 px of noise, 5 % of them 60 px off; all start a little off.
SciPy gets the same residuals, with Cauchy's loss of each point, once with our derivatives as a
sparse matrix and once with differences by `jac_sparsity`, in one process, one after the other.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import coo_matrix

from e3pose.base.arrays import Floats
from e3pose.calibrate.bundle import AdjustOptions, adjust_points, linearise_points, observe
from e3pose.calibrate.least_squares import Linearised
from e3pose.calibrate.moved_cameras import Cameras, first_lenses
from e3pose.model.camera import Rig
from e3pose.simulate import DetectorSettings, SceneSettings, simulate

SIZES = ((4, 100), (5, 400), (8, 1000))  # cameras, points
SIGMA_PX, WILD_PX, WILD_SHARE = 2.0, 60.0, 0.05
CAMERA, POINT = 6, 3  # parameters of each


def left_jacobian(turn: Floats) -> Floats:
    """Return the derivative `(3, 3)` of a rotation by its vector, as a turn after it."""
    angle = np.linalg.norm(turn)
    cross = np.cross(np.eye(3), -turn)
    if angle < 1e-8:
        return np.asarray(np.eye(3) + cross / 2)
    first, second = (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


class Problem:
    """The residuals of cameras, without the first, and of points, as SciPy wants them."""

    def __init__(
        self, rig: Rig, points_m: Floats, pixels: Floats, sigma_px: Floats, outlier: float
    ) -> None:
        seen = observe(first_lenses(rig), pixels[:, :, None], sigma_px[:, :, None])
        self.seen, self.start, self.points_m, self.outlier = (
            seen,
            Cameras.of(rig),
            points_m,
            outlier,
        )
        self.there = seen.seen[:, :, 0]
        self.cameras, self.blocks = np.nonzero(self.there)
        self.moving = CAMERA * (len(rig.cameras) - 1)
        self.size = self.moving + POINT * len(points_m)

    def linearise(self, x: Floats) -> Linearised:
        steps = np.zeros((len(self.start.translations), 10))
        steps[1:, :CAMERA] = x[: self.moving].reshape(-1, CAMERA)
        moved = self.start.moved(steps), self.points_m + x[self.moving :].reshape(-1, POINT)
        return linearise_points(*moved, self.seen)

    def residuals(self, x: Floats) -> Floats:
        r = self.linearise(x).residuals[:, :, 0][self.there]
        return np.asarray((r * self.shrink(r)[0][:, None]).ravel())

    def shrink(self, r: Floats) -> tuple[Floats, Floats]:
        """Return by how much Cauchy's loss shrinks `(n, 2)` residuals, and its derivative."""
        squares = np.maximum((r**2).sum(axis=-1) / self.outlier**2, 1e-12)
        factor = np.sqrt(np.log1p(squares) / squares)
        slope = (1 / (1 + squares) - factor**2) / squares / (2 * factor)
        return factor, 2 / self.outlier**2 * slope

    def jacobian(self, x: Floats) -> Any:
        system = self.linearise(x)
        r = system.residuals[:, :, 0][self.there]
        factor, slope = self.shrink(r)
        shrunk = factor[:, None, None] * np.eye(2)
        shrunk += slope[:, None, None] * r[:, :, None] * r[:, None, :]
        by_camera = shrunk @ system.by_camera[:, :, 0, :, :CAMERA][self.there]
        by_point = shrunk @ system.by_block[:, :, 0][self.there]
        steps = x[: self.moving].reshape(-1, CAMERA)
        turns = np.array([np.eye(3), *(left_jacobian(step[:3]) for step in steps)])
        by_camera[..., :3] = by_camera[..., :3] @ turns[self.cameras]
        by_camera[self.cameras == 0] = 0.0
        first = np.maximum(CAMERA * (self.cameras - 1), 0)
        columns = np.concatenate(
            [
                first[:, None] + np.arange(CAMERA),
                self.moving + POINT * self.blocks[:, None] + np.arange(POINT),
            ],
            axis=1,
        )
        values = np.concatenate([by_camera, by_point], axis=-1)  # (n, 2, 9)
        rows = np.arange(2 * len(r)).reshape(-1, 2)
        shape = (2 * len(r), self.size)
        places = (np.broadcast_to(each, values.shape).ravel()
                  for each in (rows[:, :, None], columns[:, None]))  # fmt: skip
        return coo_matrix((values.ravel(), tuple(places)), shape=shape).tocsr()


def timed(what: Callable[[], Any]) -> tuple[float, Any]:
    begin = time.perf_counter()
    found = what()
    return time.perf_counter() - begin, found


def compare(cameras: int, points: int, outlier: float) -> None:
    perfect = DetectorSettings(perfect=True)
    scene = SceneSettings(people=3, seconds=8.0, fps=20.0, cameras=cameras, detector=perfect)
    recording = simulate(scene, 0)
    assert recording.truth is not None
    rng, rig = np.random.default_rng(0), recording.rig
    truth_m = recording.truth.joints_m.reshape(-1, 3)
    truth_m = rng.choice(truth_m[np.isfinite(truth_m).all(axis=1)], points, replace=False)
    pixels = np.stack([camera.project(truth_m) for camera in rig.cameras])
    pixels += SIGMA_PX * rng.normal(size=pixels.shape)
    wild = rng.random(pixels.shape[:2]) < WILD_SHARE
    pixels[wild] += WILD_PX * rng.normal(size=(int(wild.sum()), 2))
    sigma_px = np.full(pixels.shape[:2], SIGMA_PX)
    steps = np.zeros((cameras, 10))
    steps[1:, :CAMERA] = rng.normal(size=(cameras - 1, CAMERA)) * [*[0.03] * 3, *[0.05] * 3]
    begin, off_m = (
        Cameras.of(rig).moved(steps).rig(rig),
        truth_m + rng.normal(size=truth_m.shape) / 10,
    )
    ours_s, ours = timed(
        lambda: adjust_points(begin, off_m, pixels, sigma_px, AdjustOptions(outlier))
    )
    squares = (np.nan_to_num(ours.residuals) ** 2).sum(axis=-1) / outlier**2
    print(f"{cameras} cameras, {points} points, outliers at {outlier:g} sigma")
    print(f"  ours          cost {outlier**2 * np.log1p(squares).sum() / 2:12.3f}")
    problem = Problem(begin, off_m, pixels, sigma_px, outlier)
    nothing = np.zeros(problem.size)
    pattern = problem.jacobian(nothing) != 0
    for name, given in (
        ("derivatives", {"jac": problem.jacobian, "x_scale": "jac"}),
        ("jac_sparsity", {"jac_sparsity": pattern}),
    ):
        solver = partial(least_squares, problem.residuals, nothing, ftol=1e-7, max_nfev=60)
        their_s, theirs = timed(partial(solver, **given))
        ratio = f"{their_s / ours_s:.1f} times our seconds, {theirs.nfev} evaluations"
        print(f"  {name:13} cost {theirs.cost:12.3f}  {ratio}", flush=True)


def main() -> None:
    for cameras, points in SIZES:
        for outlier in (1e6, 3.0):
            compare(cameras, points, outlier)


if __name__ == "__main__":
    main()
