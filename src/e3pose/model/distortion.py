"""Lens distortion and its inverse.

Points are normalised: `x / z` and `y / z` in the camera frame. The models are OpenCV's: Brown's
with 0, 4 (k1 k2 p1 p2), 5 (+ k3), 8 (+ k4 k5 k6), 12 (+ thin prism s1 to s4) or 14 (+ tilt of the
sensor, tau x and y) coefficients, and its fisheye (equidistant) model with four. Either folds back
beyond some angle off the axis; a point out there has no honest pixel and becomes NaN.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from e3pose.base.arrays import Floats

LENGTHS = (0, 4, 5, 8, 12, 14)
TOLERANCE = 1e-9  # normalised units; about 1e-6 px at a focal length of 1000 px
NEWTON_STEPS = 20
TABLE_SIZE = 512
WIDEST_ANGLE = np.pi / 2 - 1e-6  # a normalised point cannot lie at a right angle to the axis


@dataclass(frozen=True, eq=False)
class Distortion:
    """One lens.

    Attributes:
        coefficients: as many as one of `LENGTHS`, in OpenCV's order; `(4,)` if `fisheye`.
        fisheye: whether they are of OpenCV's fisheye model.
        known_to: angle off the axis, radians, up to which the lens was measured; None for all.
    """

    coefficients: Floats
    fisheye: bool = False
    known_to: float | None = None

    def distort(self, points: Floats) -> Floats:
        """Move ideal points `(*batch, 2)` to where the lens puts them; NaN beyond the fold."""
        if len(self.coefficients) == 0:
            return points
        radius = np.hypot(points[..., 0], points[..., 1])[..., None]
        if self.fisheye:
            moved = self._fisheye(points, radius)
        else:
            moved = _through(self.tilt, self._brown(points))
        return np.where(radius <= self.radius_limit, moved, np.nan)

    def undistort(self, points: Floats) -> Floats:
        """Move real points `(*batch, 2)` to the ideal plane; NaN where the model has no inverse."""
        if len(self.coefficients) == 0:
            return points
        with np.errstate(all="ignore"):  # what diverges is refused at the end
            given, points = points, _through(self.upright, points)
            radius = np.hypot(points[..., 0], points[..., 1])[..., None]
            distorted_radii, angles = self.table
            angle = np.interp(radius, distorted_radii, angles)
            if self.fisheye:
                angle = self._refine_angle(angle, radius)
            ratio = np.where(radius > 0, np.tan(angle) / np.where(radius > 0, radius, 1.0), 1.0)
            estimate = points * ratio
            if not self.fisheye:
                estimate = self._refine(estimate, points)
            error = np.abs(self.distort(estimate) - given).max(axis=-1, keepdims=True)
            # Towards 90 degrees the tangent magnifies rounding, hence the share of the radius.
            return np.where(error <= TOLERANCE * (1 + radius), estimate, np.nan)

    @cached_property
    def angle_limit(self) -> float:
        """Angle off the axis, in radians, up to which the model is one to one, and measured."""
        return min(self._fold, WIDEST_ANGLE if self.known_to is None else self.known_to)

    @property
    def _fold(self) -> float:
        k = self.padded
        if self.fisheye:
            slope = np.array([1, 3 * k[0], 5 * k[1], 7 * k[2], 9 * k[3]])
            return min(float(np.sqrt(_first_root(slope))), WIDEST_ANGLE)
        above = np.polynomial.Polynomial([1, k[0], k[1], k[4]])
        below = np.polynomial.Polynomial([1, k[5], k[6], k[7]])
        turn = np.polynomial.Polynomial([0, 2])  # d(r f(r^2))/dr = f + 2 r^2 f'
        slope = above * below + turn * (above.deriv() * below - above * below.deriv())
        squared = min(
            _first_root(np.asarray(p.coef, dtype=np.float64)) for p in (slope, above, below)
        )
        return min(float(np.arctan(np.sqrt(squared))), WIDEST_ANGLE)

    @cached_property
    def radius_limit(self) -> float:
        """Ideal radius (tangent of the angle) up to which the model is one to one."""
        return float(np.tan(self.angle_limit))

    @cached_property
    def padded(self) -> Floats:
        """`(14,)` coefficients, with zeros where the model has fewer."""
        padded = np.zeros(LENGTHS[-1])
        padded[: len(self.coefficients)] = self.coefficients
        return padded

    @cached_property
    def tilt(self) -> Floats:
        """`(3, 3)` homography from an upright sensor to the tilted one; identity without tilt."""
        (sin_x, sin_y), (cos_x, cos_y) = np.sin(self.padded[12:]), np.cos(self.padded[12:])
        about_x = np.array([[1, 0, 0], [0, cos_x, sin_x], [0, -sin_x, cos_x]])
        turn = np.array([[cos_y, 0, -sin_y], [0, 1, 0], [sin_y, 0, cos_y]]) @ about_x
        flat = [[turn[2, 2], 0, -turn[0, 2]], [0, turn[2, 2], -turn[1, 2]], [0, 0, 1]]
        return np.asarray(flat @ turn, dtype=np.float64)

    @cached_property
    def upright(self) -> Floats:
        """The inverse of `tilt`."""
        return np.asarray(np.linalg.inv(self.tilt), dtype=np.float64)

    @cached_property
    def table(self) -> tuple[Floats, Floats]:
        """Distorted radii and their angles, for first guesses; `_refine` adds tangential terms."""
        angles = np.linspace(0.0, self.angle_limit, TABLE_SIZE)
        if self.fisheye:
            radii = self._fisheye_radius(angles)
        else:
            radii = np.tan(angles) * self._radial(np.tan(angles) ** 2)[0]
        return np.maximum.accumulate(radii), angles

    def _radial(self, squared: Floats) -> tuple[Floats, Floats]:
        """Return Brown's radial factor and its derivative, both by the squared radius."""
        k1, k2, _, _, k3, k4, k5, k6 = self.padded[:8]
        above = 1 + squared * (k1 + squared * (k2 + squared * k3))
        above_slope = k1 + squared * (2 * k2 + 3 * squared * k3)
        if len(self.coefficients) < 8:
            return above, above_slope
        below = 1 + squared * (k4 + squared * (k5 + squared * k6))
        below_slope = k4 + squared * (2 * k5 + 3 * squared * k6)
        return above / below, (above_slope * below - above * below_slope) / below**2

    def _brown(self, points: Floats) -> Floats:
        x, y = points[..., 0], points[..., 1]
        p1, p2 = self.coefficients[2], self.coefficients[3]
        s1, s2, s3, s4 = self.padded[8:12]
        squared = x * x + y * y
        factor = self._radial(squared)[0]
        moved_x = x * factor + 2 * p1 * x * y + p2 * (squared + 2 * x * x)
        moved_y = y * factor + p1 * (squared + 2 * y * y) + 2 * p2 * x * y
        moved_x += squared * (s1 + s2 * squared)
        moved_y += squared * (s3 + s4 * squared)
        return np.stack([moved_x, moved_y], axis=-1)

    def _refine(self, estimate: Floats, target: Floats) -> Floats:
        """Solve `_brown(estimate) = target` by Newton's method."""
        p1, p2 = self.coefficients[2], self.coefficients[3]
        s1, s2, s3, s4 = self.padded[8:12]
        for _ in range(NEWTON_STEPS):
            error = target - self._brown(estimate)
            if not np.nanmax(np.abs(error), initial=0.0) > TOLERANCE * 1e-3:
                break
            x, y = estimate[..., 0], estimate[..., 1]
            squared = x * x + y * y
            factor, slope = self._radial(squared)
            prism_x, prism_y = 2 * (s1 + 2 * s2 * squared), 2 * (s3 + 2 * s4 * squared)
            both = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
            xx = factor + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x + prism_x * x
            yy = factor + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x + prism_y * y
            xy, yx = both + prism_x * y, both + prism_y * x
            determinant = xx * yy - xy * yx
            step_x = (yy * error[..., 0] - xy * error[..., 1]) / determinant
            step_y = (xx * error[..., 1] - yx * error[..., 0]) / determinant
            estimate = estimate + np.stack([step_x, step_y], axis=-1)
        return estimate

    def _fisheye_radius(self, angle: Floats) -> Floats:
        k1, k2, k3, k4 = self.coefficients
        squared = angle * angle
        factor = 1 + squared * (k1 + squared * (k2 + squared * (k3 + squared * k4)))
        return np.asarray(angle * factor, dtype=np.float64)

    def _fisheye(self, points: Floats, radius: Floats) -> Floats:
        ratio = self._fisheye_radius(np.arctan(radius)) / np.where(radius > 0, radius, 1.0)
        return np.where(radius > 0, points * ratio, points)

    def _refine_angle(self, angle: Floats, radius: Floats) -> Floats:
        k1, k2, k3, k4 = self.coefficients
        for _ in range(NEWTON_STEPS):
            error = radius - self._fisheye_radius(angle)
            if not np.nanmax(np.abs(error), initial=0.0) > TOLERANCE * 1e-3:
                break
            squared = angle * angle
            slope = 1 + squared * (
                3 * k1 + squared * (5 * k2 + squared * (7 * k3 + squared * 9 * k4))
            )
            angle = np.clip(angle + error / slope, 0.0, self.angle_limit)
        return angle


def _through(homography: Floats, points: Floats) -> Floats:
    """Return points `(*batch, 2)` through a homography; NaN for those behind the camera."""
    moved = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(moved[..., :2] / np.where(moved[..., 2:] > 0, moved[..., 2:], np.nan))


def _first_root(coefficients: Floats) -> float:
    """Return the smallest positive root of a polynomial `1 + c1 x + ...`; inf if there is none.

    Its reciprocals are the roots of the reversed polynomial, which leads with the one and so stays
    well conditioned however small the last coefficients are.
    """
    reciprocals = np.polynomial.polynomial.polyroots(coefficients[::-1])
    real = np.abs(reciprocals.imag) <= 1e-9 * np.abs(reciprocals)
    largest = float(reciprocals.real[real].max(initial=0.0))
    return 1 / largest if largest > 1e-300 else np.inf
