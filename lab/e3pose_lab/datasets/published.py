"""Shelf and Campus as published: labels in actorsGT.mat, projection matrices, image folders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.bounded import open_regular, read_bytes
from e3pose.base.errors import InputError, reason_of
from e3pose.model.camera import Camera, Rig
from e3pose.model.skeleton import SHELF14
from e3pose.recording import Recording, Truth
from e3pose.recording.calibration import load_rig
from e3pose.recording.detections.importing import Progress
from e3pose.recording.json_lines import METRE_LIMIT
from e3pose.recording.videos import frame_number
from e3pose_lab.datasets.detected import detected_views

LABELS = "actorsGT.mat"
MAX_LABEL_BYTES = 512 * 2**20
MAX_MATRIX_BYTES = 100_000
MAX_FRAMES = 100_000
FPS = 25.0
IMAGES = ("*.png", "*.jpg", "*.jpeg")
WHERE = "http://campar.in.tum.de/Chair/MultiHumanPose"


@dataclass(frozen=True, slots=True)
class Layout:
    """One of the two data sets.

    Attributes:
        title: of the recording.
        calibration: the file in which VoxelPose publishes the cameras.
        cameras: how many.
        image_size: `(width, height)` of the published images.
        frames: first and last frame of the protocol.
        scored: ranges of frames, ends included, that everybody scores.
    """

    title: str
    calibration: str
    cameras: int
    image_size: tuple[int, int]
    frames: tuple[int, int]
    scored: tuple[tuple[int, int], ...]


SHELF = Layout("Shelf", "calibration_shelf.json", 5, (1032, 776), (300, 600), ((300, 600),))
CAMPUS = Layout(
    "Campus", "calibration_campus.json", 3, (360, 288), (350, 750), ((350, 470), (650, 750))
)


def import_published(
    source: Path,
    layout: Layout,
    frames: tuple[int, int] | None = None,
    detections: Path | None = None,
    folders: Mapping[str, str] | None = None,
    progress: Progress = iter,
) -> Recording:
    """Read Shelf or Campus as it is published.

    Args:
        source: the folder with `actorsGT.mat`, `Calibration/P0.txt` and on, or VoxelPose's
            `calibration_shelf.json` (`calibration_campus.json`) in their place, and `Camera0` and
            on.
        layout: `SHELF` or `CAMPUS`.
        frames: first and last frame, counted from 0 as images are; those of the protocol by
            default.
        detections: a folder of OpenPose JSON, or a recording that `e3pose detect` made of all
            images. Without it the recording has the truth and no views.
        folders: camera id to folder name below `detections`.
        progress: wraps the list of files that is read.

    Returns:
        A recording at 25 fps with cameras `Camera0` and on. Slot 0 is the first of `frames`; labels
        outside the scored ranges are left out.

    Raises:
        InputError: naming what is missing with the place where it is published, or what is wrong.
    """
    if not source.is_dir():
        what = "a file" if source.exists() else "nothing"
        raise InputError(
            f"{source}: found {what}, expected the folder of {layout.title} as published: {WHERE}"
        )
    first, last = frames or layout.frames
    labels = _labels(source / LABELS)
    if not 0 <= first <= last < len(labels):
        raise InputError("--frames", f"{first}-{last}", f"frames of 0 to {len(labels) - 1}")
    rig = _rig(source, layout)
    joints_m = labels[first : last + 1].copy()
    number = np.arange(first, last + 1)
    scored = np.zeros(len(number), dtype=bool)
    for low, high in layout.scored:
        scored |= (number >= low) & (number <= high)
    joints_m[~scored] = np.nan
    found = detected_views(
        detections, rig, FPS, (first, last), lambda: _first_image(source, rig.camera_ids),
        folders or {}, progress,
    )  # fmt: skip
    return Recording(
        name=layout.title,
        rig=rig,
        fps=FPS,
        num_slots=len(number),
        skeleton=found.skeleton,
        views=found.views,
        truth=Truth(SHELF14, tuple(f"actor{n + 1}" for n in range(labels.shape[1])), joints_m),
        truth_complete=False,
        scored_slots=(0, len(number)),
        detector=found.detector,
        source=f"{layout.title}, Belagiannis et al., CVPR 2014; research use only.{found.note}",
    )


def import_campus(
    source: Path,
    frames: tuple[int, int] | None = None,
    detections: Path | None = None,
    folders: Mapping[str, str] | None = None,
    progress: Progress = iter,
) -> Recording:
    """Read Campus as it is published, see `import_published`."""
    return import_published(source, CAMPUS, frames, detections, folders, progress)


def _labels(path: Path) -> Floats:
    """Return `(num_frames, num_actors, 14, 3)` metres, NaN where nobody is labelled."""
    from scipy.io import loadmat

    if not path.is_file():
        raise InputError(f"{path}: missing: the labels, published at {WHERE}")
    with open_regular(path, MAX_LABEL_BYTES) as file:
        try:
            table: dict[str, Any] = loadmat(file, variable_names=["actor3D"])
        except Exception as error:  # scipy raises whatever broken bytes lead it to
            reason = reason_of(error)[:200]
            raise InputError(f"{path}: found no MATLAB file that can be read ({reason})") from None
    if "actor3D" not in table:
        raise InputError(f"{path}: actor3D: missing: the 3D labels of each actor")
    actors = [_cells(person) for person in _cells(table["actor3D"])]
    lengths = {len(person) for person in actors}
    if len(lengths) != 1 or not 0 < max(lengths) <= MAX_FRAMES:
        raise InputError(
            f"{path}: actor3D: found actors of {sorted(lengths)[:5]} frames, expected all alike"
        )
    joints_m = np.full((max(lengths), len(actors), 14, 3), np.nan)
    for person, poses in enumerate(actors):
        for frame, cell in enumerate(poses):
            pose = _innermost(cell)
            if pose.shape == (14, 3):
                joints_m[frame, person] = pose
            elif pose.size > 1:  # people who are not there are empty, or one number
                raise InputError(
                    f"{path}: actor3D: actor {person + 1} frame {frame}: found shape {pose.shape}, "
                    "expected (14, 3)"
                )
    if (np.abs(joints_m) > METRE_LIMIT).any():
        raise InputError(f"{path}: actor3D: found a coordinate beyond {METRE_LIMIT:g} metres")
    return joints_m


def _cells(value: Any) -> list[Any]:
    """Return the entries of a MATLAB cell array, which may stand in cells of one entry."""
    while value.dtype == object and value.size == 1:
        value = value.item()
    return list(value.ravel()) if value.dtype == object else [value]


def _innermost(value: Any) -> Floats:
    while isinstance(value, np.ndarray) and value.dtype == object and value.size == 1:
        value = value.item()
    found = np.asarray(value)
    return found.astype(np.float64) if found.dtype.kind in "fiu" else np.zeros(0)


def _rig(source: Path, layout: Layout) -> Rig:
    if (source / layout.calibration).is_file() and not (source / "Calibration").exists():
        return _rig_of_voxelpose(source / layout.calibration, layout)
    cameras = []
    for number in range(layout.cameras):
        path = source / "Calibration" / f"P{number}.txt"
        if not path.is_file():
            raise InputError(
                f"{path}: missing: a projection matrix, published at {WHERE}; or "
                f"{layout.calibration} of VoxelPose in {source}"
            )
        text = read_bytes(path, MAX_MATRIX_BYTES).decode("utf-8", errors="replace")
        try:
            values = [float(word) for word in text.replace(",", " ").split()]
        except ValueError:
            values = []
        if len(values) != 12 or not np.isfinite(values).all():
            raise InputError(f"{path}: found no 3 x 4 projection matrix, expected 12 numbers")
        K, R, t = decomposed(np.array(values).reshape(3, 4), str(path))
        try:
            cameras.append(
                Camera.from_world_to_camera(f"Camera{number}", layout.image_size, K, R, t)
            )
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    return Rig(tuple(cameras))


def _rig_of_voxelpose(path: Path, layout: Layout) -> Rig:
    """Read the cameras that VoxelPose publishes, which do not say their image size."""
    rig = load_rig(path)
    if rig.camera_ids != tuple(str(number) for number in range(layout.cameras)):
        raise InputError(f"{path}: found other cameras, expected 0 to {layout.cameras - 1}")
    return Rig(
        tuple(
            replace(camera, camera_id=f"Camera{camera.camera_id}", image_size=layout.image_size)
            for camera in rig.cameras
        )
    )


def decomposed(projection: Floats, where: str = "projection") -> tuple[Floats, Floats, Floats]:
    """Part a projection matrix into K, R, t with P ~ K [R | t] (Hartley and Zisserman, 6.2.4).

    Args:
        projection: `(3, 4)` pixel-from-world, of any scale and sign.
        where: the file, for errors.

    Returns:
        `(3, 3)` K with positive focal lengths and K[2, 2] = 1; `(3, 3)` rotation; `(3,)` t.
    """
    from scipy.linalg import rq

    if abs(np.linalg.det(projection[:, :3])) <= 1e-12 * np.abs(projection[:, :3]).max() ** 3:
        raise InputError(f"{where}: found a matrix of rank below 3, expected a projection matrix")
    if np.linalg.det(projection[:, :3]) < 0:
        projection = -projection
    upper, rotation = rq(projection[:, :3])
    signs = np.sign(np.diag(upper))
    upper, rotation = upper * signs, signs[:, None] * rotation
    t = np.linalg.solve(upper, projection[:, 3])
    return upper / upper[2, 2], rotation, t


def _first_image(source: Path, camera_ids: Sequence[str]) -> int:
    """Return the lowest number of the images, at which `e3pose detect` begins to count."""
    numbers = [
        frame_number(path.name)
        for camera_id in camera_ids
        for kind in IMAGES
        for path in (source / camera_id).glob(kind)
    ]
    if not numbers:
        raise InputError(
            f"{source / camera_ids[0]}: missing: the images that were detected, from {WHERE}"
        )
    return min(numbers)
