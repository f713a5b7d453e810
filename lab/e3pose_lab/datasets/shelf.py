"""Shelf (Belagiannis et al., CVPR 2014) with OpenPose detections, from one .npz of arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.model.skeleton import SHELF14, load_skeleton
from e3pose.recording import Recording, Truth, ViewSeries
from e3pose.recording.arrays import floats, integers, load_arrays
from e3pose.recording.detections.views import poses_from_triples
from e3pose.recording.json_lines import METRE_LIMIT

FPS = 25.0
MAX_VIEWS = 500_000
SOURCE = (
    "Shelf, Belagiannis et al., CVPR 2014; detections by OpenPose. Research use only, do not "
    "redistribute."
)


def import_shelf(source: Path, skeleton: Literal["coco17", "body25"] = "coco17") -> Recording:
    """Read the Shelf sequence with its detections.

    Args:
        source: an .npz with `K`, `R` `(num_cameras, 3, 3)`, `t` `(num_cameras, 3)`, `image_size`
            `(2,)`, `det_<skeleton>` `(num_poses, num_joints, 3)` x, y, score, `det_view` and
            `det_frame` `(num_poses,)`, and `gt3d` `(num_slots, num_persons, 14, 3)` metres.
        skeleton: which of the detections to take.

    Returns:
        A recording at 25 fps, a slot per row of `gt3d`; rows of people are `actor1`, `actor2`, ...
        Every camera has a view in every slot, empty where nobody was found.

    Raises:
        InputError: for another skeleton, or an array that is missing or wrong.
    """
    if skeleton not in ("coco17", "body25"):
        raise InputError(f"--skeleton: found {skeleton!r}, expected coco17 or body25")
    convention = load_skeleton(skeleton)
    detections = f"det_{skeleton}"
    arrays = load_arrays(
        source,
        {
            "K": ("num_cameras", 3, 3),
            "R": ("num_cameras", 3, 3),
            "t": ("num_cameras", 3),
            "image_size": (2,),
            "gt3d": ("num_slots", "num_persons", 14, 3),
            detections: ("num_poses", len(convention), 3),
            "det_view": ("num_poses",),
            "det_frame": ("num_poses",),
        },
    )
    if len(arrays["K"]) * len(arrays["gt3d"]) > MAX_VIEWS:
        raise InputError(
            f"{source}: array 'gt3d': found {len(arrays['gt3d'])} slots of {len(arrays['K'])} "
            f"cameras, expected at most {MAX_VIEWS} views"
        )
    K, R, t = (floats(source, name, arrays[name], finite=True) for name in ("K", "R", "t"))
    size = integers(source, "image_size", arrays["image_size"], below=100_000)
    joints_m = floats(source, "gt3d", arrays["gt3d"], finite=False)
    if (np.abs(joints_m) > METRE_LIMIT).any():
        raise InputError(
            f"{source}: array 'gt3d': found a coordinate beyond {METRE_LIMIT:g}, expected metres"
        )
    triples = floats(source, detections, arrays[detections], finite=True)
    num_slots = len(joints_m)
    camera_of = integers(source, "det_view", arrays["det_view"], below=len(K))
    slot_of = integers(source, "det_frame", arrays["det_frame"], below=num_slots)
    try:
        rig = _rig((int(size[0]), int(size[1])), K, R, t)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    people = [
        poses_from_triples(each, f"{source}: {detections}")
        for each in _by_frame(triples, camera_of * num_slots + slot_of, len(rig) * num_slots)
    ]
    times_s = [slot / FPS for slot in range(num_slots)]
    views = tuple(
        ViewSeries.from_views(
            people[n * num_slots : (n + 1) * num_slots], range(num_slots), times_s, len(convention)
        )
        for n in range(len(rig))
    )
    return Recording(
        name=f"Shelf, OpenPose {skeleton}",
        rig=rig,
        fps=FPS,
        num_slots=num_slots,
        skeleton=convention,
        views=views,
        truth=Truth(SHELF14, tuple(f"actor{n + 1}" for n in range(joints_m.shape[1])), joints_m),
        truth_complete=False,
        scored_slots=(0, num_slots),  # what everybody reports: never to be learned from
        detector="openpose",
        source=SOURCE,
    )


def _rig(
    image_size: tuple[int, int],
    K: NDArray[np.float64],
    R: NDArray[np.float64],
    t: NDArray[np.float64],
) -> Rig:
    return Rig(
        tuple(
            Camera.from_world_to_camera(f"cam{n}", image_size, K[n], R[n], t[n])
            for n in range(len(K))
        )
    )


def _by_frame(
    triples: NDArray[np.float64], frame_of: NDArray[np.int64], num_frames: int
) -> list[NDArray[np.float64]]:
    """Return the rows of every frame, in the order in which they stand."""
    counts = np.bincount(frame_of, minlength=num_frames)
    return np.split(triples[np.argsort(frame_of, kind="stable")], np.cumsum(counts)[:-1])
