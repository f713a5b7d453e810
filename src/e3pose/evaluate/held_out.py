"""Held-out cameras: judge poses by the keypoints of a camera that gave nothing to them. Pure.

A smoother over the same keypoints shares their errors; a camera that took no part does not. Its own
errors stay in the figures, and many of them last: compare differences between replays, not levels
(`docs/how-to/choose-cameras.md`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields, replace
from statistics import fmean
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.base.nan_statistics import mean_of_known
from e3pose.evaluate.figures import Distances, HeldOut, HeldOutCamera
from e3pose.evaluate.wrong_limbs import wrong_in_view, wrong_percent
from e3pose.model.camera import Camera
from e3pose.model.skeleton import Skeleton
from e3pose.model.slot_record import SlotRecord
from e3pose.recording import Recording, ViewSeries
from e3pose.recording.record import of_cameras

EACH = "each"
MIN_CAMERAS = 2  # that are left to estimate from
# definition: detectors guess the ankles of people who sit, and faces and toes are easy or unsure
COMPARED = tuple(
    f"{side}_{joint}"
    for joint in ("shoulder", "elbow", "wrist", "hip", "knee")
    for side in ("left", "right")
)
SURE_SCORE = 0.4  # definition: keypoints below it do not count
LEAST_KEYPOINTS = 4  # definition: that count, of a detection that counts
SAME_M = 0.5  # definition: mean distance beyond which a detection is of somebody else

Figures = TypeVar("Figures", bound=Distances)
Turn = tuple[Recording, Recording | None]


def turns(recording: Recording, camera_ids: Sequence[str]) -> list[Turn]:
    """Return the replays, each with its judge.

    Args:
        recording: of all cameras.
        camera_ids: to hold out, all at once; `each` for one after the other. None if empty.

    Returns:
        The recording without the held-out cameras, and with nothing but these; with `each` first
        the whole recording, without a judge, and then a pair for each camera.

    Raises:
        InputError: for unknown cameras, those without a keypoint and rigs that are too small.
    """
    ids = recording.rig.camera_ids
    if not camera_ids:
        return [(recording, None)]
    if EACH in camera_ids:
        if len(set(camera_ids)) > 1:
            raise InputError("hold_out", f"{EACH} with other cameras", f"{EACH} alone")
        whole: list[Turn] = [(recording, None)]
        return whole + [turn for name in ids for turn in turns(recording, [name])]
    for name in camera_ids:
        if name not in ids:
            raise InputError("hold_out", repr(name[:64]), f"one of {', '.join(ids)}, or {EACH}")
        if not (recording.views[ids.index(name)].scores > SURE_SCORE).any():
            wanted = f"a camera with keypoints of scores above {SURE_SCORE:g}"
            raise InputError("hold_out", name, wanted)
    left = [name for name in ids if name not in camera_ids]
    if len(left) < MIN_CAMERAS:
        found = f"{len(set(camera_ids))} of {len(ids)} cameras"
        raise InputError("hold_out", found, f"at least {MIN_CAMERAS} cameras that are left")
    return [(of_cameras(recording, left), of_cameras(recording, camera_ids))]


def judge(judges: Recording, records: Sequence[SlotRecord]) -> HeldOut:
    """Compare the poses of a replay with the keypoints of cameras that took no part in it.

    In each scored slot poses and detections are paired one to one, at the smallest total of mean
    distances over the joints of `COMPARED`, below `SAME_M` across the ray. Keypoints count above
    `SURE_SCORE`. A pixel is worth its depth over the focal length.

    Args:
        judges: the held-out cameras alone, from `turns`.
        records: of the replay without them.
    """
    scored = range(*(judges.scored_slots or (0, judges.num_slots)))
    return _of_all(
        {
            camera.camera_id: _one(camera, judges.skeleton, records, series, scored)
            for camera, series in zip(judges.rig.cameras, judges.views, strict=True)
        }
    )


# What nobody should trust. Usual are 30 to 50 mm from held-out cameras, whose own errors count too.
DOUBTFUL_MM, ODD_CAMERA, DOUBTFUL_MISSED = 80.0, 2.0, 30.0  # definition: of a red line
SHIFTED = 0.7  # definition: share of a camera's distance that all its keypoints have in common


def doubts_of(held_out: HeldOut | None, reprojection: HeldOut) -> list[str]:
    """Return why poses should not be trusted, by what held-out cameras say; the worst first.

    A camera may also be far off because the others place people badly without it, or are pulled by
    one in a wrong place: only one that does not fit in `reprojection`, of poses that all made, is
    named. Where there is none, no camera is.
    """
    if held_out is None:
        few = len(reprojection.cameras) <= MIN_CAMERAS
        return ["Two cameras: none is left to judge the poses."] if few else []
    doubts, median_mm = [], held_out.mean.median_mm
    if median_mm is None:
        return ["No camera that took no part sees the people where the poses are."]
    if median_mm > DOUBTFUL_MM:
        doubts.append(
            f"Joints are {median_mm:.0f} mm off across the rays of cameras that took no part: "
            "check the calibration and the time between the films."
        )
    odd, unfit = _odd_cameras(held_out), _odd_cameras(reprojection)
    for name, (camera, others_mm) in odd.items():
        if name in unfit:
            doubts.append(
                f"Camera {name} disagrees with the others ({camera.median_mm:.0f} mm, the "
                f"others {others_mm:.0f}): {_cause(name, camera)}"
            )
    if odd and not odd.keys() & unfit:
        camera, others_mm = max(odd.values(), key=lambda each: each[0].median_mm or 0.0)
        doubts.append(
            f"One of the cameras disagrees with the others ({camera.median_mm:.0f} mm, the others "
            f"{others_mm:.0f}), or these place people badly without it; which one cannot be told: "
            "check the calibration and the time between the films."
        )
    missed = held_out.mean.missed_percent or 0.0
    if missed > DOUBTFUL_MISSED:
        doubts.append(f"{missed:.0f} % of the people whom such cameras detect have no pose.")
    return doubts


def _odd_cameras(found: HeldOut) -> dict[str, tuple[HeldOutCamera, float]]:
    """Return cameras that are much farther from the poses than the others, and these, mm."""
    odd = {}
    for name, camera in found.cameras.items():
        others = [o.median_mm for k, o in found.cameras.items() if k != name and o.median_mm]
        usual = float(np.median(others)) if others else np.inf
        if camera.median_mm and camera.median_mm > max(ODD_CAMERA * usual, DOUBTFUL_MM / 2):
            odd[name] = camera, usual
    return odd


def _cause(name: str, camera: HeldOutCamera) -> str:
    x, y = camera.shift_px or (0.0, 0.0)
    if np.hypot(x, y) < SHIFTED * (camera.median_px or np.inf):
        return "check when its film began (e3pose sync), then its calibration."
    return (
        f"all its keypoints are off by ({round(x):+}, {round(y):+}) px, so it was moved, or its "
        "lens or image size is not that of the calibration. `e3pose calibrate extrinsics "
        f"RECORDING NEW.toml --only {name}` places it by the people; then use NEW.toml."
    )


def joined(found: Sequence[HeldOut | None]) -> HeldOut | None:
    """Return the figures of the judges of several replays; None if there is none."""
    cameras = {k: v for each in found if each is not None for k, v in each.cameras.items()}
    return _of_all(cameras) if cameras else None


def _one(
    camera: Camera,
    skeleton: Skeleton,
    records: Sequence[SlotRecord],
    series: ViewSeries,
    scored: range,
) -> HeldOutCamera:
    from scipy.optimize import linear_sum_assignment

    rows = [row for row, name in enumerate(skeleton.joints) if name in COMPARED]
    rows = rows if len(rows) >= LEAST_KEYPOINTS else list(range(len(skeleton)))
    most = len(series.scores)  # single precision: an hour has millions
    off = np.empty((most, len(skeleton), 2), np.float32)
    wrong = np.empty((most, len(skeleton)), np.float32)
    shift_px = np.empty((most, 2), np.float32)
    people = poses = unseen = paired = 0
    for record in records:
        view = series.view(record.slot) if record.slot in scored else None
        if view is None:  # a lost view judges nobody
            continue
        joints_m = record.people.joints_m
        sure_px = np.where((view.scores > SURE_SCORE)[..., None], view.keypoints_px, np.nan)
        apart = _apart(camera, joints_m, sure_px)  # (num_poses, num_detections, num_joints, 2)
        mean_m = mean_of_known(apart[..., rows, 1], LEAST_KEYPOINTS, np.inf)
        pose, detection = linear_sum_assignment(np.minimum(mean_m, 2 * SAME_M))
        same = mean_m[pose, detection] < SAME_M
        pose, detection = pose[same], detection[same]
        new = slice(paired, paired + len(pose))
        paired = new.stop
        off[new] = apart[pose, detection]
        names = skeleton.joints
        wrong[new] = wrong_in_view(camera, joints_m[pose], sure_px[detection], names)
        aside_px = sure_px[detection] - camera.project(joints_m[pose])
        shift_px[new] = np.nanmedian(aside_px[:, rows], axis=1)
        counted = (view.scores[:, rows] > SURE_SCORE).sum(axis=-1) >= LEAST_KEYPOINTS
        pixels = camera.project(joints_m[:, rows])  # NaN counts as outside the image
        inside = ((pixels >= 0) & (pixels < camera.image_size)).all(axis=-1)
        shown = 2 * inside.sum(axis=-1) >= inside.shape[-1]  # half of the joints
        people, poses = people + int(counted.sum()), poses + int(shown.sum())
        shown[pose] = False
        unseen += int(shown.sum())
    found, turned = off[:paired], wrong[:paired]
    shift = np.median(shift_px[:paired], axis=0) if paired else None
    return HeldOutCamera(
        **asdict(_distances(found[:, rows], turned[:, rows])),
        people=people,
        missed_percent=100 * (people - len(found)) / people if people else None,
        poses=poses,
        unseen_percent=100 * unseen / poses if poses else None,
        shift_px=None if shift is None else (float(shift[0]), float(shift[1])),
        joints={
            name: _distances(found[:, row], turned[:, row])
            for row, name in enumerate(skeleton.joints)
        },
    )


def _apart(camera: Camera, joints_m: Floats, keypoints_px: Floats) -> Floats:
    """Return `(num_poses, num_detections, num_joints, 2)` pixels and metres across the ray."""
    apart_px = np.linalg.norm(camera.project(joints_m)[:, None] - keypoints_px, axis=-1)
    depth_m = joints_m @ camera.R[2] + camera.t[2]
    focal_px = np.sqrt(camera.K[0, 0] * camera.K[1, 1])
    return np.stack([apart_px, apart_px * depth_m[:, None] / focal_px], axis=-1)


def _distances(off: NDArray[Any], wrong: NDArray[Any]) -> Distances:
    """Return the figures of joints.

    Args:
        off: `(*batch, 2)` pixels and metres, NaN where a keypoint is missing.
        wrong: `(*batch)` of `wrong_in_view`.
    """
    known = np.isfinite(off).all(axis=-1)
    if not known.any():
        return Distances()
    off_px, off_m = off[known, 0], off[known, 1]
    return Distances(
        len(off_px),
        float(off_px.mean(dtype=np.float64)),
        float(np.median(off_px)),
        1e3 * float(off_m.mean(dtype=np.float64)),
        1e3 * float(np.median(off_m)),
        int(np.isfinite(wrong).sum()),
        wrong_percent(wrong),
    )


def _of_all(cameras: Mapping[str, HeldOutCamera]) -> HeldOut:
    """Return the cameras with the mean of all; a figure that one lacks is of the others."""
    each = list(cameras.values())
    names = {name: None for one in each for name in one.joints}
    joints = {
        name: _mean([one.joints[name] for one in each if name in one.joints]) for name in names
    }
    return HeldOut(cameras, replace(_mean(each), joints=joints))


def _mean(each: Sequence[Figures]) -> Figures:
    """Return the mean of every number; counts are summed."""
    found: dict[str, Any] = {}
    for item in fields(each[0]):
        values = [getattr(one, item.name) for one in each]
        known = [value for value in values if isinstance(value, int | float)]
        counts = all(isinstance(value, int) for value in known)
        if item.name != "joints":
            found[item.name] = (sum(known) if counts else fmean(known)) if known else None
    return replace(each[0], **found)
