"""BVH motion capture of one person as a recording with truth only."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording, Truth, ViewSeries
from e3pose.recording.detections.views import check_fps
from e3pose_lab.datasets.bvh_file import Bvh, places_of, read_bvh
from e3pose_lab.datasets.motion import default_ring

SOURCE = "Truth only: motion capture; the cameras are made up and saw nothing."
UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
REACH_M = (0.5, 1.3)  # from the hips to the farthest joint, of a child or an adult
USUAL_REACH_M = 0.95
# What tools call the joint at which a limb begins, without sides: Biovision, CMU's conversions and
# MotionBuilder, Mixamo, Poser, VRM, Unreal, and what `e3pose export` writes.
LIMBS = {
    "shoulder": ("arm", "shoulder", "shldr", "upperarm", "uparm"),
    "elbow": ("forearm", "elbow", "lowerarm", "lowarm"),
    "wrist": ("hand", "wrist"),
    "hip": ("upleg", "hip", "thigh", "upperleg"),
    "knee": ("leg", "knee", "shin", "calf", "lowerleg", "lowleg"),
    "ankle": ("foot", "ankle"),
}
ARMS = ("arm", "upperarm", "uparm")
NECKS, HEADS = ("neck", "neck1", "upperneck"), ("head",)
SIDES = {"left": ("left", "l"), "right": ("right", "r")}


def import_bvh(
    source: Path, scale_m: float | None = None, z_up: bool = False
) -> tuple[Recording, float]:
    """Read a file.

    Args:
        source: the file.
        scale_m: metres per unit of the file; by default metres, centimetres, millimetres or inches,
            whichever makes a person of usual size.
        z_up: whether the z axis of the file points up, in place of y.

    Returns:
        A recording of one person in COCO-17 with truth and without any view, whose floor is where
        the lowest joints are, and the metres per unit. The face is made up from head and neck.

    Raises:
        InputError: for a file that is none, without joints that are needed, or of no usual size.
    """
    bvh = read_bvh(source)
    fps = check_fps(round(1 / bvh.interval_s, 3))
    found = joints_of(bvh, source)
    places = places_of(bvh)
    if not z_up:
        places = places[..., [0, 2, 1]] * [1, -1, 1]
    root = places[:, :1]
    reach = float(np.median(np.linalg.norm(places - root, axis=-1).max(axis=1)))
    scale_m = _scale_m(reach, source) if scale_m is None else scale_m
    if not REACH_M[0] / 2 <= reach * scale_m <= REACH_M[1] * 1.5:
        least, most = REACH_M
        raise InputError(
            f"{source}: found {reach * scale_m:.3g} m from the hips to the farthest joint, "
            f"expected about {least:g} to {most:g} m: --scale METRES-PER-UNIT"
        )
    places = places * scale_m
    # Somebody who lies for half of the time is on the floor as well as somebody who stands.
    places[..., 2] -= np.quantile(places[..., 2].min(axis=1), 0.05)
    joints_m = np.full((len(places), len(COCO17), 3), np.nan)
    for joint, node in found.items():
        if joint in COCO17.joints:
            joints_m[:, COCO17.index(joint)] = places[:, node]
    neck, top = places[:, found["neck"]], places[:, found["top"]]
    joints_m[:, :5] = face_of(neck, top, joints_m[:, 5] - joints_m[:, 6])
    rig = default_ring(root[:, 0] * scale_m)
    nothing = ViewSeries.from_views([], [], [], len(COCO17))
    recording = Recording(
        name=source.stem[:100],
        rig=rig,
        fps=fps,
        num_slots=len(joints_m),
        skeleton=COCO17,
        views=(nothing,) * len(rig),
        truth=Truth(COCO17, ("person1",), joints_m[:, None]),
        source=SOURCE,
    )
    return recording, scale_m


def joints_of(bvh: Bvh, source: Path) -> dict[str, int]:
    """Return the node of each joint, and of `neck` and `top` of the head.

    Raises:
        InputError: naming the joints that are missing.
    """
    words = [_word(node.name) for node in bvh.nodes]
    known = _limbs(bvh, words)
    missing = [f"{s} {j}" for s in SIDES for j in LIMBS if f"{s}_{j}" not in known]
    if missing:
        listed = ", ".join(node.name for node in bvh.nodes if node.channels)
        raise InputError(f"{source}: found no {', '.join(missing)} among {listed[:300]}")
    necks = [i for i, word in enumerate(words) if word in NECKS]
    necks += [max(bvh.nodes[i].parent, 0) for i, word in enumerate(words) if word in HEADS]
    if not necks:
        raise InputError(f"{source}: found no joint Neck or Head, expected one")
    return {**known, "neck": necks[0], "top": _top(bvh, necks[0])}


def _limbs(bvh: Bvh, words: list[str]) -> dict[str, int]:
    """Return the nodes of limbs: where they begin, and where the last one ends."""
    known: dict[str, int] = {}
    ends = {node.parent: i for i, node in enumerate(bvh.nodes) if not node.channels}
    for side, marks in SIDES.items():
        for joint, names in LIMBS.items():
            called = {word for m in marks for n in names for word in (m + n, n + m)}
            found = [i for i, word in enumerate(words) if word in called]
            if joint == "shoulder":  # beside an arm, a shoulder is the collar bone
                arms = {word for m in marks for n in ARMS for word in (m + n, n + m)}
                found = [i for i in found if words[i] in arms] + found
            known |= {f"{side}_{joint}": found[0]} if found else {}
        for joint, before in (("wrist", "elbow"), ("ankle", "knee")):
            begin = known.get(f"{side}_{before}", -1)
            if f"{side}_{joint}" not in known and begin in ends:
                known[f"{side}_{joint}"] = ends[begin]
    return known


def _top(bvh: Bvh, neck: int) -> int:
    """Return the node above the neck, in no arm, that is farthest from it."""
    away = {neck: 0.0}
    for index, node in enumerate(bvh.nodes):
        word = _word(node.name)
        if node.parent in away and (node.parent != neck or word in HEADS or not node.channels):
            away[index] = away[node.parent] + float(np.linalg.norm(node.offset))
    return max(away, key=lambda index: away[index])


def face_of(below_m: Floats, top_m: Floats, across_m: Floats) -> Floats:
    """Return the face of COCO-17, which motion capture lacks, made up from neck and head.

    Args:
        below_m: `(num_slots, 3)` where the head begins.
        top_m: `(num_slots, 3)` its top.
        across_m: `(num_slots, 3)` from the right shoulder to the left.

    Returns:
        `(num_slots, 5, 3)` nose, eyes and ears, left before right.
    """
    left, up = _unit(across_m), _unit(top_m - below_m)
    ahead, middle = _unit(np.cross(left, up)), (top_m + below_m) / 2
    eyes = [middle + 0.09 * ahead + 0.03 * side * left + 0.03 * up for side in (1, -1)]
    ears = [middle + 0.07 * side * left for side in (1, -1)]
    return np.stack([middle + 0.11 * ahead, *eyes, *ears], axis=-2)


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-6))


def _word(name: str) -> str:
    """Return a joint's name without the prefix of a tool, and without marks between words."""
    return re.sub(r"[^a-z0-9]", "", name.rpartition(":")[2].lower().removeprefix("mixamorig"))


def _scale_m(reach: float, source: Path) -> float:
    """Return the unit in which a person has about the usual size."""
    fits = {name: reach * unit_m for name, unit_m in UNITS_M.items()}
    name, reach_m = min(fits.items(), key=lambda fit: abs(np.log(fit[1] / USUAL_REACH_M + 1e-9)))
    if not REACH_M[0] <= reach_m <= REACH_M[1]:
        units = ", ".join(UNITS_M)
        raise InputError(
            f"{source}: found {reach:.3g} from the hips to the farthest joint, a person in none of "
            f"{units}, expected --scale METRES-PER-UNIT"
        )
    return UNITS_M[name]
