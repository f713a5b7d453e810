"""Find problems in a recording, with advice."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.nan_statistics import mean_of_known
from e3pose.base.quantities import plural, shell
from e3pose.model.camera import Camera
from e3pose.model.pose import Poses2D
from e3pose.recording.calibration.world import world_problem
from e3pose.recording.detections.layouts import SAMPLE, better_order
from e3pose.recording.record import Recording, ViewSeries, with_places
from e3pose.recording.videos import VIDEOS, chapters_of

SAMPLED_SLOTS = 60
MAX_SAMPLED_PEOPLE = 12  # of one view
MIN_SAMPLES = 10
MIN_JOINTS = 5


def epipolar_distances_px(recording: Recording) -> Floats:
    """Measure how far people lie from the epipolar lines of their likeliest candidates.

    Returns:
        `(num_cameras, num_cameras)` pixels in the image of the row's camera: the median, over
        people of sampled slots, of the distance to the best partner in the column's camera. NaN
        where fewer than ten people could be compared.
    """
    rig = recording.rig
    num_cameras = len(rig)
    samples: list[list[list[float]]] = [[[] for _ in rig.cameras] for _ in rig.cameras]
    lines = np.zeros((num_cameras, num_cameras, 3, 3))  # [a, b] maps pixels of a to lines in b
    for a, b in permutations(range(num_cameras), 2):
        lines[a, b] = rig.fundamental(a, b)
    peopled = [series.slots[np.diff(series.starts) > 0] for series in recording.views]
    slots, counts = np.unique(np.concatenate(peopled), return_counts=True)
    useful = slots[counts >= 2]
    for slot in useful[:: max(1, len(useful) // SAMPLED_SLOTS)].tolist():
        views = [_sample(recording.view(slot, camera)) for camera in range(num_cameras)]
        pixels = [
            rig.cameras[camera].undistort(view.keypoints_px) for camera, view in enumerate(views)
        ]
        for row in range(num_cameras):
            for column in range(num_cameras):
                if row == column or not len(views[row]) or not len(views[column]):
                    continue
                distances = _line_distances(pixels[row], pixels[column], lines[column, row])
                best = np.nanmin(np.where(np.isnan(distances), np.inf, distances), axis=1)
                samples[row][column] += best[np.isfinite(best)].tolist()
    return np.array(
        [[np.median(c) if len(c) >= MIN_SAMPLES else np.nan for c in row] for row in samples]
    )


def truth_distances_px(recording: Recording) -> Floats:
    """Measure how far the truth projects from the nearest person that a camera saw.

    Returns:
        `(num_cameras,)` pixels, median over sampled slots and annotated people; NaN where fewer
        than ten could be compared.
    """
    truth = recording.truth
    rig = recording.rig
    samples: list[list[float]] = [[] for _ in rig.cameras]
    if truth is None:
        return np.full(len(rig), np.nan)
    shared = [name for name in truth.skeleton.joints if name in recording.skeleton.joints]
    truth_columns = [truth.skeleton.joints.index(name) for name in shared]
    view_columns = [recording.skeleton.joints.index(name) for name in shared]
    annotated = np.flatnonzero(np.any(np.any(truth.annotated, axis=2), axis=1))
    step = max(1, len(annotated) // SAMPLED_SLOTS)
    for slot in annotated[::step].tolist():
        joints_m = truth.joints_m[slot][:, truth_columns]
        for camera in range(len(rig)):
            view = _sample(recording.view(slot, camera))
            if not len(view):
                continue
            expected = rig.cameras[camera].project(joints_m)
            expected[~rig.cameras[camera].sees(joints_m)] = np.nan
            offsets = expected[:, None] - view.keypoints_px[None][:, :, view_columns]
            distances = mean_of_known(np.linalg.norm(offsets, axis=-1), MIN_JOINTS)
            best = np.min(np.where(np.isnan(distances), np.inf, distances), axis=1)
            samples[camera] += best[np.isfinite(best)].tolist()
    return np.array([np.median(s) if len(s) >= MIN_SAMPLES else np.nan for s in samples])


def _sample(view: Poses2D | None) -> Poses2D:
    if view is None:
        return Poses2D.empty(0)
    rows = slice(0, MAX_SAMPLED_PEOPLE)
    return Poses2D(view.keypoints_px[rows], view.scores[rows])


def _line_distances(pixels: Floats, candidates: Floats, F: Floats) -> Floats:
    """Return `(num_persons, num_candidates)` mean pixels from joints to candidates' lines."""
    homogeneous = np.concatenate([candidates, np.ones_like(candidates[..., :1])], axis=-1)
    lines = homogeneous @ F.T
    length = np.hypot(lines[..., 0], lines[..., 1])
    lines = lines / np.where(length > 0, length, np.nan)[..., None]
    own = np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)
    return mean_of_known(np.abs((own[:, None] * lines[None]).sum(axis=-1)), MIN_JOINTS)


# Limits beyond which something deserves a line.
OUTSIDE_PX = 5.0  # networks place a joint at the border this far beyond it
OUTSIDE_SHARE = 0.02  # of keypoints outside the image
RATE_SHARE = 0.005  # difference between the times and fps
JITTER_SHARE = 0.25  # of a slot, 95th percentile
SAME_PLACE_M = 0.02
# Shares of the image diagonal. Right calibrations measure 0.2 to 1 percent, wrong ones 5 and more.
EPIPOLAR_SHARE = 0.025
TRUTH_SHARE = 0.06


# Problems that neither move nor hide anybody in 3D: `info` alone tells of them.
HARMLESS = (
    "flat-scores", "missing-video", "no-truth", "rate", "lost-views", "sees-nobody",
    "blank-people", "jitter",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong.

    Attributes:
        kind: a short stable name, for programs.
        where: the camera, or `recording`, `rig`, `truth`.
        message: for people.
    """

    kind: str
    where: str
    message: str


def find_problems(
    recording: Recording,
    folder: Path | None = None,
    rotations: Mapping[str, int] | None = None,
    calibration: object = "calibration.toml",
) -> list[Problem]:
    """Return the problems of a recording, the worst of each camera first.

    Args:
        recording: the recording.
        folder: where it was loaded from, to look for its videos.
        rotations: by camera, degrees clockwise that make people in its images upright.
        calibration: the file to mend, for commands.
    """
    if recording.num_slots == 0:
        return [Problem("empty", "recording", "holds no slot")]
    problems: list[Problem] = []
    people, step = 0, max(1, sum(len(each.scores) for each in recording.views) // SAMPLE)
    seen = []  # every so manieth of the people in all views
    for camera, series in zip(recording.rig.cameras, recording.views, strict=True):
        problems += _view_problems(camera, series, recording)
        problems += _time_problems(camera.camera_id, series, recording)
        problems += _keypoint_problems(camera, series)
        rows = slice(-people % step, None, step)
        seen.append(np.dstack([series.keypoints_px[rows], series.scores[rows]]))
        people += len(series.scores)
    problems += _copied_views(recording)
    if other := better_order(np.nan_to_num(np.concatenate(seen)), recording.skeleton):
        own = recording.skeleton.name
        message = f"limbs have people's lengths as {other}, not as {own}: --skeleton {other}"
        problems.append(Problem("skeleton", "recording", message))
    made = shell(folder or recording.name)
    place = f"e3pose calibrate extrinsics {made} rig.toml --height 171cm --update"
    for name in recording.rig.unplaced:
        message = f"has no place, so replay leaves it out; to place all cameras by people: {place}"
        problems.append(Problem("not-placed", name, message))
    recording = with_places(recording)
    if recording.rig.placed:
        problems += _rig_problems(recording, rotations, calibration)
        problems += _consistency_problems(recording)
        problems += _truth_problems(recording)
    else:
        message = f"it is not known where the cameras stand: {place}"
        problems.append(Problem("not-placed", "rig", message))
    if folder is not None:
        for camera_id, name in recording.videos.items():
            if not all(path.is_file() for path in chapters_of(folder / VIDEOS / name)):
                message = f"video {name} is not there"
                problems.append(Problem("missing-video", camera_id, message))
    return problems


def _view_problems(camera: Camera, series: ViewSeries, recording: Recording) -> list[Problem]:
    where = camera.camera_id
    lost = recording.num_slots - len(series.slots)
    if len(series.slots) == 0:
        return [Problem("no-views", where, "has no views")]
    problems = []
    if lost:
        edges = np.concatenate([[-1], series.slots, [recording.num_slots]])
        gaps = np.diff(edges) - 1
        longest = int(gaps.argmax())
        first = int(edges[longest]) + 1
        count = int((gaps > 0).sum())
        problems.append(
            Problem(
                "lost-views",
                where,
                f"{lost} of {recording.num_slots} views are lost in {plural(count, 'gap')}; "
                f"the longest is slots {first} to {first + int(gaps[longest]) - 1}",
            )
        )
    if len(series.scores) == 0:
        problems.append(Problem("sees-nobody", where, "detects nobody in any of its views"))
    return problems


def _time_problems(where: str, series: ViewSeries, recording: Recording) -> list[Problem]:
    if len(series.slots) < 3:
        return []
    interval_s = recording.interval_s
    problems = []
    if (np.diff(series.times_s) <= 0).any():
        slot = int(series.slots[1:][np.diff(series.times_s) <= 0][0])
        problems.append(Problem("time-order", where, f"time does not rise at slot {slot}"))
    slots = series.slots.astype(np.float64)
    slope, start_s = np.polyfit(slots, series.times_s, 1)
    if abs(slope / interval_s - 1) > RATE_SHARE:
        rate = f"{1 / slope:.3f} fps" if slope > 0 else "no steady rate"
        problems.append(
            Problem("rate", where, f"times run at {rate}, the recording says {recording.fps:g}")
        )
    jitter_s = float(np.percentile(np.abs(series.times_s - (slope * slots + start_s)), 95))
    if jitter_s > JITTER_SHARE * interval_s:
        problems.append(
            Problem(
                "jitter",
                where,
                f"times stray by {1000 * jitter_s:.1f} ms (95th percentile) from a steady rate, "
                f"a slot is {1000 * interval_s:.1f} ms",
            )
        )
    offset_s = float(np.median(series.times_s - slots * interval_s))
    if abs(offset_s) > interval_s:
        problems.append(
            Problem("offset", where, f"times are {offset_s:+.3f} s from what slot and fps say")
        )
    return problems


def _keypoint_problems(camera: Camera, series: ViewSeries) -> list[Problem]:
    where = camera.camera_id
    seen = series.scores > 0
    if len(series.scores) == 0:
        return []
    problems = []
    blank = int((~seen.any(axis=1)).sum())
    if blank:
        message = f"{blank} of {len(seen)} people have no keypoint: all scores are 0"
        problems.append(Problem("blank-people", where, message))
    if not seen.any():
        return problems
    if np.min(series.scores, where=seen, initial=1.0) == 1 and seen.sum() > 100:
        message = "all scores are 1, so good and bad keypoints cannot be distinguished"
        problems.append(Problem("flat-scores", where, message))
    width, height = camera.image_size
    last = np.array([width, height]) - 1
    pixels = series.keypoints_px
    outside = ((pixels < -OUTSIDE_PX) | (pixels > last + OUTSIDE_PX)).any(axis=-1) & seen
    share = outside.sum() / seen.sum()
    if share > OUTSIDE_SHARE:
        right, bottom = pixels[seen].max(axis=0).tolist()
        problems.append(
            Problem(
                "outside-image",
                where,
                f"{100 * share:.0f} % of keypoints lie outside the {width} x {height} "
                f"image (they reach {right:.0f}, {bottom:.0f}); "
                "is the size, the rotation or the camera right?",
            )
        )
    return problems


def _copied_views(recording: Recording) -> list[Problem]:
    problems = []
    for index, series in enumerate(recording.views):
        for other in range(index):
            same = recording.views[other]
            if len(series.scores) > 0 and np.array_equal(
                series.keypoints_px, same.keypoints_px, equal_nan=True
            ):
                ids = recording.rig.camera_ids
                message = f"has the very keypoints of {ids[other]}; was one file copied?"
                problems.append(Problem("copied-views", ids[index], message))
                break
    return problems


def _rig_problems(
    recording: Recording, rotations: Mapping[str, int] | None, calibration: object
) -> list[Problem]:
    rig = recording.rig
    if len(rig) < 2:
        return [Problem("one-camera", "rig", "has one camera, 3D needs at least two")]
    problems = []
    distances_m = np.linalg.norm(rig.centers_m[:, None] - rig.centers_m[None], axis=-1)
    close = np.argwhere(np.triu(distances_m < SAME_PLACE_M, k=1))
    for first, second in close.tolist():
        message = f"stands in the same place as {rig.camera_ids[first]}"
        problems.append(Problem("same-place", rig.camera_ids[second], message))
    kind, message = world_problem(rig, calibration, rotations)
    if kind:
        problems.append(Problem(kind, "rig", message))
    for camera in rig.cameras:
        width, height = camera.image_size
        if not (0 < camera.K[0, 2] < width and 0 < camera.K[1, 2] < height):
            message = "the principal point lies outside the image; is the image size right?"
            problems.append(Problem("principal-point", camera.camera_id, message))
    return problems


def _consistency_problems(recording: Recording) -> list[Problem]:
    problems = []
    distances_px = epipolar_distances_px(recording)
    for index, camera in enumerate(recording.rig.cameras):
        # A wrong camera disagrees with most others, a right one only with the wrong.
        pairs = np.sort(distances_px[index][np.isfinite(distances_px[index])])
        limit_px = EPIPOLAR_SHARE * float(np.hypot(*camera.image_size))
        middle_px = float(pairs[(len(pairs) - 1) // 2]) if len(pairs) else 0.0
        if middle_px > limit_px:
            problems.append(
                Problem(
                    "epipolar",
                    camera.camera_id,
                    f"people lie {middle_px:.0f} px or more off where most other cameras "
                    f"say they can be, expected below {limit_px:.0f}; check calibration, "
                    "units, camera order and synchronisation",
                )
            )
    return problems


def _truth_problems(recording: Recording) -> list[Problem]:
    truth = recording.truth
    if truth is None:
        return []
    problems = []
    for name, annotated in zip(truth.person_ids, np.moveaxis(truth.annotated, 1, 0), strict=True):
        if not annotated.any():
            problems.append(Problem("no-truth", "truth", f"{name} is annotated in no slot"))
    for camera, distance_px in zip(
        recording.rig.cameras, truth_distances_px(recording).tolist(), strict=True
    ):
        limit_px = TRUTH_SHARE * float(np.hypot(*camera.image_size))
        if distance_px > limit_px:
            problems.append(
                Problem(
                    "truth-off",
                    camera.camera_id,
                    f"the truth projects {distance_px:.0f} px (median) from the nearest person "
                    f"seen, expected below {limit_px:.0f}; check its units, axes and slots",
                )
            )
    return problems
