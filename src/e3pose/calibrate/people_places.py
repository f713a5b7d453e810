"""Extrinsics of a rig, or of one camera of it, from the people of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.base.errors import InputError
from e3pose.calibrate.align import Floor, Move, floor_from_people, guess
from e3pose.calibrate.bundle import AdjustOptions, adjust_points, root_mean_square
from e3pose.calibrate.from_people import (
    FINAL_POINTS,
    FINE_SIGMAS,
    MOST_ERROR,
    ROUGH_SIGMAS,
    PeopleRig,
    Progress,
    disagreeing,
    solve_people,
)
from e3pose.calibrate.from_points import OUTLIER_SIGMAS, subsampled
from e3pose.calibrate.matched_people import match_people
from e3pose.calibrate.moved_cameras import distances
from e3pose.calibrate.people_3d import (
    People3D,
    Scale,
    from_distance,
    from_limb,
    from_stature,
    place_people,
)
from e3pose.calibrate.places import KnownLength, Places, agreement
from e3pose.calibrate.triangulation import place_points
from e3pose.calibrate.uncertainty import FAR_DEG, camera_errors, likely_rigs
from e3pose.model.camera import Rig
from e3pose.model.camera_fields import MAX_DISTANCE_M
from e3pose.model.noise import Noise
from e3pose.model.noises import detector_of, load_noise
from e3pose.model.rotations import angles_between, similarity
from e3pose.recording.record import Recording

ENOUGH_S, ENOUGH_SPREAD = 8.0, 0.08  # of matched people: seconds, and share of the distance


def from_people(
    recording: Recording,
    noise: Noise,
    start: Rig | None,
    known: KnownLength,
    progress: Progress,
    force: bool = False,
) -> Places:
    """Place cameras by the people of a recording, and the world by where they stand.

    Args:
        recording: detections; lenses are taken from its rig.
        noise: what scores promise.
        start: a rough calibration, whose scale and world are kept unless a length is known.
        known: what fixes the scale.
        progress: takes a stage, its steps done and in all.
        force: accept cameras that do not agree with the others.

    Raises:
        InputError: when cameras cannot be placed, or do not agree with the others.
    """
    found = solve_people(recording, noise, start, progress)
    if not found.solved.placed.all():
        every = tuple(zip(recording.rig.camera_ids, found.solved.placed, strict=True))
        lost = ", ".join(name for name, done in every if not done)
        rest = ", ".join(name for name, done in every if done)
        raise InputError(
            f"cameras: {lost}: too few people match those that {rest} see at the "
            "same time, expected a person who walks for half a minute where two cameras see them; "
            "in a live session few cameras are active at once: `e3pose record SITE DEST --for 60` "
            "uses all of them"
        )
    rig = found.solved.adjusted.rig
    notes = disagreeing(rig, found.fit, force) + _too_wild(found, force)
    if not found.explains:
        notes.append(
            f"only {100 * found.inliers:.0f} % of keypoints agree: are the films synchronised "
            "(e3pose sync), and do people walk through all of the room?"
        )
    people = place_people(rig, found.joints, recording.skeleton, recording.fps)
    notes += _little_seen(rig, people, recording)
    if start is not None and len(rig) > 2:
        _check_near(rig, start)
    given = known.height_m is not None or known.distance is not None or known.limb is not None
    if start is not None and not given and len(rig) > 2:
        factor, R, t = similarity(rig.centers_m, start.centers_m)
        move, scale = Move(factor, R, t), Scale(factor, "the rough calibration", 0.02)
        world = "that of the rough calibration"
    else:
        scale = scale_of(rig, people, known)
        _check_far(rig, scale.factor)
        move = Move(scale.factor, np.eye(3), np.zeros(3))
        try:
            floor = floor_from_people(people.scaled(move.scale, move.R, move.t))
            move, world = floor.move @ move, "floor and vertical from standing people"
            if not floor.tilted:
                notes.append("people stood still in one place only: the vertical is less certain")
        except InputError as error:
            placed = move.rig(rig)
            move, world = guess(placed) @ move, "guessed from level cameras"
            notes.append(f"{error}; the floor is guessed")
    if scale.share > 0.05:
        off = f"sizes may be {100 * scale.share:.1g} % off"
        notes.append(f"{off}: pass --height, --limb, or a --distance of metres")
    sigma = found.joints.sigma_px[:, found.solved.used]
    adjusted, placed = found.solved.adjusted, move.rig(rig)
    errors = camera_errors(placed, found, likely_rigs(found, recording.fps))
    return Places(
        placed, "people", *agreement(adjusted.residuals, adjusted.weights, sigma), scale, world,
        notes, errors,
    )  # fmt: skip


def _too_wild(found: PeopleRig, force: bool) -> list[str]:
    """Return a warning where only wild keypoints would agree with a rig, or refuse it."""
    if not found.wild:
        return []
    words = (
        f"keypoints would be off by {100 * found.error:.0f} % of people's size in the images, "
        f"expected at most {100 * MOST_ERROR:.0f} %"
    )
    if not force:
        raise InputError(
            f"cameras: {words}. They are off, or the films are not in step (e3pose sync): record "
            "one or two people who walk through all of the room, or write the calibration "
            "nevertheless with --force and let another recording judge it (e3pose calibrate check)"
        )
    return [f"{words}: all cameras may be far off"]


def floor_of(recording: Recording, stature_m: float) -> Floor:
    """Return the floor as the people of a recording stand on it, whose rig is placed in metres.

    Args:
        recording: detections, with their calibration.
        stature_m: of the people, metres.

    Raises:
        InputError: when no person stands upright for long enough.
    """
    return floor_from_people(people_of(recording), stature_m)


def people_of(recording: Recording) -> People3D:
    """Return the people of a recording whose rig is placed, matched by it and triangulated."""
    joints = match_people(recording, load_noise(detector_of(recording)), recording.rig)
    return place_people(recording.rig, joints, recording.skeleton, recording.fps)


def _little_seen(rig: Rig, people: People3D, recording: Recording) -> list[str]:
    """Return a warning where people say too little of the room to fix the cameras."""
    hips = people.of("left_hip", "right_hip")
    hips = hips[np.isfinite(hips).all(axis=-1)]
    seconds = len(np.unique(people.slot)) / recording.fps
    if not len(hips):
        return []
    away = np.median(np.linalg.norm(rig.centers_m[:, None] - hips[None, ::10], axis=-1))
    spread = float(np.sqrt(np.median(((hips - np.median(hips, axis=0)) ** 2).sum(axis=1))) / away)
    if seconds >= ENOUGH_S and spread >= ENOUGH_SPREAD:
        return []
    return [
        f"people were matched for {seconds:.0f} s within {100 * spread:.0f} % of their distance to "
        "the cameras: the result may be far off; film them walking through all of the room for "
        "half a minute"
    ]


def _check_far(rig: Rig, factor: float) -> None:
    """Raise `InputError` if a camera is farther from the middle one than any may be.

    Args:
        rig: in any unit.
        factor: metres per unit.
    """
    away_m = factor * np.linalg.norm(rig.centers_m - np.median(rig.centers_m, axis=0), axis=1)
    worst = int(np.argmax(away_m))
    if not away_m[worst] < MAX_DISTANCE_M:
        raise InputError(
            f"cameras: {rig.camera_ids[worst]}: people would put it {away_m[worst]:.0f} m from the "
            f"others, expected less than {MAX_DISTANCE_M:.0f}: record people who walk through all "
            "of the room, one or two at a time"
        )


def _check_near(rig: Rig, start: Rig) -> None:
    """Raise `InputError` if people put a camera quite elsewhere than the rough calibration."""
    angles = distances(rig, start)[0]
    worst = int(np.argmax(angles))
    if angles[worst] > FAR_DEG:
        raise InputError(
            f"--start: people would turn {rig.camera_ids[worst]} by {angles[worst]:.0f} degrees, "
            f"expected at most {FAR_DEG:g}: they walk through too little of the room, the films "
            "are not in step, or the rough calibration is another rig's (leave it out then)"
        )


def scale_of(rig: Rig, people: People3D, known: KnownLength) -> Scale:
    """Return the scale by a known length; by people's heights if none is known."""
    if known.distance is not None:
        return from_distance(rig, *known.distance)
    if known.limb is not None:
        return from_limb(people, *known.limb)
    return from_stature(people, known.height_m)


MIN_POINTS = 200  # joints that the camera shares with others
MIN_OTHERS = 2  # cameras that it shares some with: one alone does not say how far away it is
MIN_INLIERS = 0.5  # of its keypoints, within three standard deviations


@dataclass(frozen=True, slots=True, eq=False)
class OneCamera:
    """A rig with one camera recalibrated.

    Attributes:
        rig: all cameras.
        degrees: by how much the camera was turned.
        metres: by how much it was moved.
        error_px: its root mean square reprojection error of what agrees.
        inliers: share of its keypoints that agree.
        points: how many joints it shares with others.
    """

    rig: Rig
    degrees: float
    metres: float
    error_px: float
    inliers: float
    points: int


def place_one(recording: Recording, noise: Noise, rig: Rig, camera_id: str) -> OneCamera:
    """Place a camera that was knocked, by some 10 degrees and half a metre at most.

    Args:
        recording: people, seen since then.
        noise: what scores promise.
        rig: the calibration from before; lenses too.
        camera_id: which camera.

    Raises:
        InputError: when the people do not fix it.
    """
    index = rig.index(camera_id)
    if len(rig) < MIN_OTHERS + 1:
        raise InputError(f"--only: found {len(rig)} cameras, expected at least three")
    free = np.arange(len(rig)) == index
    current = rig
    for tolerance in (*ROUGH_SIGMAS, *FINE_SIGMAS):
        joints = match_people(recording, noise, current, tolerance)
        pixels, sigma = joints.keypoints_px, joints.sigma_px
        points = place_points(current, pixels, sigma)
        seen = np.isfinite(pixels[..., 0])
        used = np.flatnonzero(np.isfinite(points[:, 0]) & seen[index] & (seen.sum(axis=0) >= 2))
        others = (seen[:, used].sum(axis=1) >= MIN_POINTS / 4) & ~free
        if len(used) < MIN_POINTS or others.sum() < MIN_OTHERS:
            raise InputError(
                f"camera {camera_id}: shares {len(used)} joints with {others.sum()} cameras, "
                f"expected at least {MIN_POINTS} with {MIN_OTHERS}: record a person who "
                "walks through its view"
            )
        used = subsampled(used, seen[:, used].sum(axis=0), FINAL_POINTS)
        adjusted = adjust_points(
            current,
            points[used],
            pixels[:, used],
            sigma[:, used],
            AdjustOptions(OUTLIER_SIGMAS, free),
        )
        cameras = list(rig.cameras)
        cameras[index] = adjusted.rig.cameras[index]
        current = Rig(tuple(cameras))
    size = np.linalg.norm(adjusted.residuals[index, :, 0], axis=-1)
    inliers = float((size < 3.0).mean())
    if inliers < MIN_INLIERS:
        raise InputError(
            f"camera {camera_id}: only {100 * inliers:.0f} % of its keypoints agree with the other "
            "cameras: it moved too far for this, or another camera moved too; recalibrate all "
            "cameras with `e3pose calibrate extrinsics RECORDING rig.toml`"
        )
    before, after = rig.cameras[index], current.cameras[index]
    error_px = root_mean_square(np.where(size < 3.0, size * sigma[index, used], np.nan), 0)
    return OneCamera(
        current,
        float(np.degrees(angles_between(after.R[None], before.R[None])[0])),
        float(np.linalg.norm(after.center_m - before.center_m)),
        float(error_px),
        inliers,
        len(used),
    )
