"""Extrinsics from walking people: matched 2D poses, with or without a rough start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats
from e3pose.base.errors import InputError
from e3pose.calibrate.bundle import Adjusted
from e3pose.calibrate.from_points import PointRig, adjust_all, pair_poses, solve_points
from e3pose.calibrate.lenses import expected_lenses, final_lenses, kinds_of
from e3pose.calibrate.matched_people import Joints, gather, observe_people, rematch, without_lenses
from e3pose.calibrate.moved_cameras import Diverged, distances, first_lenses, placed
from e3pose.calibrate.resection import PlacedPerson, resect
from e3pose.calibrate.same_people import Evidence, Seen, group, pair_by_essential
from e3pose.calibrate.triangulation import place_points
from e3pose.model.camera import Rig
from e3pose.model.noise import Noise
from e3pose.recording.calibration.world import ASSUMED_FOCAL
from e3pose.recording.record import Recording

Progress = Callable[[str, int, int], None]  # stage, steps done, steps in all


def silent(stage: str, done: int, total: int) -> None:
    """Report nothing."""


GROSS_SIGMAS = 3.0
POOR_OUTLIERS, POOR_MEDIAN = 0.15, 2.0  # share, and times the median over cameras
RAYLEIGH_MEDIAN = 1.1774  # of the length of two independent errors of deviation 1


@dataclass(frozen=True, slots=True, eq=False)
class CameraFit:
    """Agreement of each camera with the others.

    Attributes:
        outliers: `(num_cameras,)` share of observations beyond three standard deviations, as
            measured; NaN without any.
        median: `(num_cameras,)` median length of residuals in standard deviations, as measured.
        factor: how many times as large as stated the errors of keypoints are.
        poor: `(num_cameras,)` which cameras do not agree.
    """

    outliers: Floats
    median: Floats
    factor: float
    poor: NDArray[np.bool_]


def fit_of(adjusted: Adjusted) -> CameraFit:
    """Judge each camera of an adjusted rig.

    Args:
        adjusted: with points.
    """
    size = np.linalg.norm(adjusted.residuals[:, :, 0], axis=-1)
    seen = np.isfinite(size)
    views = seen.sum(axis=0)
    # A point takes three of the two residuals that each view has.
    share = 1 - 1.5 / max(float(views[views >= 2].mean()), 1.6) if (views >= 2).any() else 1.0
    factor = float(np.median(size[seen])) / (RAYLEIGH_MEDIAN * np.sqrt(share))
    factor = max(factor, 1e-6)
    median = np.array([
        np.median(own[known]) / factor if known.any() else np.nan
        for own, known in zip(size, seen, strict=True)
    ])  # fmt: skip
    outliers = np.array([
        (own[known] > GROSS_SIGMAS * factor).mean() if known.any() else np.nan
        for own, known in zip(size, seen, strict=True)
    ])  # fmt: skip
    with np.errstate(invalid="ignore"):
        poor = (outliers > POOR_OUTLIERS) | (median > POOR_MEDIAN * np.nanmedian(median))
    return CameraFit(outliers, median, factor, poor | np.isnan(median))


def disagreeing(rig: Rig, fit: CameraFit, force: bool) -> list[str]:
    """Return a warning of cameras that do not agree with the others, or refuse them."""
    if not fit.poor.any():
        return []
    words = "; ".join(
        f"{rig.camera_ids[i]}: {100 * fit.outliers[i]:.0f} % of its keypoints disagree with the "
        f"other cameras, {fit.median[i]:.1f} standard deviations in the median"
        for i in np.flatnonzero(fit.poor).tolist()
    )
    help_words = "record people who walk through all of the room, one or two at a time"
    if not force:
        raise InputError(
            f"cameras: {words}; expected at most {100 * POOR_OUTLIERS:.0f} %. They are off, or see "
            f"people who are hidden or stay in one place: {help_words}, or write the calibration "
            "nevertheless with --force and let another recording judge it (e3pose calibrate check)"
        )
    return [f"{words}: these cameras may be far off; {help_words}"]


ROUGH_SIGMAS = (25.0, 10.0, 5.0)  # tolerances of matching, from a rough start
FINE_SIGMAS = (4.0, 3.0, 3.0)
FINAL_POINTS = 8000
# What scores promise tells which keypoints are better; how large errors are is measured, so what
# is declared of that must not matter: it begins from the errors that detectors have.
USUAL_ERROR = 0.012  # of a person's size in the image
NOISE_FACTORS = (1.0, 2.0, 3.0, 1 / 2, 1 / 3)  # on what is usual, in which order to begin
# Of unknown lenses, in longer sides of the image, in which order to begin: what is expected, and
# wide webcams. Pairs of cameras are placed with them, and do not agree where a lens is far off.
FOCALS = (ASSUMED_FOCAL, 0.65)
SAME_DEG = 1.0  # between the cameras of two rigs: they are the same one
NOISE_LIMITS = (0.1, 10.0)  # of what is usual
MIN_INLIERS = 0.6  # share of keypoints that a rig must explain to be believed
# Detectors are off by 0.9 % (Shelf), 1.8 % (pizza), 1.8 % (simulated operating room) of a person's
# size, as rigs near the truth measure it; one that was 128 degrees off asked for 9 %.
MOST_ERROR = 0.05  # of a person's size in the image, that keypoints may be off by


@dataclass(frozen=True, slots=True, eq=False)
class PeopleRig:
    """A rig solved from people.

    Attributes:
        solved: cameras, points and residuals; its `used` are points of `joints`.
        joints: the matched joints; deviations are those that the residuals have.
        people: how many persons, or parts of their walks, were matched.
        inliers: share of observations within three standard deviations.
        fit: how well each camera agrees with the others.
        noise: how many times as large as declared keypoint errors are.
        error: how large they are, as a share of the size of people in images.
        other: the rig in which each unknown lens has a focal length of its own; the same where all
            are known.
    """

    solved: PointRig
    joints: Joints
    people: int
    inliers: float
    fit: CameraFit
    noise: float
    error: float
    other: Rig

    @property
    def wild(self) -> bool:
        """Whether keypoints agree only if they are taken to be off by more than any detector's."""
        return self.error > MOST_ERROR

    @property
    def explains(self) -> bool:
        """Whether all cameras are placed and enough keypoints agree with where they are."""
        placed = bool(self.solved.placed.all())
        return self.inliers >= MIN_INLIERS and placed and not self.wild


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """A recording with a current rig, its tracklets with those lenses taken off, and noise.

    The noise is `factor` times what is declared, and `usual` is the factor at which it is as large
    as that of detectors usually is.
    """

    recording: Recording
    noise: Noise
    seen: Seen
    usual: float
    factor: float = 1.0

    @property
    def rig(self) -> Rig:
        return self.recording.rig

    def with_rig(self, rig: Rig, factor: float = 1.0) -> _Scene:
        """Return it with another rig, and noise so many times as large."""
        low, high = (self.usual * limit for limit in NOISE_LIMITS)
        total = float(np.clip(self.factor * factor, low, high))
        noise = replace(self.noise, sigma_px=self.noise.sigma_px * total / self.factor)
        recording = replace(self.recording, rig=rig)
        seen = without_lenses(recording, noise, self.seen.tracklets)
        return _Scene(recording, noise, seen, self.usual, total)

    def rematch(self, done: Flags, tolerance: float) -> tuple[Joints, int]:
        return rematch(self.recording, self.noise, self.seen, done, tolerance)


def solve_people(
    recording: Recording,
    noise: Noise,
    start: Rig | None,
    progress: Progress = silent,
) -> PeopleRig:
    """Place the cameras of a recording by the people in it; scale and world are left as they come.

    Args:
        recording: detections; the lenses of its rig are used, and found where a lens is assumed.
        noise: what scores promise; how large errors are is measured.
        start: where the cameras are thought to be, within some 10 degrees and half a metre; None
            to begin from nothing.
        progress: takes a stage, its steps done and in all.

    Raises:
        InputError: when too few people are seen by several cameras, or two cameras have unknown
            lenses.
    """
    rig = recording.rig
    seen = observe_people(recording, noise)
    _check(rig, seen)
    share = seen.share_of_size()
    usual = USUAL_ERROR / share if share > 0 else 1.0  # of nobody with a size, it does not matter
    scene = _Scene(recording, noise, seen, usual).with_rig(rig, usual)
    best: PeopleRig | None = None
    if start is not None:
        best = _from_start(scene, start, progress)
    unknown = any(camera.lens_assumed for camera in rig.cameras)
    firsts = [first_lenses(rig, focal) for focal in FOCALS] if unknown else [rig]
    for factor, first in product(NOISE_FACTORS, firsts):
        if best is not None and best.explains and (start is not None or not best.fit.poor.any()):
            break
        try:
            other = _from_nothing(scene.with_rig(first, factor), progress)
        except Diverged:
            other = None
        if other is None:
            continue
        settled = best is not None and _same(other, best)
        if best is None or _better(other, best):
            best = other
        if settled:  # and so would the next one
            break
    if best is None:
        raise InputError(
            "recording: no two cameras agree on where people are, expected people who walk about, "
            "seen by pairs of cameras at the same time; are the videos synchronised (e3pose sync)?"
        )
    return best


def _check(rig: Rig, seen: Seen) -> None:
    cameras = {
        tracklet.camera
        for tracklet, ideal in zip(seen.tracklets, seen.ideal, strict=True)
        if np.isfinite(ideal).any()
    }
    missing = [name for i, name in enumerate(rig.camera_ids) if i not in cameras]
    if missing:
        raise InputError(
            f"cameras: {', '.join(missing)}: found no track there, expected people "
            "who walk about in every view"
        )
    if len(rig) == 2 and any(camera.lens_assumed for camera in rig.cameras):
        raise InputError(
            "cameras: found two with unknown lenses, which people cannot calibrate: pass "
            "--intrinsics LENSES.toml (e3pose calibrate intrinsics, or another calibration of "
            "these cameras), film a board, or add a third camera"
        )


def _better(one: PeopleRig, other: PeopleRig) -> bool:
    ours, theirs = (
        (int(r.solved.placed.sum()), r.explains, -int(r.fit.poor.sum()), r.inliers)
        for r in (one, other)
    )
    return ours > theirs


def _same(one: PeopleRig, other: PeopleRig) -> bool:
    """Return whether two rigs have all cameras, turned alike."""
    if not (one.solved.placed.all() and other.solved.placed.all()):
        return False
    degrees, _ = distances(one.solved.adjusted.rig, other.solved.adjusted.rig)
    return bool(degrees.max() < SAME_DEG)


def _from_nothing(scene: _Scene, progress: Progress) -> PeopleRig | None:
    rig, seen = scene.rig, scene.seen
    pairs = list(combinations(range(len(rig)), 2))
    evidences: list[Evidence] = []
    for number, (a, b) in enumerate(pairs):
        found = pair_by_essential(seen, a, b)
        if found is not None:
            evidences.append(found[1])
        progress("pairs of cameras", number + 1, len(pairs))
    joints = gather(scene.recording, scene.noise, seen, group(seen, evidences))
    if not len(joints.slot):
        return None
    home = Rig(tuple(placed(camera, np.eye(3), np.zeros(3)) for camera in rig.cameras))
    poses = pair_poses(home, joints.keypoints_px, joints.sigma_px)
    solved = solve_points(home, joints.keypoints_px, joints.sigma_px, poses, expected_lenses(rig))
    if solved is None:
        return None
    return _finish(scene.with_rig(solved.adjusted.rig), solved.placed, progress)


def _from_start(scene: _Scene, start: Rig, progress: Progress) -> PeopleRig | None:
    everyone = np.ones(len(start), dtype=bool)
    scene = scene.with_rig(start)
    for number, tolerance in enumerate(ROUGH_SIGMAS):
        joints, _ = scene.rematch(everyone, tolerance)
        solved = adjust_all(
            scene.rig, joints.keypoints_px, joints.sigma_px, everyone, expected_lenses(scene.rig)
        )
        if solved is None:
            return None
        scene = scene.with_rig(solved.adjusted.rig)
        progress("rough matches", number + 1, len(ROUGH_SIGMAS))
    return _finish(scene, everyone, progress)


def _finish(scene: _Scene, done: Flags, progress: Progress) -> PeopleRig | None:
    """Match people again and adjust; cameras that disagree are placed again by the others."""
    found = _rounds(scene, done, progress)
    good = done if found is None else done & ~found.fit.poor
    if found is None or (good == done).all() or good.sum() < 2:
        return found
    start = found.solved.adjusted.rig
    # They have pulled the others along: those go back to where they agree before they judge.
    others = _rounds(scene.with_rig(start, found.noise / scene.factor), good, progress)
    if others is None:
        return found
    again = _placed_again(scene, others, progress)
    return again if again is not None and _better(again, found) else found


def _placed_again(scene: _Scene, others: PeopleRig, progress: Progress) -> PeopleRig | None:
    """Place the cameras that a rig lacks by the people whom its others place, and adjust all."""
    done = others.solved.placed
    rig = _likely_lenses(others.solved.adjusted.rig, done)
    scene = scene.with_rig(rig, others.noise / scene.factor)
    joints, num_joints = others.joints, len(scene.recording.skeleton)
    pixels = np.where(done[:, None, None], joints.keypoints_px, np.nan)
    points = place_points(rig, pixels, joints.sigma_px).reshape(-1, num_joints, 3)
    person, slot = joints.person[::num_joints], joints.slot[::num_joints]
    people = []
    for name in np.unique(person).tolist():
        rows = np.flatnonzero(person == name)
        rows = rows[np.argsort(slot[rows])]
        people.append(PlacedPerson(slot[rows], points[rows]))
    cameras = list(rig.cameras)
    for index in np.flatnonzero(~done).tolist():
        best = resect(scene.seen, index, people)
        if best is None:
            return None
        cameras[index] = placed(cameras[index], best.R, best.t)
    everyone = np.ones(len(rig), dtype=bool)
    return _rounds(scene.with_rig(Rig(tuple(cameras), rig.placed)), everyone, progress)


def _likely_lenses(rig: Rig, done: Flags) -> Rig:
    """Return a rig whose cameras that are not placed have the lens of one that is, if unknown."""
    cameras = list(rig.cameras)
    for index in np.flatnonzero(~done).tolist():
        camera = cameras[index]
        if camera.lens_assumed:
            alike = [
                other
                for other, there in zip(rig.cameras, done.tolist(), strict=True)
                if there and other.lens_assumed and other.image_size == camera.image_size
            ]
            lens = alike[0] if alike else first_lenses(rig).cameras[index]
            cameras[index] = replace(camera, K=lens.K, distortion=lens.distortion)
    return Rig(tuple(cameras), rig.placed)


def _rounds(scene: _Scene, done: Flags, progress: Progress) -> PeopleRig | None:
    """Match people again with the current rig and adjust again."""
    best: PeopleRig | None = None
    for number, tolerance in enumerate(FINE_SIGMAS):
        joints, people = scene.rematch(done, tolerance)
        adjusted = _adjusted(scene, joints, done)
        if adjusted is None:
            return best
        solved, other = adjusted
        fit = fit_of(solved.adjusted)
        size = np.linalg.norm(solved.adjusted.residuals, axis=-1)
        inliers = float((size[np.isfinite(size)] < 3.0 * fit.factor).mean())
        noise = scene.factor * fit.factor
        error = fit.factor * joints.share_of_size(len(scene.recording.skeleton))
        best = PeopleRig(solved, joints, people, inliers, fit, noise, error, other)
        scene = scene.with_rig(solved.adjusted.rig, fit.factor)
        progress("adjusting", number + 1, len(FINE_SIGMAS))
    return best


def _adjusted(scene: _Scene, joints: Joints, done: Flags) -> tuple[PointRig, Rig] | None:
    """Adjust a rig; unknown lenses by themselves first, to see which cameras are of one kind.

    Returns:
        The rig, and the one before; the same where all lenses are known.
    """
    rig, lenses = scene.rig, None
    if any(camera.lens_assumed for camera in rig.cameras):
        free = adjust_all(rig, joints.keypoints_px, joints.sigma_px, done, expected_lenses(rig))
        if free is None:
            return None
        rig = free.adjusted.rig
        lenses = final_lenses(rig, kinds_of(free.adjusted, fit_of(free.adjusted).factor))
    solved = adjust_all(
        rig, joints.keypoints_px, joints.sigma_px, done, lenses, most_points=FINAL_POINTS
    )
    if solved is None:
        return None
    return solved, rig if lenses is not None else solved.adjusted.rig  # fmt: skip
