"""Validate the fields of a camera, with errors that name camera and field."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.distortion import LENGTHS
from e3pose.model.rotations import nearest_rotation

CAMERA_ID = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")
MAX_DISTANCE_M = 1000.0
MAX_COEFFICIENT = 1e6
MAX_TILT = 1.5  # radians, of a sensor against its lens
ROTATION_TOLERANCE = 1e-3  # a rotation printed with four digits is a rotation


def check_camera_id(camera_id: object) -> str:
    """Return `camera_id` if it may name a camera, and so a file; raise `InputError` if not."""
    if not isinstance(camera_id, str) or not CAMERA_ID.fullmatch(camera_id):
        wanted = "1 to 64 letters, digits, '_', '-' or '.', not starting with '-' or '.'"
        raise InputError("camera id", repr(str(camera_id)[:80]), wanted)
    return camera_id


def safe_id(name: str) -> str:
    """Return the camera id of a name such as `Cam 1` or `Küche`, which other tools allow.

    It is `cam` for a name in another script or of pictures, and the name itself where it holds no
    letter.
    """
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    safe = re.sub(r"[^A-Za-z0-9_.-]+", "_", plain.strip())[:64].lstrip("-.")
    if safe.strip("_"):
        return safe
    other = any(char.isalnum() or (char.isprintable() and not char.isascii()) for char in name)
    return "cam" if other else name


@dataclass(frozen=True, slots=True)
class CameraFields:
    """Check the fields of one camera; each method returns what the field becomes, read only.

    Attributes:
        camera_id: for errors.

    Raises:
        InputError: naming the camera and the field that is wrong.
    """

    camera_id: str

    def size(self, image_size: tuple[int, int]) -> tuple[int, int]:
        """Return `(width, height)` in pixels."""
        expected = "(width, height) in pixels, 1 to 100000"
        try:
            width, height = (int(v) for v in image_size)
        except (TypeError, ValueError, OverflowError):
            raise self._error("image size", f"{image_size!r:.60}", expected) from None
        if not (1 <= width <= 100_000 and 1 <= height <= 100_000):
            raise self._error("image size", f"{(width, height)!r:.60}", expected)
        return width, height

    def _matrix(self, name: str, value: ArrayLike, shape: tuple[int, ...]) -> Floats:
        try:
            matrix = np.array(value, dtype=np.float64)
        except (TypeError, ValueError):
            raise self._error(name, "something else", f"numbers of shape {shape}") from None
        if matrix.shape != shape:
            raise self._error(name, f"shape {matrix.shape}", f"{shape}")
        if not np.isfinite(matrix).all():
            raise self._error(name, "a value that is not finite", "numbers")
        matrix.flags.writeable = False
        return matrix

    def lens(self, distortion: ArrayLike, fisheye: bool) -> Floats:
        """Return OpenCV's coefficients, as many as the model has."""
        lengths = (4,) if fisheye else LENGTHS
        expected = f"{' or '.join(map(str, lengths))} coefficients"
        try:
            found = np.array(distortion, dtype=np.float64).reshape(-1)
        except (TypeError, ValueError):
            raise self._error("distortion", "something else", expected) from None
        if len(found) not in lengths:
            raise self._error("distortion", f"{len(found)} coefficients", expected)
        if not (np.abs(found) <= MAX_COEFFICIENT).all():
            raise self._error(
                "distortion", f"{found.tolist()}", f"numbers within {MAX_COEFFICIENT:g}"
            )
        if not (np.abs(found[12:]) < MAX_TILT).all():
            raise self._error("distortion", f"a tilt of {found[12:].tolist()}", "radians below 1.5")
        found.flags.writeable = False
        return found

    def intrinsics(self, matrix: ArrayLike, image_size: tuple[int, int]) -> Floats:
        """Return the `(3, 3)` matrix in pixels of an image of that size."""
        K = self._matrix("K", matrix, (3, 3))
        (fx, _, cx), (below, fy, cy), last = K
        if not (fx > 0 and fy > 0) or not np.isfinite(K).all():
            raise self._error(
                "K", f"{K.tolist()}", "an invertible matrix with positive focal lengths"
            )
        if below != 0 or last.tolist() != [0, 0, 1]:
            raise self._error("K", f"{K.tolist()}", "[[fx, s, cx], [0, fy, cy], [0, 0, 1]]")
        longest = max(image_size)
        if min(fx, fy) < 0.05 * longest or max(fx, fy) > 1000 * longest:
            raise self._error(
                "K",
                f"focal lengths {fx:g} and {fy:g} for an image of {longest} pixels",
                "pixels, not millimetres or a share of the image",
            )
        if np.abs(K[:2, 1:]).max() > 1000 * longest:
            raise self._error("K", f"principal point ({cx:g}, {cy:g})", "pixels near the image")
        return K

    def rigid(self, transform: ArrayLike) -> Floats:
        """Return the `(4, 4)` transform with the rotation nearest to the one it has."""
        T_world_camera = self._matrix("T_world_camera", transform, (4, 4))
        rotation, center = T_world_camera[:3, :3], T_world_camera[:3, 3]
        if np.abs(rotation).max() > 2 or not np.allclose(
            rotation @ rotation.T, np.eye(3), atol=ROTATION_TOLERANCE
        ):
            raise self._error("rotation", f"{rotation.tolist()}", "an orthonormal matrix")
        if np.linalg.det(rotation) < 0:
            raise self._error("rotation", "determinant -1 (a mirror)", "determinant +1")
        if T_world_camera[3].tolist() != [0, 0, 0, 1]:
            raise self._error(
                "T_world_camera", "a last row that is not 0 0 0 1", "a rigid transform"
            )
        if np.abs(center).max() > MAX_DISTANCE_M:
            raise self._error(
                "translation",
                f"a centre {np.abs(center).max():.4g} m from the origin",
                "metres within 1 km; is the file in millimetres or centimetres? "
                '(a TOML file can say so: [metadata] units = "mm")',
            )
        rigid = np.array(T_world_camera)
        rigid[:3, :3] = orthonormal(rotation)
        rigid.flags.writeable = False
        return rigid

    def _error(self, name: str, found: str, expected: str) -> InputError:
        return InputError(f"camera {self.camera_id}: {name}: found {found}, expected {expected}")


def orthonormal(matrix: Floats) -> Floats:
    """Return the rotation nearest to a `(3, 3)` matrix; an orthonormal one is returned as it is."""
    if np.abs(matrix @ matrix.T - np.eye(3)).max() < 1e-12:
        return matrix
    return nearest_rotation(matrix)
