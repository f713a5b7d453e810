"""Validate a calibration on a recording: errors by camera, by pair and over the room."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats
from e3pose.base.errors import InputError
from e3pose.calibrate.expected_error import ErrorMap, error_map
from e3pose.calibrate.from_people import PeopleRig, Progress, silent, solve_people
from e3pose.calibrate.matched_people import match_people
from e3pose.calibrate.people_3d import place_people
from e3pose.calibrate.triangulation import place_points
from e3pose.calibrate.uncertainty import CameraErrors, camera_errors, likely_rigs
from e3pose.model.camera import Rig
from e3pose.model.noise import Noise
from e3pose.recording.record import Recording

MIN_JOINTS = 100
ENOUGH_S = 10.0  # of recording, to solve the rig anew
ROOM_RIGS = 8  # of those that people could give, to map their differences over the room
POOR_ANGLE = np.radians(20.0)  # between the rays of a pair, below which depth is poor
POOR_PAIR = 2.0  # times the median error over pairs
SHIFT_SHARE = 0.006  # of the longer side, from which a camera's shift is worth a word
MOVED_DEG, MOVED_MM, SURE_SIGMAS = 0.5, 50.0, 2.0  # from which another place is worth a word


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """The judgement of a calibration by a recording.

    Attributes:
        errors_px: `(num_cameras,)` median reprojection error, each camera against the people that
            the others place.
        shifts_px: `(num_cameras, 2)` its median by axis: what all keypoints have in common.
        sigma_px: `(num_cameras,)` robust standard deviation of either coordinate.
        joints: `(num_cameras,)` how many keypoints were compared.
        errors: what each camera is expected to be off by; NaN where people cannot tell.
        pair_angle: `(num_cameras, num_cameras)` median angle between rays, radians; NaN where
            nobody was seen by both.
        pair_errors_px: `(num_cameras, num_cameras)` median epipolar distance.
        room: expected error over the floor.
        next_steps: what to record or mend, in words.
    """

    errors_px: Floats
    shifts_px: Floats
    sigma_px: Floats
    joints: NDArray[np.int64]
    errors: CameraErrors
    pair_angle: Floats
    pair_errors_px: Floats
    room: ErrorMap
    next_steps: list[str]


def judge(
    recording: Recording,
    noise: Noise,
    progress: Progress = silent,
) -> Judgement:
    """Judge the calibration of a recording by its people.

    Raises:
        InputError: when too few joints are seen by several cameras.
    """
    rig = recording.rig
    joints = match_people(recording, noise, rig)
    pixels, sigma = joints.keypoints_px, joints.sigma_px
    seen = np.isfinite(pixels[..., 0])
    if int((seen.sum(axis=0) >= 2).sum()) < MIN_JOINTS:
        raise InputError(
            f"recording: {int((seen.sum(axis=0) >= 2).sum())} joints are seen by two cameras, "
            f"expected at least {MIN_JOINTS}; is the calibration that of these films?"
        )
    residuals = _left_out(rig, pixels, sigma)
    errors = _median(np.linalg.norm(residuals, axis=-1))
    shifts = np.stack([_median(residuals[..., 0]), _median(residuals[..., 1])], axis=-1)
    points = place_points(rig, pixels, sigma)
    inner = pixels - np.stack([camera.project(points) for camera in rig.cameras])
    spread = 1.4826 * _median(np.abs(inner).mean(axis=-1))
    spread = np.where(np.isfinite(spread), np.maximum(spread, 0.5), np.nanmedian(spread))
    found = _solved_again(recording, noise, progress)
    likely = [] if found is None else likely_rigs(found, recording.fps)
    sure = camera_errors(rig, found, likely)
    likely = likely[:ROOM_RIGS] if np.isfinite(sure.moved_deg).all() else []
    people = place_people(rig, joints, recording.skeleton, recording.fps)
    hips = people.of("left_hip", "right_hip")
    hips = hips[np.isfinite(hips).all(axis=-1)]
    if len(hips) < 10:
        hips = points[np.isfinite(points).all(axis=-1)]
    room = error_map(rig, spread, hips[:, :2], likely)
    angle, pair_errors = _pairs(rig, points, pixels)
    return Judgement(
        errors, shifts, spread, seen.sum(axis=1), sure, angle, pair_errors, room,
        _advice(rig, shifts, _blamed(rig, shifts, inner), sure, seen, room),
    )  # fmt: skip


def _solved_again(recording: Recording, noise: Noise, progress: Progress) -> PeopleRig | None:
    """Solve the rig anew from its people; None where they are too few to be believed."""
    if recording.num_slots < ENOUGH_S * recording.fps:
        return None  # moments of people place no camera
    try:
        found = solve_people(recording, noise, recording.rig, progress)
    except InputError:
        return None
    return found if found.explains else None


def _left_out(rig: Rig, pixels: Floats, sigma: Floats) -> Floats:
    """Return `(num_cameras, num_points, 2)` errors against what the other cameras place."""
    residuals = np.full(pixels.shape, np.nan)
    for index, camera in enumerate(rig.cameras):
        others = pixels.copy()
        others[index] = np.nan
        points = place_points(rig, others, sigma)
        if len(rig) == 2:  # one other camera places nothing
            points = place_points(rig, pixels, sigma)
        residuals[index] = pixels[index] - camera.project(points)
    return residuals


def _blamed(rig: Rig, shifts: Floats, inner: Floats) -> Flags:
    """Return `(num_cameras,)`: the cameras that were moved.

    A camera in a wrong place pulls what it places with the others, so that these seem shifted, too;
    where all place people together, it alone does not fit.

    Args:
        rig: the cameras.
        shifts: `(num_cameras, 2)` pixels, against the people that the others place.
        inner: `(num_cameras, num_points, 2)` pixels, against the people that all place.
    """
    sides = np.array([max(camera.image_size) for camera in rig.cameras])
    shifted = np.linalg.norm(shifts, axis=-1) > SHIFT_SHARE * sides
    own = np.linalg.norm([_median(inner[..., 0]), _median(inner[..., 1])], axis=0)
    return np.asarray(shifted & ~(own < np.max(own, where=shifted, initial=0.0) / 2))


def _median(values: Floats) -> Floats:
    """Return medians of known values over the last axis; NaN where few are known."""
    out = np.full(values.shape[:-1], np.nan)
    for place in np.ndindex(out.shape):
        known = values[place][np.isfinite(values[place])]
        if len(known) >= 10:
            out[place] = np.median(known)
    return out


def _pairs(rig: Rig, points: Floats, pixels: Floats) -> tuple[Floats, Floats]:
    number = len(rig)
    angle, errors = np.full((number, number), np.nan), np.full((number, number), np.nan)
    rays = points[None] - rig.centers_m[:, None]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    seen = np.isfinite(pixels[..., 0]) & np.isfinite(points[:, 0])
    for a in range(number):
        for b in range(a + 1, number):
            both = seen[a] & seen[b]
            if both.sum() < MIN_JOINTS:
                continue
            cosine = (rays[a, both] * rays[b, both]).sum(axis=-1)
            angle[a, b] = angle[b, a] = float(np.median(np.arccos(np.clip(cosine, -1, 1))))
            first, second = (rig.cameras[i].undistort(pixels[i, both]) for i in (a, b))
            lines = np.column_stack([first, np.ones(len(first))]) @ rig.fundamental(a, b).T
            off = (lines[:, :2] * second).sum(axis=1) + lines[:, 2]
            off = np.abs(off) / np.hypot(lines[:, 0], lines[:, 1])
            errors[a, b] = errors[b, a] = float(np.nanmedian(off))
    return angle, errors


def poor_pairs(rig: Rig, judgement: Judgement) -> list[str]:
    """Return pairs of cameras that place people badly, with the reason."""
    words = []
    middle = float(np.nanmedian(judgement.pair_errors_px))
    for a in range(len(rig)):
        for b in range(a + 1, len(rig)):
            names = f"{rig.camera_ids[a]} and {rig.camera_ids[b]}"
            angle, error = judgement.pair_angle[a, b], judgement.pair_errors_px[a, b]
            if np.isnan(angle):
                words.append(f"{names}: see no person in common")
            elif min(angle, np.pi - angle) < POOR_ANGLE:
                words.append(f"{names}: rays meet at {np.degrees(angle):.0f} degrees")
            elif error > POOR_PAIR * middle and error > 3:
                words.append(f"{names}: {error:.1f} px off each other's epipolar lines")
    return words


def _advice(
    rig: Rig,
    shifts: Floats,
    blamed: Flags,
    sure: CameraErrors,
    seen: NDArray[np.bool_],
    room: ErrorMap,
) -> list[str]:
    words = []
    for i, camera in enumerate(rig.cameras):
        if not seen[i].any():
            words.append(
                f"{camera.camera_id} saw no person that others saw: record people in front of it"
            )
            continue
        if blamed[i]:
            words.append(
                f"{camera.camera_id} is off by ({shifts[i, 0]:+.0f}, {shifts[i, 1]:+.0f}) px: it "
                "was moved, or its lens or image size is not that of the calibration; `e3pose "
                f"calibrate extrinsics RECORDING NEW.toml --only {camera.camera_id}` places it"
            )
    moved = np.nan_to_num(sure.moved_deg / MOVED_DEG + sure.moved_mm / MOVED_MM)
    doubt = np.maximum(sure.moved_deg / sure.sure_deg, sure.moved_mm / sure.sure_mm) > SURE_SIGMAS
    worst = int(np.argmax(np.where(doubt, moved, 0.0)))
    if doubt[worst] and (sure.moved_deg[worst] > MOVED_DEG or sure.moved_mm[worst] > MOVED_MM):
        words.append(
            f"{rig.camera_ids[worst]} would fit these people better {sure.moved_deg[worst]:.1f} "
            f"degrees and {sure.moved_mm[worst]:.0f} mm away; if they walk through the whole room, "
            "refine the calibration with them: e3pose calibrate extrinsics RECORDING NEW.toml "
            "--start THIS.toml"
        )
    total = room.total_mm
    known = np.isfinite(total)
    if known.any():
        place = np.unravel_index(np.nanargmax(np.where(known, total, -1.0)), total.shape)
        limit = 2 * float(np.nanmedian(total))
        if total[place] > limit:
            words.append(
                f"worst near x {room.x_m[place[1]]:.1f}, y {room.y_m[place[0]]:.1f} m: "
                f"{total[place]:.0f} mm with {room.cameras[place]} cameras; point another camera "
                "there, or add one"
            )
    return words
