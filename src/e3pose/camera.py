"""Cameras and rigs: where a world point lands in an image, and which ray a pixel looks along.

Conventions: world in metres, z up; camera frame x right, y down, z forward; pixel (0, 0) is the
centre of the top-left pixel. `T_world_camera` maps camera coordinates to world coordinates.
Distortion follows OpenCV: 0, 4 (k1 k2 p1 p2), 5 (+ k3) or 8 (+ k4 k5 k6) coefficients, or the four
of its fisheye model.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from e3pose.errors import InputError

Floats = NDArray[np.float64]

CAMERA_ID = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")
DISTORTION_LENGTHS = (0, 4, 5, 8)
NEWTON_STEPS = 30
UNDISTORT_TOLERANCE = 1e-9  # normalised image units; about 1e-6 px at a focal length of 1000 px


def check_camera_id(camera_id: str) -> str:
    """Return `camera_id` if it may name a camera, and therefore a file; raise `InputError` if not."""
    if not CAMERA_ID.fullmatch(camera_id):
        raise InputError(
            f"camera id {camera_id[:80]!r}: expected 1 to 64 letters, digits, '_', '-' or '.', "
            "not starting with '-' or '.'"
        )
    return camera_id


@dataclass(frozen=True, eq=False)
class Camera:
    """One calibrated camera.

    Attributes:
        camera_id: stable name, safe as a file name.
        image_size: `(width, height)` in pixels.
        K: `(3, 3)` intrinsic matrix in pixels.
        T_world_camera: `(4, 4)` camera-to-world transform, metres.
        distortion: `(0,)`, `(4,)`, `(5,)` or `(8,)` OpenCV coefficients; `(4,)` if `fisheye`.
        fisheye: whether `distortion` is OpenCV's fisheye (equidistant) model.

    Raises:
        InputError: naming the camera and the field that is wrong.
    """

    camera_id: str
    image_size: tuple[int, int]
    K: Floats
    T_world_camera: Floats
    distortion: Floats = field(default_factory=lambda: np.zeros(0))
    fisheye: bool = False

    def __post_init__(self) -> None:
        check_camera_id(self.camera_id)
        size = tuple(int(v) for v in self.image_size)
        object.__setattr__(self, "image_size", size)
        if len(size) != 2 or not all(1 <= v <= 100_000 for v in size):
            raise self._error("image size", f"{size}", "(width, height) in pixels")
        for name, shape in (("K", (3, 3)), ("T_world_camera", (4, 4))):
            matrix = np.array(getattr(self, name), dtype=np.float64)
            if matrix.shape != shape:
                raise self._error(name, f"shape {matrix.shape}", f"{shape}")
            if not np.isfinite(matrix).all():
                raise self._error(name, "a value that is not finite", "numbers")
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)
        distortion = np.array(self.distortion, dtype=np.float64).reshape(-1)
        lengths = (4,) if self.fisheye else DISTORTION_LENGTHS
        if len(distortion) not in lengths or not np.isfinite(distortion).all():
            raise self._error(
                "distortion",
                f"{distortion.tolist()}",
                f"{' or '.join(map(str, lengths))} finite coefficients",
            )
        distortion.flags.writeable = False
        object.__setattr__(self, "distortion", distortion)
        self._check_intrinsics()
        self._check_extrinsics()

    @classmethod
    def from_world_to_camera(
        cls,
        camera_id: str,
        image_size: tuple[int, int],
        K: ArrayLike,
        R: ArrayLike,
        t: ArrayLike,
        distortion: ArrayLike = (),
        fisheye: bool = False,
    ) -> Camera:
        """Make a camera from the textbook extrinsics `x_camera = R @ x_world + t` (metres)."""
        rotation = np.asarray(R, dtype=np.float64)
        translation = np.asarray(t, dtype=np.float64).reshape(-1)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise InputError(
                f"camera {camera_id}: rotation and translation have shapes {rotation.shape} and "
                f"{translation.shape}, expected (3, 3) and (3,)"
            )
        T_world_camera = np.eye(4)
        T_world_camera[:3, :3] = rotation.T
        T_world_camera[:3, 3] = -rotation.T @ translation
        return cls(
            camera_id,
            image_size,
            np.asarray(K, dtype=np.float64),
            T_world_camera,
            np.asarray(distortion, dtype=np.float64),
            fisheye,
        )

    @property
    def R(self) -> Floats:
        """`(3, 3)` world-to-camera rotation."""
        return self.T_world_camera[:3, :3].T

    @property
    def t(self) -> Floats:
        """`(3,)` world-to-camera translation in metres."""
        return -self.R @ self.center_m

    @property
    def center_m(self) -> Floats:
        """`(3,)` optical centre in the world."""
        return self.T_world_camera[:3, 3]

    @cached_property
    def projection(self) -> Floats:
        """`(3, 4)` pixel-from-world matrix of the undistorted image: the paper's P_n."""
        return self.K @ np.column_stack([self.R, self.t])

    def project(self, points_m: ArrayLike) -> Floats:
        """Project world points into the distorted image.

        Args:
            points_m: `(*batch, 3)` metres.

        Returns:
            `(*batch, 2)` pixels; NaN for a point behind the camera, beyond the angle at which the
            distortion model folds back, or NaN itself. Points outside the image keep their pixels.
        """
        points = np.asarray(points_m, dtype=np.float64)
        in_camera = points @ self.R.T + self.t
        depth = in_camera[..., 2]
        in_front = depth > 0
        normalised = in_camera[..., :2] / np.where(in_front, depth, np.nan)[..., None]
        return self._pixels(self._distort(normalised))

    def undistort(self, keypoints_px: ArrayLike) -> Floats:
        """Move pixels to where a camera without distortion, with the same `K`, would see them.

        Args:
            keypoints_px: `(*batch, 2)` pixels in the real image.

        Returns:
            `(*batch, 2)` pixels that `projection` explains; NaN where the model has no inverse.
        """
        pixels = np.asarray(keypoints_px, dtype=np.float64)
        if len(self.distortion) == 0:
            return pixels.copy()
        return self._pixels(self._invert(self._normalised(pixels)))

    def rays(self, keypoints_px: ArrayLike) -> Floats:
        """Return the `(*batch, 3)` unit world directions in which real pixels `(*batch, 2)` look."""
        normalised = self._invert(self._normalised(np.asarray(keypoints_px, dtype=np.float64)))
        directions = np.concatenate([normalised, np.ones_like(normalised[..., :1])], axis=-1)
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        return directions @ self.R

    def sees(self, points_m: ArrayLike) -> NDArray[np.bool_]:
        """Return `(*batch)`: whether world points `(*batch, 3)` fall inside the image, ignoring occlusion."""
        pixels = self.project(points_m)
        with np.errstate(invalid="ignore"):
            inside = (pixels >= -0.5) & (pixels < np.array(self.image_size) - 0.5)
        return np.asarray(inside.all(axis=-1))

    def _pixels(self, normalised: Floats) -> Floats:
        return normalised @ self.K[:2, :2].T + self.K[:2, 2]

    def _normalised(self, pixels: Floats) -> Floats:
        return (pixels - self.K[:2, 2]) @ np.linalg.inv(self.K[:2, :2]).T

    @cached_property
    def _radius_limit(self) -> float:
        """Undistorted radius (tangent of the angle off axis) up to which the model is one to one."""
        if self.fisheye or len(self.distortion) == 0:
            return np.inf
        radius = np.linspace(0.0, 20.0, 20_001)
        factor, slope = _radial(radius**2, self.distortion)
        folds = (factor + 2 * radius**2 * slope <= 0) | (factor <= 0)
        return float(radius[np.argmax(folds)]) if folds.any() else np.inf

    def _distort(self, normalised: Floats) -> Floats:
        if len(self.distortion) == 0:
            return normalised
        if self.fisheye:
            return _fisheye(normalised, self.distortion)
        radius2 = (normalised**2).sum(axis=-1, keepdims=True)
        return np.where(
            radius2 <= self._radius_limit**2, _brown(normalised, self.distortion)[0], np.nan
        )

    def _invert(self, distorted: Floats) -> Floats:
        if len(self.distortion) == 0:
            return distorted
        if self.fisheye:
            return _invert_fisheye(distorted, self.distortion)
        estimate = np.clip(distorted, -self._radius_limit, self._radius_limit)
        with np.errstate(all="ignore"):  # a pixel without an inverse may diverge; it becomes NaN
            for _ in range(NEWTON_STEPS):
                value, (xx, xy, yy) = _brown(estimate, self.distortion)
                error = distorted - value
                determinant = xx * yy - xy * xy
                step_x = (yy * error[..., 0] - xy * error[..., 1]) / determinant
                step_y = (xx * error[..., 1] - xy * error[..., 0]) / determinant
                estimate = estimate + np.stack([step_x, step_y], axis=-1)
                if not np.nanmax(np.abs(error), initial=0.0) > UNDISTORT_TOLERANCE * 1e-3:
                    break
            error = np.abs(self._distort(estimate) - distorted).max(axis=-1, keepdims=True)
            return np.where(error < UNDISTORT_TOLERANCE, estimate, np.nan)

    def _check_intrinsics(self) -> None:
        K = self.K
        if not (K[0, 0] > 0 and K[1, 1] > 0) or abs(np.linalg.det(K)) < 1e-9:
            raise self._error(
                "K", f"{K.tolist()}", "an invertible matrix with positive focal lengths"
            )
        if not np.allclose(K[2], (0, 0, 1)) or K[1, 0] != 0:
            raise self._error("K", f"{K.tolist()}", "[[fx, s, cx], [0, fy, cy], [0, 0, 1]]")
        if K[0, 0] < 0.05 * max(self.image_size):
            raise self._error(
                "K", f"focal length {K[0, 0]:g}", "pixels, not millimetres or a share of the image"
            )

    def _check_extrinsics(self) -> None:
        rotation = self.T_world_camera[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3):
            raise self._error("rotation", f"{rotation.round(4).tolist()}", "an orthonormal matrix")
        if np.linalg.det(rotation) < 0:
            raise self._error("rotation", "determinant -1 (a mirror)", "determinant +1")
        if not np.allclose(self.T_world_camera[3], (0, 0, 0, 1)):
            raise self._error(
                "T_world_camera", "a last row that is not 0 0 0 1", "a rigid transform"
            )
        if np.abs(self.center_m).max() > 1000:
            raise self._error(
                "translation",
                f"a centre {np.abs(self.center_m).max():.0f} m from the origin",
                "metres within 1 km; is the file in millimetres or centimetres?",
            )

    def _error(self, name: str, found: str, expected: str) -> InputError:
        return InputError(f"camera {self.camera_id}: {name}: found {found}, expected {expected}")


@dataclass(frozen=True, eq=False)
class Rig:
    """All cameras of a site, in one world frame; the order of `cameras` is the camera axis everywhere.

    Raises:
        InputError: when two cameras share an id or there is none.
    """

    cameras: tuple[Camera, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "cameras", tuple(self.cameras))
        ids = self.camera_ids
        if not ids:
            raise InputError("rig: found no camera, expected at least one")
        doubles = sorted({i for i in ids if ids.count(i) > 1})
        if doubles:
            raise InputError(f"rig: camera id {doubles[0]!r} appears twice, expected unique ids")

    def __len__(self) -> int:
        return len(self.cameras)

    @property
    def camera_ids(self) -> tuple[str, ...]:
        """Camera ids in camera-axis order."""
        return tuple(camera.camera_id for camera in self.cameras)

    def index(self, camera_id: str) -> int:
        """Return where `camera_id` stands on the camera axis; raise `InputError` if it is not in the rig."""
        try:
            return self.camera_ids.index(camera_id)
        except ValueError:
            known = ", ".join(self.camera_ids)
            raise InputError(f"camera {camera_id!r} is not in the rig, which has {known}") from None

    def subset(self, indices: Sequence[int]) -> Rig:
        """Return the rig of the cameras at `indices`, in that order."""
        return Rig(tuple(self.cameras[i] for i in indices))

    @cached_property
    def projections(self) -> Floats:
        """`(num_cameras, 3, 4)` pixel-from-world matrices of the undistorted images."""
        return np.stack([camera.projection for camera in self.cameras])

    @cached_property
    def centers_m(self) -> Floats:
        """`(num_cameras, 3)` optical centres in the world."""
        return np.stack([camera.center_m for camera in self.cameras])

    def project(self, points_m: ArrayLike) -> Floats:
        """Project `(*batch, 3)` world points into every camera: `(num_cameras, *batch, 2)` pixels."""
        return np.stack([camera.project(points_m) for camera in self.cameras])

    def fundamental(self, first: int, second: int) -> Floats:
        """Return `(3, 3)` F with `x_second^T F x_first = 0` for undistorted pixels of the same point."""
        a, b = self.cameras[first], self.cameras[second]
        rotation = b.R @ a.R.T
        translation = b.t - rotation @ a.t
        return np.linalg.inv(b.K).T @ _cross_matrix(translation) @ rotation @ np.linalg.inv(a.K)


def _cross_matrix(v: Floats) -> Floats:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def _radial(radius2: Floats, distortion: Floats) -> tuple[Floats, Floats]:
    """Return the radial factor and its derivative by the squared radius."""
    k = np.zeros(8)
    k[: len(distortion)] = distortion
    above = 1 + radius2 * (k[0] + radius2 * (k[1] + radius2 * k[4]))
    below = 1 + radius2 * (k[5] + radius2 * (k[6] + radius2 * k[7]))
    above_slope = k[0] + radius2 * (2 * k[1] + 3 * radius2 * k[4])
    below_slope = k[5] + radius2 * (2 * k[6] + 3 * radius2 * k[7])
    return above / below, (above_slope * below - above * below_slope) / below**2


def _brown(points: Floats, distortion: Floats) -> tuple[Floats, tuple[Floats, Floats, Floats]]:
    """Apply Brown's model to `(*batch, 2)`; also the entries xx, xy, yy of its symmetric Jacobian."""
    x, y = points[..., 0], points[..., 1]
    p1, p2 = distortion[2], distortion[3]
    radius2 = x * x + y * y
    factor, slope = _radial(radius2, distortion)
    distorted_x = x * factor + 2 * p1 * x * y + p2 * (radius2 + 2 * x * x)
    distorted_y = y * factor + p1 * (radius2 + 2 * y * y) + 2 * p2 * x * y
    xx = factor + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    yy = factor + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    return np.stack([distorted_x, distorted_y], axis=-1), (xx, xy, yy)


def _fisheye_angle(theta: Floats, k: Floats) -> Floats:
    t2 = theta**2
    return theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))


def _fisheye(points: Floats, k: Floats) -> Floats:
    radius = np.linalg.norm(points, axis=-1, keepdims=True)
    scale = _fisheye_angle(np.arctan(radius), k) / np.where(radius > 0, radius, 1.0)
    return points * np.where(radius > 0, scale, 1.0)


def _invert_fisheye(points: Floats, k: Floats) -> Floats:
    distorted = np.linalg.norm(points, axis=-1, keepdims=True)
    theta = np.clip(distorted, 0, np.pi / 2 - 1e-6)
    for _ in range(NEWTON_STEPS):
        t2 = theta**2
        slope = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
        theta = np.clip(theta - (_fisheye_angle(theta, k) - distorted) / slope, 0, np.pi / 2 - 1e-9)
    scale = np.tan(theta) / np.where(distorted > 0, distorted, 1.0)
    solved = np.abs(_fisheye_angle(theta, k) - distorted) < UNDISTORT_TOLERANCE
    return np.where(solved, points * np.where(distorted > 0, scale, 1.0), np.nan)
