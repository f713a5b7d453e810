"""The uncertainty of a rig from people, whose keypoint errors repeat.

A detector is off in the same way for as long as a person keeps a posture, and in one joint of
everybody. The covariance of a least-squares fit takes errors to be independent and so promises far
too much. Here groups of observations are left out one after the other, by person and by joint: the
cluster jackknife, with two ways to group (Cameron, Gelbach and Miller, "Robust inference with
multiway clustering", 2011). A group's effect is that of one Gauss-Newton step.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.calibrate.align import Move
from e3pose.calibrate.bundle import lens_precision, linearise_points, observe, root_mean_square
from e3pose.calibrate.from_people import PeopleRig
from e3pose.calibrate.from_points import OUTLIER_SIGMAS
from e3pose.calibrate.least_squares import Linearised, curvature_share, reduced_normal
from e3pose.calibrate.lenses import REPEATED
from e3pose.calibrate.moved_cameras import (
    LENS,
    NUM_PARAMETERS,
    POSE,
    Cameras,
    distances,
    first_lenses,
)
from e3pose.model.camera import Rig
from e3pose.model.rotations import similarity

GROUP_S = 5.0  # of one person's walk, where few people are there
MIN_PEOPLE = 3  # to leave out one after the other
SAMPLES = 32
SEED = 7
RAYS = 5  # along either side of an image: more in all than a lens has coefficients
RANK = 1e-10  # of the normal equations: the scale is free
KNOWN_SHARE = 1e-6  # of a focal length: what rounding does to a known one, no search ends so near
FAR_DEG = 15.0  # from a calibration, farther is more likely wrong than right


@dataclass(frozen=True, slots=True, eq=False)
class CameraErrors:
    """The expected errors of a calibration's cameras.

    All are after the similarity transform that fits the cameras best; NaN where unknown.

    Attributes:
        moved_deg: `(num_cameras,)` by how much people would turn each camera.
        moved_mm: `(num_cameras,)` by how much they would move it.
        moved_rays_deg: `(num_cameras,)` by how much they would turn its rays: where the axis of a
            lens is beside the middle of its image, the camera seems turned, but its rays are not.
        sure_deg: `(num_cameras,)` standard deviation of the first.
        sure_mm: `(num_cameras,)` likewise.
        sure_rays_deg: `(num_cameras,)` likewise.
        focal_share: `(num_cameras,)` standard deviation of the focal length as a share of it; 0
            where the lens was known.
    """

    moved_deg: Floats
    moved_mm: Floats
    moved_rays_deg: Floats
    sure_deg: Floats
    sure_mm: Floats
    sure_rays_deg: Floats
    focal_share: Floats

    @property
    def expected_deg(self) -> Floats:
        """`(num_cameras,)` expected error of the orientation, root mean square."""
        return np.hypot(self.moved_deg, self.sure_deg)

    @property
    def expected_mm(self) -> Floats:
        """`(num_cameras,)` expected error of the position, root mean square."""
        return np.hypot(self.moved_mm, self.sure_mm)

    @property
    def expected_rays_deg(self) -> Floats:
        """`(num_cameras,)` expected error of the rays in the middle half of the image."""
        return np.hypot(self.moved_rays_deg, self.sure_rays_deg)

    def expected_text(self, camera: int) -> str:
        """Return the expected error of a camera in words."""
        if np.isnan(self.expected_deg[camera]):
            return "unknown"
        found = self.focal_share[camera] > KNOWN_SHARE
        rays = f" (its rays {self.expected_rays_deg[camera]:.2f})" if found else ""
        millimetres = f"{self.expected_mm[camera]:.0f} mm"
        return f"{self.expected_deg[camera]:.2f} degrees{rays}, {millimetres}"


def camera_errors(rig: Rig, found: PeopleRig | None, likely: list[Rig]) -> CameraErrors:
    """Compare a calibration with what people say.

    Args:
        rig: the calibration, in metres.
        found: what people give; None if they give nothing that could be believed.
        likely: rigs that these people could give as well, of `likely_rigs`.

    Returns:
        All NaN where people cannot tell: they give nothing, or a camera farther away than could
        be believed; and for two cameras, which no similarity transform compares.
    """
    nothing = CameraErrors(*(np.full(len(rig), np.nan) for _ in fields(CameraErrors)))
    if found is None or len(rig) < 3:
        return nothing
    best = found.solved.adjusted.rig
    moved = (*distances(best, rig), rays_apart(best, rig))
    there = Move(*similarity(best.centers_m, rig.centers_m)).rig(best)
    off = [(*distances(other, there), rays_apart(other, there)) for other in likely]
    # Whether cameras share a focal length is a guess: the rig without it may be right as well.
    otherwise = (*distances(found.other, there), rays_apart(found.other, there))
    sure = [
        np.hypot(root_mean_square(np.stack(each), 0), alone)
        for each, alone in zip(zip(*off, strict=True), otherwise, strict=True)
    ]
    if max(moved[0].max(), sure[0].max()) > FAR_DEG:
        return nothing
    focal = np.log([[camera.K[0, 0] for camera in other.cameras] for other in [best, *likely]])
    sure.append(root_mean_square(focal[1:] - focal[0], 0))
    return CameraErrors(*moved, *(np.where(found.fit.poor, np.nan, each) for each in sure))


def likely_rigs(found: PeopleRig, fps: float) -> list[Rig]:
    """Return other rigs that the same people could give, in the same unit.

    Args:
        found: a rig whose cameras are all placed.
        fps: slots per second.
    """
    rig = found.solved.adjusted.rig
    covariance = _covariance(found, fps)
    values, axes = np.linalg.eigh(covariance)
    spread = axes * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(SEED)
    steps = rng.standard_normal((SAMPLES, len(values))) @ spread.T
    first, cameras = first_lenses(rig), Cameras.of(rig)
    return [cameras.moved(step.reshape(len(rig), -1)).rig(first) for step in steps]


def rays_apart(found: Rig, truth: Rig) -> Floats:
    """Return `(num_cameras,)` degrees between the rays of two rigs, root mean square.

    Args:
        found: as `distances` has it.
        truth: its images' middle halves are compared.
    """
    R = similarity(found.centers_m, truth.centers_m)[1]
    apart = []
    for camera, true in zip(found.cameras, truth.cameras, strict=True):
        shares = np.stack(np.meshgrid(*2 * [np.linspace(0.25, 0.75, RAYS)]), axis=-1)
        pixels = shares.reshape(-1, 2) * true.image_size
        cosines = ((camera.rays(pixels) @ R.T) * true.rays(pixels)).sum(axis=-1)
        apart.append(np.degrees(root_mean_square(np.arccos(np.clip(cosines, -1, 1)), 0)))
    return np.array(apart)


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """The information of people on the cameras of a rig, to first order, joints eliminated.

    Attributes:
        system: residuals of points at the solution.
        cameras: `(num_cameras * 10, num_cameras * 10)` of the observations, points eliminated.
        prior: likewise, what is expected of lenses.
        free: the parameters that are not fixed: all but the first camera's place and known lenses.
    """

    system: Linearised
    cameras: Floats
    prior: Floats
    free: Integers

    def inverse(self, expected: float = 1.0) -> Floats:
        """Return the covariance of the free parameters, were all errors independent.

        Args:
            expected: how many times as much as in the solution what is expected counts.
        """
        both = np.ix_(self.free, self.free)
        total = (self.cameras + expected * self.prior)[both]
        return np.asarray(np.linalg.pinv(total, rcond=RANK, hermitian=True))


def normal_equations(found: PeopleRig) -> NormalEquations:
    """Return the normal equations of a rig at its solution."""
    solved, joints = found.solved, found.joints
    rig, used = solved.adjusted.rig, solved.used
    pixels, sigma = joints.keypoints_px[:, used, None], joints.sigma_px[:, used, None]
    system = linearise_points(
        Cameras.of(rig), solved.adjusted.blocks, observe(first_lenses(rig), pixels, sigma)
    )
    prior = lens_precision(solved.lenses, len(rig))
    free = np.ones((len(rig), NUM_PARAMETERS), dtype=bool)
    free[0, POSE] = False
    free[:, LENS] = np.diag(prior).reshape(len(rig), -1)[:, LENS] > 0
    cameras, _ = reduced_normal(system, OUTLIER_SIGMAS)
    return NormalEquations(system, cameras, prior, np.flatnonzero(free))


def _covariance(found: PeopleRig, fps: float) -> Floats:
    """Return `(num_cameras * 10, num_cameras * 10)` of all camera parameters."""
    equations = normal_equations(found)
    system, prior, chosen = equations.system, equations.prior, equations.free
    total, both = equations.cameras + prior, np.ix_(chosen, chosen)
    joints, used = found.joints, found.solved.used
    person, slot = joints.person[used], joints.slot[used]
    walks = person * (1 + int(slot.max())) + (slot / fps // GROUP_S).astype(int)
    groupings = [walks, person] if len(np.unique(person)) >= MIN_PEOPLE else [walks]
    by_person, by_joint = (
        max((_jackknife(system, total, chosen, g) for g in each), key=np.trace)
        for each in (groupings, [joints.joint[used]])
    )
    inverse = equations.inverse()
    curvature = curvature_share(system.residuals, OUTLIER_SIGMAS)
    covariance = np.zeros_like(total)
    # The prior was made as strong as errors that repeat ask for: it is that much less sure.
    expected = REPEATED * inverse @ prior[both] @ inverse
    covariance[both] = (by_person + by_joint) / curvature**2 + expected
    return covariance


def _jackknife(system: Linearised, total: Floats, chosen: Integers, groups: Integers) -> Floats:
    """Return the covariance of the chosen parameters, by leaving out one group after the other.

    Args:
        system: residuals of points at the solution.
        total: `(p, p)` normal equations of the cameras with what is expected of them.
        chosen: which parameters are free.
        groups: `(num_points,)` the group of each.
    """
    names, members = np.unique(groups, return_inverse=True)
    effects = []
    for number in range(len(names)):
        rows = members == number
        own = Linearised(
            *(a[:, rows] for a in (system.residuals, system.by_camera, system.by_block))
        )
        normal, gradient = reduced_normal(own, OUTLIER_SIGMAS)
        rest = (total - normal)[np.ix_(chosen, chosen)]
        effects.append(np.linalg.pinv(rest, rcond=RANK, hermitian=True) @ gradient[chosen])
    stacked = np.stack(effects)
    return np.asarray((1 - 1 / len(names)) * stacked.T @ stacked)
