"""Cameras and rigs: projection of world points into images, and rays of pixels.

Conventions: world in metres, z up; camera frame x right, y down, z forward; pixel (0, 0) is the
centre of the top-left pixel. `T_world_camera` maps camera coordinates to world coordinates.
Distortion follows OpenCV (`distortion.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.camera_fields import (
    ROTATION_TOLERANCE,
    CameraFields,
    check_camera_id,
    orthonormal,
)
from e3pose.model.distortion import Distortion
from e3pose.model.rotations import cross_matrices

MIN_DEPTH_M = 1e-6  # nearer than this a point is as good as inside the lens


@dataclass(frozen=True, eq=False)
class Camera:
    """One calibrated camera.

    Attributes:
        camera_id: stable name, safe as a file name.
        image_size: `(width, height)` in pixels.
        K: `(3, 3)` intrinsic matrix in pixels.
        T_world_camera: `(4, 4)` camera-to-world transform, metres.
        distortion: OpenCV's coefficients, 0, 4, 5, 8, 12 or 14; `(4,)` if `fisheye`.
        fisheye: whether `distortion` is OpenCV's fisheye (equidistant) model.
        lens_assumed: whether `K` is a guess from the image size, and the lens unknown.
        known_to: angle off the axis, radians, up to which a lens with distortion was measured:
            nothing is placed or seen beyond; None for all of the image.
        title: what people call it, such as `Küche`; its id if empty.

    Raises:
        InputError: naming the camera and the field that is wrong.
    """

    camera_id: str
    image_size: tuple[int, int]
    K: Floats
    T_world_camera: Floats
    distortion: Floats = field(default_factory=lambda: np.zeros(0))
    fisheye: bool = False
    lens_assumed: bool = False
    known_to: float | None = None
    title: str = ""

    def __post_init__(self) -> None:
        known = CameraFields(check_camera_id(self.camera_id))
        image_size = known.size(self.image_size)
        object.__setattr__(self, "image_size", image_size)
        object.__setattr__(self, "K", known.intrinsics(self.K, image_size))
        object.__setattr__(self, "T_world_camera", known.rigid(self.T_world_camera))
        object.__setattr__(self, "distortion", known.lens(self.distortion, self.fisheye))
        if self.known_to is not None and not 0 < self.known_to < np.pi:
            raise InputError(
                f"camera {self.camera_id}: known_to: found {self.known_to:g}, expected more than 0 "
                "and less than pi radians"
            )

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
        """Make a camera from textbook extrinsics `x_camera = R @ x_world + t`.

        Args:
            camera_id: its id.
            image_size: `(width, height)` pixels.
            K: `(3, 3)` intrinsics, pixels.
            R: `(3, 3)` world to camera; made orthonormal if nearly so.
            t: `(3,)` world to camera, metres.
            distortion: OpenCV coefficients of the lens model.
            fisheye: whether they are those of OpenCV's fisheye model.

        Raises:
            InputError: naming camera and field, for a field of another shape or out of range.
        """
        rotation = np.asarray(R, dtype=np.float64)
        translation = np.asarray(t, dtype=np.float64).reshape(-1)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise InputError(
                f"camera {camera_id}: rotation and translation have shapes {rotation.shape} and "
                f"{translation.shape}, expected (3, 3) and (3,)"
            )
        if not np.isfinite(rotation).all():
            raise InputError(
                f"camera {camera_id}: rotation: found a value that is not finite, expected numbers"
            )
        T_world_camera = np.eye(4)
        with np.errstate(over="ignore", invalid="ignore"):  # absurd numbers are refused below
            if np.allclose(rotation @ rotation.T, np.eye(3), atol=ROTATION_TOLERANCE):
                rotation = orthonormal(rotation)
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

    @cached_property
    def R(self) -> Floats:
        """`(3, 3)` world-to-camera rotation."""
        rotation: Floats = self.T_world_camera[:3, :3].T
        return rotation

    @cached_property
    def t(self) -> Floats:
        """`(3,)` world-to-camera translation in metres."""
        return np.asarray(-self.R @ self.center_m, dtype=np.float64)

    @property
    def center_m(self) -> Floats:
        """`(3,)` optical centre in the world."""
        return self.T_world_camera[:3, 3]

    @cached_property
    def projection(self) -> Floats:
        """`(3, 4)` pixel-from-world matrix of the undistorted image: the paper's P_n."""
        return np.asarray(self.K @ np.column_stack([self.R, self.t]), dtype=np.float64)

    @cached_property
    def lens(self) -> Distortion:
        """The distortion model, on normalised points."""
        return Distortion(self.distortion, self.fisheye, self.known_to)

    def project(self, points_m: ArrayLike) -> Floats:
        """Project world points into the distorted image.

        Args:
            points_m: `(*batch, 3)` metres.

        Returns:
            `(*batch, 2)` pixels; NaN for a point behind the camera, beyond the angle at which the
            distortion model folds back, or NaN itself. Points outside the image keep their pixels.
        """
        points = np.asarray(points_m, dtype=np.float64)
        with np.errstate(over="ignore", invalid="ignore"):  # absurdly far points become NaN
            in_camera = points @ self.R.T + self.t
            depth = np.where(in_camera[..., 2:] >= MIN_DEPTH_M, in_camera[..., 2:], np.nan)
            pixels = self._pixels(self.lens.distort(in_camera[..., :2] / depth))
            return np.where(np.isfinite(pixels).all(axis=-1, keepdims=True), pixels, np.nan)

    def undistort(self, keypoints_px: ArrayLike) -> Floats:
        """Move pixels to where a camera without distortion, with the same `K`, would see them.

        Args:
            keypoints_px: `(*batch, 2)` pixels in the real image.

        Returns:
            `(*batch, 2)` pixels that `projection` explains; NaN where the model has no inverse.
        """
        pixels = np.asarray(keypoints_px, dtype=np.float64)
        if len(self.distortion) == 0:
            return np.array(pixels)
        return self._pixels(self.lens.undistort(self._normalised(pixels)))

    def normalise(self, keypoints_px: ArrayLike) -> Floats:
        """Return where real pixels lie in the ideal image plane at unit distance.

        Args:
            keypoints_px: `(*batch, 2)` pixels in the real image.

        Returns:
            `(*batch, 2)`, x / z and y / z in the camera frame; NaN where the model has no inverse.
        """
        return self.lens.undistort(self._normalised(np.asarray(keypoints_px, dtype=np.float64)))

    def rays(self, keypoints_px: ArrayLike) -> Floats:
        """Return the unit world directions in which real pixels look.

        Args:
            keypoints_px: `(*batch, 2)` pixels in the real image.

        Returns:
            `(*batch, 3)`; NaN where the model has no inverse.
        """
        pixels = np.asarray(keypoints_px, dtype=np.float64)
        normalised = self.lens.undistort(self._normalised(pixels))
        directions = np.concatenate([normalised, np.ones_like(normalised[..., :1])], axis=-1)
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.asarray(directions @ self.R, dtype=np.float64)

    def sees(self, points_m: ArrayLike) -> NDArray[np.bool_]:
        """Return whether world points fall inside the image, whatever may stand in the way.

        Args:
            points_m: `(*batch, 3)` metres.

        Returns:
            `(*batch,)`; False for NaN.
        """
        pixels = self.project(points_m)
        inside = (pixels >= -0.5) & (pixels < np.array(self.image_size) - 0.5)
        return np.asarray(inside.all(axis=-1))

    def _pixels(self, normalised: Floats) -> Floats:
        return np.asarray(normalised @ self.K[:2, :2].T + self.K[:2, 2], dtype=np.float64)

    def _normalised(self, pixels: Floats) -> Floats:
        fx, skew, fy = self.K[0, 0], self.K[0, 1], self.K[1, 1]
        y = (pixels[..., 1] - self.K[1, 2]) / fy
        x = (pixels[..., 0] - self.K[0, 2] - skew * y) / fx
        return np.stack([x, y], axis=-1)


@dataclass(frozen=True, eq=False)
class Rig:
    """All cameras of a site, in one world frame; their order is the camera axis everywhere.

    Attributes:
        cameras: the cameras.
        placed: whether it is known where they all stand; if not, their extrinsics mean nothing.
        unplaced: ids of those that have no place where the others do; else empty.

    Raises:
        InputError: when two cameras share an id or there is none.
    """

    cameras: tuple[Camera, ...]
    placed: bool = True
    unplaced: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "cameras", tuple(self.cameras))
        if self.unplaced:
            object.__setattr__(self, "placed", False)
            if len(self.unplaced) == len(self.cameras):
                object.__setattr__(self, "unplaced", ())
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

    @property
    def titles(self) -> dict[str, str]:
        """The title of each camera, by its id; with the id where two share a title."""
        titles = [camera.title or camera.camera_id for camera in self.cameras]
        return {
            name: title if titles.count(title) == 1 else f"{title} ({name})"
            for name, title in zip(self.camera_ids, titles, strict=True)
        }

    def index(self, camera_id: str) -> int:
        """Return where `camera_id` stands on the camera axis; raise `InputError` if nowhere."""
        try:
            return self.camera_ids.index(camera_id)
        except ValueError:
            known = ", ".join(self.camera_ids)
            raise InputError(
                "camera", f"{camera_id!r}, which is not in the rig", f"one of {known}"
            ) from None

    def subset(self, indices: Sequence[int]) -> Rig:
        """Return the rig of the cameras at `indices`, in that order."""
        cameras = tuple(self.cameras[i] for i in indices)
        left = tuple(c.camera_id for c in cameras if c.camera_id in self.unplaced)
        return Rig(cameras, self.placed or bool(self.unplaced and not left), left)

    @property
    def placed_ones(self) -> list[int]:
        """Indices of the cameras that have a place."""
        known = self.placed or bool(self.unplaced)
        return [i for i, c in enumerate(self.camera_ids) if known and c not in self.unplaced]

    @cached_property
    def projections(self) -> Floats:
        """`(num_cameras, 3, 4)` pixel-from-world matrices of the undistorted images."""
        return np.stack([camera.projection for camera in self.cameras])

    @cached_property
    def centers_m(self) -> Floats:
        """`(num_cameras, 3)` optical centres in the world."""
        return np.stack([camera.center_m for camera in self.cameras])

    @cached_property
    def ray_matrices(self) -> Floats:
        """`(num_cameras, 3, 3)` undistorted homogeneous pixels to world directions."""
        return np.stack([camera.R.T @ np.linalg.inv(camera.K) for camera in self.cameras])

    def project(self, points_m: ArrayLike) -> Floats:
        """Project `(*batch, 3)` points into every camera: `(num_cameras, *batch, 2)` pixels.

        Missing is what `Camera.project` calls so.
        """
        points = np.asarray(points_m, dtype=np.float64)
        flat = points.reshape(-1, 3)
        with np.errstate(over="ignore", invalid="ignore"):  # absurdly far points become NaN
            in_camera = flat @ self._rotations.transpose(0, 2, 1) + self._translations
            depth = np.where(in_camera[..., 2:] >= MIN_DEPTH_M, in_camera[..., 2:], np.nan)
            ideal = in_camera[..., :2] / depth
            for camera, moved in zip(self.cameras, ideal, strict=True):
                if len(camera.distortion):
                    moved[:] = camera.lens.distort(moved)
            pixels = ideal @ self._focal.transpose(0, 2, 1) + self._principal
            pixels[~np.isfinite(pixels).all(axis=-1)] = np.nan
        return np.asarray(pixels.reshape(len(self), *points.shape[:-1], 2))

    @cached_property
    def image_sizes(self) -> Floats:
        """`(num_cameras, 2)` width and height in pixels."""
        return np.array([camera.image_size for camera in self.cameras], dtype=np.float64)

    @cached_property
    def _rotations(self) -> Floats:
        return np.stack([camera.R for camera in self.cameras])

    @cached_property
    def _translations(self) -> Floats:
        return np.stack([camera.t for camera in self.cameras])[:, None]

    @cached_property
    def _focal(self) -> Floats:
        return np.stack([camera.K[:2, :2] for camera in self.cameras])

    @cached_property
    def _principal(self) -> Floats:
        return np.stack([camera.K[:2, 2] for camera in self.cameras])[:, None]

    def fundamental(self, first: int, second: int) -> Floats:
        """Return `(3, 3)` F: `x_second^T F x_first = 0` for undistorted pixels of one point."""
        a, b = self.cameras[first], self.cameras[second]
        rotation = b.R @ a.R.T
        translation = b.t - rotation @ a.t
        essential = cross_matrices(translation) @ rotation
        return np.asarray(np.linalg.inv(b.K).T @ essential @ np.linalg.inv(a.K), dtype=np.float64)
