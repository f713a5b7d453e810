"""CMU Panoptic: a sequence folder as published, or an .npz of the same arrays."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.bounded import decode_json, read_bytes
from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import PANOPTIC19, Skeleton
from e3pose.recording import Recording, Truth, ViewSeries
from e3pose.recording.arrays import floats, integers, load_arrays
from e3pose.recording.calibration import load_rig
from e3pose.recording.calibration.opencv import WORLD_FROM_PANOPTIC as T_WORLD_PANOPTIC
from e3pose.recording.detections.importing import Progress, read_detections
from e3pose.recording.detections.views import MAX_SLOTS, poses_from_triples
from e3pose.recording.record import MAX_PEOPLE
from e3pose.recording.videos import frame_number

Bodies = Mapping[int, Mapping[int, Floats]]  # frame number -> person -> (19, 4) cm and confidence

FPS = 29.97
HD_NUMBER = re.compile(r"[0-9]{1,4}")
PAPER_CAMERAS = ("3", "6", "12", "13", "23")
MIN_CONFIDENCE = 0.1  # at or below it the published joints are guesses
SOURCE = "CMU Panoptic Studio, Joo et al.; non-commercial research use only."
WHERE = "http://domedb.perception.cs.cmu.edu"
MAX_JOINTS = 20_000_000


MAX_FILE_BYTES = 16 * 2**20
COORDINATE_LIMIT_CM = 1e5


class _Body(msgspec.Struct):
    id: int
    joints19: list[float]


class _File(msgspec.Struct):
    bodies: list[_Body]


def read_bodies(
    folder: Path, progress: Progress = iter
) -> dict[int, dict[int, NDArray[np.float64]]]:
    """Read the bodies of every frame.

    Args:
        folder: `hdPose3d_stage1_coco19` of a sequence.
        progress: wraps the list of files that is read.

    Returns:
        Frame number to person number to `(19, 4)` centimetres and confidence, -1 where unknown.

    Raises:
        InputError: for no file, a wrong file, too many people, or two files of one frame.
    """
    paths = sorted(folder.glob("body3DScene_*.json"))
    if not paths:
        raise InputError(f"{folder}: found no body3DScene_*.json, expected one a frame")
    frames: dict[int, dict[int, NDArray[np.float64]]] = {}
    for path in progress(paths):
        number = frame_number(path.name)
        if number in frames:
            raise InputError(f"{path}: frame number {number} appears twice in this folder")
        frames[number] = _read_file(path)
    people = {person for bodies in frames.values() for person in bodies}
    if len(people) > MAX_PEOPLE:
        raise InputError(f"{folder}: found {len(people)} people, expected at most {MAX_PEOPLE}")
    return frames


def _read_file(path: Path) -> dict[int, NDArray[np.float64]]:
    bodies = decode_json(_File, read_bytes(path, MAX_FILE_BYTES), path, "Panoptic bodies").bodies
    people: dict[int, NDArray[np.float64]] = {}
    for index, body in enumerate(bodies):
        where = f"{path}: bodies[{index}]"
        if len(body.joints19) != 19 * 4:
            raise InputError(f"{where}.joints19: found {len(body.joints19)} numbers, expected 76")
        if not 0 <= body.id < 2**31 or body.id in people:
            raise InputError(f"{where}.id: found {body.id}, expected unique numbers from 0")
        joints = np.array(body.joints19, dtype=np.float64).reshape(19, 4)
        if (np.abs(joints) > COORDINATE_LIMIT_CM).any():
            raise InputError(f"{where}.joints19: found a coordinate beyond 1 km, in centimetres")
        people[body.id] = joints
    return people


def import_panoptic(
    source: Path,
    cameras: Sequence[str] = PAPER_CAMERAS,
    calibration: Path | None = None,
    detections: Path | None = None,
    folders: Mapping[str, str] | None = None,
    project_truth: bool = False,
    progress: Progress = iter,
) -> Recording:
    """Read a Panoptic sequence.

    Args:
        source: a folder with `calibration_*.json` and `hdPose3d_stage1_coco19/body3DScene_*.json`,
            or an .npz with `joints19_cm_conf` or `joints19_cm`, and perhaps the calibration.
        cameras: HD cameras by number (`3`) or name (`00_03`); the paper's five by default.
        calibration: the rig where `source` has none: an .npz, or any format that
            `e3pose.recording.calibration` reads.
        detections: a folder of OpenPose JSON, a folder per camera, with the frame numbers of the
            sequence. Without it every view is lost.
        folders: camera id to folder name below `detections`.
        project_truth: whether the truth, projected without error or occlusion, takes the place of
            detections.
        progress: wraps the list of files that is read.

    Returns:
        A recording at 29.97 Hz whose slot 0 is the first frame with a truth.

    Raises:
        InputError: for a file that cannot be read, or an unknown camera.
    """
    if detections is not None and project_truth:
        raise InputError("--project-truth: found with --detections, expected only one of them")
    bodies, rig = _load(source, cameras, calibration, progress)
    joints_m, person_ids, first = truth_from_bodies(bodies, str(source))
    num_slots = len(joints_m)
    skeleton = PANOPTIC19
    name = f"Panoptic {source.resolve().stem}"
    if detections is not None:
        skeleton, frames = read_detections(detections, rig, folders or {}, progress)
        views = _within(frames, first, num_slots, skeleton, detections)
        note = f" 2D keypoints: OpenPose JSON, {skeleton.name}."
    elif project_truth:
        views = _projections(rig, joints_m)
        name += ", projected truth"
        note = " 2D keypoints are exact projections of the truth, NOT detections."
    else:
        nothing = ViewSeries.from_views([], [], [], len(skeleton))
        views = (nothing,) * len(rig)
        note = " Truth only, without 2D keypoints."
    return Recording(
        name="".join(char for char in name if char.isprintable())[:200],
        rig=rig,
        fps=FPS,
        num_slots=num_slots,
        skeleton=skeleton,
        views=views,
        truth=Truth(PANOPTIC19, person_ids, joints_m),
        source=SOURCE + note,
        detector="openpose" if detections is not None else "",
    )


def truth_from_bodies(bodies: Bodies, where: str) -> tuple[Floats, tuple[str, ...], int]:
    """Convert published bodies to `(num_slots, num_persons, 19, 3)` metres, z up.

    Returns:
        The joints, NaN at or below confidence 0.1; a name per person; and the frame of slot 0.

    Raises:
        InputError: for no frame with bodies, or more people than fit.
    """
    if not bodies:
        raise InputError(f"{where}: found no frame with bodies, expected at least one")
    first, last = min(bodies), max(bodies)
    people = sorted({person for frame in bodies.values() for person in frame})
    num_slots = last - first + 1
    if num_slots > MAX_SLOTS or num_slots * max(len(people), 1) * 19 > MAX_JOINTS:
        raise InputError(
            f"{where}: found {len(people)} people in frames {first} to {last}, "
            f"expected at most {MAX_JOINTS} joints in all"
        )
    joints_m = np.full((num_slots, len(people), 19, 3), np.nan)
    for frame, bodies_of_frame in bodies.items():
        for person, body in bodies_of_frame.items():
            known = (body[:, 3] > MIN_CONFIDENCE) & np.isfinite(body).all(axis=-1)
            world = body[:, :3] @ T_WORLD_PANOPTIC[:3, :3].T / 100
            joints_m[frame - first, people.index(person)] = np.where(known[:, None], world, np.nan)
    return joints_m, tuple(f"person{person}" for person in people), first


def rig_from_arrays(path: Path, cameras: Sequence[str]) -> Rig:
    """Read cameras from the `cam_names`, `K`, `dist`, `R`, `t_cm`, `resolution` of an .npz.

    Raises:
        InputError: for an array that is missing or wrong, or an unknown camera.
    """
    arrays = load_arrays(
        path,
        {
            "cam_names": ("num_cameras",),
            "K": ("num_cameras", 3, 3),
            "dist": ("num_cameras", 5),
            "R": ("num_cameras", 3, 3),
            "t_cm": ("num_cameras", 3),
            "resolution": (2,),
        },
    )
    K, dist, R, t_cm = (
        floats(path, name, arrays[name], finite=True) for name in ("K", "dist", "R", "t_cm")
    )
    size = integers(path, "resolution", arrays["resolution"], below=100_000)
    names = [str(name) for name in arrays["cam_names"].tolist()]
    try:
        return Rig(
            tuple(
                Camera.from_world_to_camera(
                    names[n],
                    (int(size[0]), int(size[1])),
                    K[n],
                    R[n] @ T_WORLD_PANOPTIC[:3, :3].T,
                    t_cm[n] / 100,
                    dist[n],
                )
                for n in camera_indices(names, cameras)
            )
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def camera_indices(names: Sequence[str], cameras: Sequence[str]) -> list[int]:
    """Return where the wanted cameras, by HD number or name, stand in `names`.

    Raises:
        InputError: for a camera that the rig does not have.
    """
    indices = []
    for wanted in cameras:
        number = HD_NUMBER.fullmatch(wanted)
        name = f"00_{int(wanted):02d}" if number else wanted
        if name not in names:
            known = ", ".join(n for n in names if n.startswith("00_")) or ", ".join(names[:40])
            raise InputError(f"--cameras: {wanted[:40]!r} is not in the rig, which has {known}")
        indices.append(names.index(name))
    return indices


def _load(
    source: Path, cameras: Sequence[str], calibration: Path | None, progress: Progress
) -> tuple[Bodies, Rig]:
    if source.is_dir():
        if calibration is None:
            found = sorted(source.glob("calibration_*.json"))
            if len(found) != 1:
                raise InputError(
                    f"{source}: found {len(found)} files calibration_*.json, expected one, "
                    f"or --calibration FILE; sequences are published at {WHERE}"
                )
            calibration = found[0]
        rig = _rig(calibration, cameras)
        folder = source / "hdPose3d_stage1_coco19"
        if not folder.is_dir():
            raise InputError(
                f"{folder}: missing: the 3D poses, unpacked from {folder.name}.tar of the "
                f"sequence, published at {WHERE}"
            )
        return read_bodies(folder, progress), rig
    bodies = _bodies_from_arrays(source)
    return bodies, _rig(calibration or source, cameras)


def _rig(path: Path, cameras: Sequence[str]) -> Rig:
    if path.suffix.lower() == ".npz":
        return rig_from_arrays(path, cameras)
    rig = load_rig(path)
    return rig.subset(camera_indices(rig.camera_ids, cameras))


def _bodies_from_arrays(path: Path) -> Bodies:
    arrays = load_arrays(
        path,
        {
            "frames": ("num_slots",),
            "joints19_cm_conf?": ("num_slots", "num_persons", 19, 4),
            "joints19_cm?": ("num_slots", 19, 3),
            "ids?": ("num_persons",),
        },
    )
    if "joints19_cm_conf" in arrays:
        bodies = floats(path, "joints19_cm_conf", arrays["joints19_cm_conf"], finite=False)
    elif "joints19_cm" in arrays:
        joints = floats(path, "joints19_cm", arrays["joints19_cm"], finite=False)[:, None]
        # Joints that were not found stand at exactly the origin of the dome's axes.
        found = (joints != 0).any(axis=-1, keepdims=True)
        bodies = np.concatenate([joints, found.astype(np.float64)], axis=-1)
    else:
        raise InputError(f"{path}: array 'joints19_cm_conf' is missing, and so is 'joints19_cm'")
    frames = integers(path, "frames", arrays["frames"], below=2**31).tolist()
    if len(set(frames)) != len(frames):
        raise InputError(f"{path}: array 'frames': found a number twice, expected them to differ")
    ids = list(range(bodies.shape[1]))
    if "ids" in arrays:
        ids = integers(path, "ids", arrays["ids"], below=2**31).tolist()
    return {
        frame: dict(zip(ids, people, strict=True))
        for frame, people in zip(frames, bodies, strict=True)
    }


def _within(
    frames: Sequence[Mapping[int, Poses2D]],
    first: int,
    num_slots: int,
    skeleton: Skeleton,
    detections: Path,
) -> tuple[ViewSeries, ...]:
    """Keep the detections of the frames that have a truth."""
    series = []
    for camera in frames:
        numbers = sorted(number for number in camera if first <= number < first + num_slots)
        slots = [number - first for number in numbers]
        times_s = [slot / FPS for slot in slots]
        views = [camera[number] for number in numbers]
        series.append(ViewSeries.from_views(views, slots, times_s, len(skeleton)))
    if not any(len(one.slots) for one in series):
        raise InputError(
            f"{detections}: found no frame numbered {first} to {first + num_slots - 1}, "
            "expected the frame numbers of the sequence"
        )
    return tuple(series)


def _projections(rig: Rig, joints_m: Floats) -> tuple[ViewSeries, ...]:
    """Project the truth; a joint outside the image is missing, a person without a joint absent."""
    series = []
    slots = range(len(joints_m))
    for camera in rig.cameras:
        pixels = camera.project(joints_m)
        inside = camera.sees(joints_m)
        triples = np.concatenate([pixels, inside[..., None]], axis=-1)
        triples = np.where(inside[..., None], triples, 0.0)
        views = [
            poses_from_triples(triples[slot][inside[slot].any(axis=-1)], camera.camera_id)
            for slot in slots
        ]
        times_s = [slot / FPS for slot in slots]
        series.append(ViewSeries.from_views(views, slots, times_s, len(PANOPTIC19)))
    return tuple(series)
