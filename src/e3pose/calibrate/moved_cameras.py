"""The cameras of a rig as an adjustment moves them: extrinsics, and lenses that are not known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.model.rotations import angles_between, similarity
from e3pose.recording.calibration.world import ASSUMED_FOCAL, assumed_rig

POSE, LENS = slice(0, 6), slice(6, 10)
NUM_LENS = 4  # log of the focal length, radial distortion k1, principal point in focal lengths
FOCAL_WIDTHS = (0.4, 3.0)  # of the longer side of the image: what a lens may have
LEAST_LENS = np.array([np.log(FOCAL_WIDTHS[0] / ASSUMED_FOCAL), -0.6, -0.3, -0.3])
MOST_LENS = np.array([np.log(FOCAL_WIDTHS[1] / ASSUMED_FOCAL), 0.6, 0.3, 0.3])
NUM_PARAMETERS = 6 + NUM_LENS  # of a camera: rotation, translation, lens


class Diverged(InputError):
    """A camera went where none can be, such as a kilometre away: this way leads to no rig."""


@dataclass(frozen=True, slots=True, eq=False)
class Cameras:
    """Extrinsics and lenses of a rig, as they are adjusted.

    Attributes:
        rotations: `(num_cameras, 3, 3)` world to camera.
        translations: `(num_cameras, 3)` world to camera, metres.
        lenses: `(num_cameras, 4)` log of the factor on the focal length that the rig states,
            radial distortion k1, and shift of the principal point in the rig's focal lengths.
    """

    rotations: Floats
    translations: Floats
    lenses: Floats

    @classmethod
    def of(cls, rig: Rig) -> Cameras:
        """Take those of a rig; lenses that are assumed are relative to `first_lenses`."""
        return cls(
            np.stack([camera.R for camera in rig.cameras]),
            np.stack([camera.t for camera in rig.cameras]),
            np.stack([
                _lens(camera, first)
                for camera, first in zip(rig.cameras, first_lenses(rig).cameras, strict=True)
            ]),
        )  # fmt: skip

    def moved(self, steps: Floats) -> Cameras:
        """Return them moved by `(num_cameras, 10)`."""
        return Cameras(
            Rotation.from_rotvec(steps[:, :3]).as_matrix() @ self.rotations,
            self.translations + steps[:, 3:6],
            np.clip(self.lenses + steps[:, LENS], LEAST_LENS, MOST_LENS),
        )

    def rig(self, like: Rig) -> Rig:
        """Return the rig `like` with these extrinsics and lenses."""
        return Rig(
            tuple(
                placed(camera, rotation, translation, lens)
                for camera, rotation, translation, lens in zip(
                    like.cameras, self.rotations, self.translations, self.lenses, strict=True
                )
            )
        )


def first_lenses(rig: Rig, focal: float = ASSUMED_FOCAL) -> Rig:
    """Return a rig whose assumed lenses are as at first: focal length by the image size alone.

    Args:
        rig: the cameras; known lenses stay.
        focal: length of the others, in longer sides of their images.
    """
    sizes = {camera.camera_id: camera.image_size for camera in rig.cameras}
    guesses = assumed_rig(sizes, focal)
    return Rig(
        tuple(
            replace(guess, T_world_camera=camera.T_world_camera) if camera.lens_assumed else camera
            for guess, camera in zip(guesses.cameras, rig.cameras, strict=True)
        ),
        rig.placed,
    )


def placed(camera: Camera, R: Floats, t: Floats, lens: Floats | None = None) -> Camera:
    """Return a camera with other extrinsics: `x_camera = R x_world + t`.

    Args:
        camera: whose lens it has.
        R: `(3, 3)` world to camera.
        t: `(3,)` world to camera, metres.
        lens: `(4,)` change of the lens, as of `Cameras`; distortion only of a lens without any.

    Raises:
        Diverged: naming the camera.
    """
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = R.T
    T_world_camera[:3, 3] = -R.T @ t
    K, distortion = np.array(camera.K), camera.distortion
    if lens is not None and lens.any():
        K[:2, 2] += K[[0, 1], [0, 1]] * lens[2:]
        K[:2, :2] *= np.exp(lens[0])
        if lens[1]:
            distortion = np.array([lens[1], 2 * lens[1] ** 2, 0.0, 0.0])
    try:
        return replace(camera, K=K, T_world_camera=T_world_camera, distortion=distortion)
    except InputError as error:
        raise Diverged(*error.args) from None


def distances(found: Rig, truth: Rig) -> tuple[Floats, Floats]:
    """Return `(num_cameras,)` degrees and millimetres between the cameras of two rigs.

    Args:
        found: in any world and unit; it is brought to the other by the similarity transform.
        truth: in metres.
    """
    scale, R, t = similarity(found.centers_m, truth.centers_m)
    turned = np.stack([camera.R @ R.T for camera in found.cameras])
    angles = angles_between(turned, np.stack([camera.R for camera in truth.cameras]))
    shifts = np.linalg.norm(scale * found.centers_m @ R.T + t - truth.centers_m, axis=1)
    return np.degrees(angles), 1000 * shifts


def _lens(camera: Camera, first: Camera) -> Floats:
    """Return `(4,)` by which the lens of a camera differs from a first one."""
    k1 = camera.distortion[0] if camera.lens_assumed and len(camera.distortion) else 0.0
    focal = first.K[[0, 1], [0, 1]]
    shift = (camera.K[:2, 2] - first.K[:2, 2]) / focal
    return np.array([np.log(camera.K[0, 0] / focal[0]), k1, *shift])
