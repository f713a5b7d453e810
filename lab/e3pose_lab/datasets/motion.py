"""CMU motion capture: clips as recordings with truth only."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.model.rigs import ring_rig
from e3pose.model.skeleton import CMU31
from e3pose.recording import Recording, Truth, ViewSeries
from e3pose.recording.arrays import floats, load_arrays, open_archive
from e3pose.recording.detections.views import MAX_SLOTS, check_fps

FPS = 30.0
SOURCE = (
    "CMU Graphics Lab Motion Capture Database, mocap.cs.cmu.edu; free for all uses. Truth only: "
    "the cameras are made up and saw nothing."
)
CLIP = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
NAMES_KEY = "joint_names"
MAX_CLIPS = 10_000
# The bones in the order of CMU-31, each placed at its far end.
BONES = (
    "root", "lhipjoint", "rhipjoint", "lowerback", "lfemur", "ltibia", "lfoot", "ltoes", "rfemur",
    "rtibia", "rfoot", "rtoes", "upperback", "thorax", "lowerneck", "lclavicle", "rclavicle",
    "upperneck", "head", "lhumerus", "lradius", "lwrist", "lhand", "lthumb", "lfingers", "rhumerus",
    "rradius", "rwrist", "rhand", "rthumb", "rfingers",
)  # fmt: skip
REACH_M = (0.3, 2.0)  # from the hips to the farthest joint, of a small child or a giant
RING_CAMERAS = 5
RING_HEIGHT_M = 2.0
RING_RADIUS_M = 4.2  # at least; people stay within half of it, as in a simulated ring
IMAGE_SIZE = (1032, 776)


def cmu_clips(source: Path) -> list[str]:
    """Return the names of the clips in an .npz; raise `InputError` if it holds none."""
    with open_archive(source) as archive:
        members = archive.namelist()
    names = [name.removesuffix(".npy") for name in members if name != f"{NAMES_KEY}.npy"]
    if not names or len(names) > MAX_CLIPS:
        raise InputError(f"{source}: found {len(names)} clips, expected 1 to {MAX_CLIPS}")
    for name in names:
        _check_clip(source, name)
    return names


def import_cmu(source: Path, clip: str, fps: float = FPS) -> Recording:
    """Read one clip of the CMU motion capture database.

    Args:
        source: an .npz with `joint_names` `(31,)` and, per clip, `(num_slots, 31, 3)` metres, z up.
        clip: the name of its array, such as `02_01`.
        fps: frames per second of the clips.

    Returns:
        A recording of one person with truth and without any view. As every recording has a rig, a
        ring of five cameras is made up around the clip, `default_ring`.

    Raises:
        InputError: naming the file and the array that is missing, broken or no body in metres.
    """
    check_fps(fps)
    _check_clip(source, clip)
    arrays = load_arrays(source, {NAMES_KEY: (len(CMU31),), clip: ("num_slots", len(CMU31), 3)})
    for found, bone in zip(arrays[NAMES_KEY].tolist(), BONES, strict=True):
        if found != bone:
            raise InputError(
                f"{source}: array {NAMES_KEY!r}: found {str(found)[:40]!r}, expected {bone!r}, "
                "as the CMU database orders them"
            )
    joints_m = floats(source, clip, arrays[clip], finite=True)
    if not 1 <= len(joints_m) <= MAX_SLOTS:
        raise InputError(
            f"{source}: array {clip!r}: found {len(joints_m)} frames, expected 1 to {MAX_SLOTS}"
        )
    apart = np.linalg.norm(joints_m - joints_m[:, :1], axis=-1).max(axis=-1)
    reach, (least, most) = float(np.median(apart)), REACH_M
    if not least <= reach <= most:
        raise InputError(
            f"{source}: array {clip!r}: found {reach:.3g} from the hips to the farthest joint, "
            f"expected {least} to {most} metres"
        )
    rig = default_ring(joints_m[:, 0])
    nothing = ViewSeries.from_views([], [], [], len(CMU31))
    return Recording(
        name=f"CMU {clip}",
        rig=rig,
        fps=fps,
        num_slots=len(joints_m),
        skeleton=CMU31,
        views=(nothing,) * len(rig),
        truth=Truth(CMU31, ("person1",), joints_m[:, None]),
        source=SOURCE,
    )


def default_ring(path_m: Floats) -> Rig:
    """Make up cameras for people who were captured without any.

    Five cameras of 1032 x 776 pixels, 2 m high, on a ring about the middle of `path_m` `(num_slots,
    3)`, metres, z up, floor at z = 0; 4.2 m from it, or twice as far as the path leads from there.
    The same path always gives the same cameras.
    """
    ground = path_m[:, :2]
    middle = (ground.min(axis=0) + ground.max(axis=0)) / 2
    reach = float(np.linalg.norm(ground - middle, axis=-1).max())
    ring = ring_rig(
        RING_CAMERAS,
        max(RING_RADIUS_M, 2 * reach),
        RING_HEIGHT_M,
        IMAGE_SIZE,
        np.random.default_rng(0),
    )
    shift = np.eye(4)
    shift[:2, 3] = middle
    return Rig(
        tuple(replace(each, T_world_camera=shift @ each.T_world_camera) for each in ring.cameras)
    )


def _check_clip(source: Path, name: str) -> None:
    if not CLIP.fullmatch(name) or name == NAMES_KEY:  # it becomes the name of a folder
        raise InputError(f"{source}: clip: found {name[:64]!r}, expected letters, digits, _ and -")
