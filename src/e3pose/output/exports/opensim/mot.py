"""MOT, motions of OpenSim: a table of coordinates over time, one person per file.

Coordinates of the model from the places of joints are angles as OpenSim has them, degrees. Each
body has a frame of x ahead, y up and z to the right from directions between joints; a joint's
angles are those of its body's frame in its parent's, about z, then x, then y, as in the model. The
pelvis has the direction of the trunk, which keypoints do not tell apart, so that the lumbar angles
are what the shoulders do against the hips. A thigh or upper arm turns about itself as the plane of
its bent knee or elbow says; where the limb is straight, as little as it can.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError
from e3pose.model.skeleton import Skeleton
from e3pose.model.take import Take
from e3pose.output.exports.base import ExportSettings, person_name, y_up
from e3pose.output.exports.bones import held, least_rotation
from e3pose.output.exports.opensim.markers import PLACES, SIDES
from e3pose.output.exports.opensim.model import BALL_M, HEEL_M, SHIFTS, SOLE_M
from e3pose.output.exports.table import dot, unit

NEEDED = ("left_hip", "right_hip", "left_shoulder", "right_shoulder")
BENT_DEG = (5.0, 20.0)  # from the first on, a knee or elbow begins to tell its plane; then it does
LIMBS = (
    ("hip", "knee", "ankle", "pelvis", -1.0, ("hip_flexion", "hip_adduction", "hip_rotation"),
     "knee_angle"),
    ("shoulder", "elbow", "wrist", "torso", 1.0, ("arm_flex", "arm_add", "arm_rot"), "elbow_flex"),
)  # fmt: skip


def write_mot(take: Take, dest: Path, settings: ExportSettings) -> str:
    """Write the one person of a take; an angle that a frame does not tell is the one before.

    Raises:
        InputError: for a skeleton without hips and shoulders, or a person who never shows them.
    """
    (motion,) = take.motions
    lacking = [joint for joint in NEEDED if joint not in take.skeleton.joints]
    if lacking:
        raise InputError(f"{dest}: found a skeleton without {lacking[0]}, expected {NEEDED}")
    columns = [take.skeleton.index(joint) for joint in NEEDED]
    if not motion.known[:, columns].all(axis=1).any():
        raise InputError(
            f"{person_name(motion.track_id)}: found no frame with hips and shoulders, expected "
            "one: leave the person out with --track"
        )
    found = coordinates(motion.joints_m, take.skeleton)
    whole = {name: in_every_frame(values) for name, values in found.items()}
    times_s = (motion.first + np.arange(len(motion))) * take.interval_s
    table = np.column_stack([times_s, *(values for values, _ in whole.values())])
    header = [
        dest.stem, "version=1", f"nRows={len(table)}", f"nColumns={table.shape[1]}",
        "inDegrees=yes", "endheader", "\t".join(["time", *whole]),
    ]  # fmt: skip
    with (
        atomic_file(dest, private=True) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        file.write("\n".join(header) + "\n")
        np.savetxt(file, table, fmt="%.6f", delimiter="\t")
    kept = sum(count for _, count in whole.values())
    share = kept / (len(table) * len(whole))
    note = f"; {100 * share:.1f} % of the values are those of an earlier frame" if kept else ""
    return f"{len(whole)} coordinates, degrees and metres, y up{note}"


def coordinates(joints_m: Floats, skeleton: Skeleton) -> dict[str, Floats]:
    """Return the model's coordinates by name, `(num_frames,)` degrees or metres, NaN where unknown.

    Args:
        joints_m: `(num_frames, num_joints, 3)` metres, z up, NaN where missing.
        skeleton: of the joints, with both hips and both shoulders.
    """
    places = {name: y_up(joints_m[:, index]) for index, name in enumerate(skeleton.joints)}
    hips, shoulders = (
        (places[f"left_{girdle}"] + places[f"right_{girdle}"]) / 2 for girdle in ("hip", "shoulder")
    )
    frames = {
        name: _frame(shoulders - hips, places[f"right_{girdle}"] - places[f"left_{girdle}"])
        for name, girdle in (("pelvis", "hip"), ("torso", "shoulder"))
    }
    found: dict[str, Floats] = {}
    _add(found, frames["pelvis"], ("pelvis_tilt", "pelvis_list", "pelvis_rotation"), 1.0)
    found |= {name: hips[:, axis] for axis, name in enumerate(SHIFTS)}
    back = np.swapaxes(frames["pelvis"], 1, 2) @ frames["torso"]
    _add(found, back, ("lumbar_extension", "lumbar_bending", "lumbar_rotation"), 1.0)
    for side, suffix, sign in SIDES:
        for near, middle, far, parent, bends, names, bend in LIMBS:
            ends = [places.get(f"{side}_{joint}") for joint in (near, middle, far)]
            if ends[1] is None or ends[0] is None:
                continue
            upper = ends[1] - ends[0]
            lower = None if ends[2] is None else ends[2] - ends[1]
            frame, angle = _limb(frames[parent], upper, lower, bends)
            local = np.swapaxes(frames[parent], 1, 2) @ frame
            _add(found, local, tuple(f"{name}_{suffix}" for name in names), sign)
            if lower is not None:
                found[f"{bend}_{suffix}"] = angle
            toe, ankle = places.get(f"{side}_big_toe"), places.get(f"{side}_ankle")
            if near == "hip" and lower is not None and toe is not None and ankle is not None:
                found[f"ankle_angle_{suffix}"] = _ankle(frame, lower, toe - ankle)
    return found


def in_every_frame(values: Floats) -> tuple[Floats, int]:
    """Return `(num_frames,)` values with the one before where there is none, and how many had none.

    A value that no frame tells is 0.
    """
    known = np.isfinite(values)
    if not known.any():
        return np.zeros_like(values), len(values)
    return held(values, known), int((~known).sum())


def _limb(
    above: Floats, upper: Floats, lower: Floats | None, bends: float
) -> tuple[Floats, Floats]:
    """Return the frame `(num_frames, 3, 3)` of a thigh or upper arm and its bend in degrees.

    Args:
        above: `(num_frames, 3, 3)` frame of the parent.
        upper: `(num_frames, 3)` from hip to knee, or shoulder to elbow.
        lower: `(num_frames, 3)` from there on; None where the skeleton has none.
        bends: 1 where the lower part bends ahead, -1 behind.
    """
    least = least_rotation(-above[:, :, 1], upper) @ above
    side, bend = least[:, :, 2], np.zeros(len(upper))
    if lower is not None:
        across = bends * np.cross(unit(upper), unit(lower))
        bend = np.degrees(np.arctan2(np.linalg.norm(across, axis=1), dot(unit(upper), lower)
                                     / np.linalg.norm(lower, axis=1)))  # fmt: skip
        low, high = BENT_DEG
        tells = np.nan_to_num(np.clip((bend - low) / (high - low), 0.0, 1.0))[:, None]
        side = np.where(tells > 0, tells * unit(across) + (1 - tells) * side, side)
    return _frame(-upper, side), bend


def _ankle(thigh: Floats, shank: Floats, foot: Floats) -> Floats:
    """Return by how many degrees the toes are raised against the model's foot at rest.

    Args:
        thigh: `(num_frames, 3, 3)` frame, about whose z the ankle turns.
        shank: `(num_frames, 3)` from knee to ankle.
        foot: `(num_frames, 3)` from ankle to big toe.
    """
    down, right = unit(shank), thigh[:, :, 2]
    ahead = np.cross(-down, right)
    at_rest = np.arctan2(SOLE_M, HEEL_M + BALL_M + PLACES["big_toe"].at_m[0])
    return np.asarray(np.degrees(np.arctan2(-dot(foot, down), dot(foot, ahead)) - at_rest))


def _frame(up: Floats, right: Floats) -> Floats:
    """Return `(num_frames, 3, 3)` x ahead, y up, z to the right, with y exactly up."""
    y = unit(up)
    z = unit(right - dot(right, y)[:, None] * y)
    return np.stack([np.cross(y, z), y, z], axis=-1)


def _add(found: dict[str, Floats], turned: Floats, names: tuple[str, ...], sign: float) -> None:
    """Add the angles of rotations about z, x and y; of a left limb x and y are turned around."""
    x = np.arcsin(np.clip(turned[:, 2, 1], -1, 1))
    z = np.arctan2(-turned[:, 0, 1], turned[:, 1, 1])
    y = np.arctan2(-turned[:, 2, 0], turned[:, 2, 2])
    for name, angle, factor in zip(names, (z, x, y), (1.0, sign, sign), strict=True):
        found[name] = np.degrees(factor * _unwrapped(angle))


def _unwrapped(angle: Floats) -> Floats:
    """Return angles without jumps of a full turn; NaN stays."""
    known = np.isfinite(angle)
    result: Floats = angle.copy()
    result[known] = np.unwrap(angle[known])
    return result
