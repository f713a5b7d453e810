"""BVH, motion files of animation tools: text, y up, one person per file.

The tree of bones of `bones`, then six numbers of the root and three angles of every other node a
frame: degrees about z, x and y in this order, each about the axes turned before. A node that moves
has its place beside its parent before them, or alone where it does not turn. The format has no
missing value: where no frame tells a rotation or place, that of the frame before is kept.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.atomic import atomic_file
from e3pose.model.take import Take
from e3pose.output.exports.base import PER_METRE, ExportSettings
from e3pose.output.exports.bone_names import bone_names
from e3pose.output.exports.bones import Bones, bones_of, count_held, held, present

END_SHARE = 0.3  # of the length of the bone before: how far a hand goes on, for its looks
PLACES = "Xposition Yposition Zposition"
CHANNELS = "Zrotation Xrotation Yrotation"


def write_bvh(take: Take, dest: Path, settings: ExportSettings) -> str:
    """Write the one person of a take; frame 0 is the first in which the person is there."""
    (motion,) = take.motions
    bones = bones_of(motion, take.skeleton)
    units = settings.units or "m"
    named = replace(bones, names=tuple(bone_names(bones.names, settings.names)))
    # A rig has hands, feet and a head, which End Sites are not: there they are joints at rest.
    whole = settings.names is not None
    lines = ["HIERARCHY", *_hierarchy(named, 0, PER_METRE[units], 0, whole)]
    lines += ["MOTION", f"Frames: {len(motion)}", f"Frame Time: {take.interval_s:.8f}"]
    root = PER_METRE[units] * held(bones.root_m, present(bones.root_m))
    angles = euler_zxy(bones.rotations)
    places = {n: PER_METRE[units] * held(m, present(m)) for n, m in bones.moved_m.items()}
    moving = [node for node in _depth_first(bones, 0) if _moves(bones, node, whole)]
    turned = {node: angles[:, node] for node in moving if _turns(bones, node)}
    columns = [each[node] for node in moving for each in (places, turned) if node in each]
    numbers = np.concatenate([root, *columns], axis=1)
    with (
        atomic_file(dest, private=True) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        file.write("\n".join(lines) + "\n")
        for row in numbers.tolist():
            file.write(" ".join(f"{value:.5f}" for value in row) + "\n")
    kept = count_held(bones)
    note = f"; {kept} of {len(motion)} frames keep some rotation of the one before" if kept else ""
    begins_s = motion.first * take.interval_s  # the format knows no time of its own
    return f"{units}, y up, {len(bones.names)} nodes, begins at {begins_s:.2f} s{note}"


def euler_zxy(rotations: Floats) -> Floats:
    """Return `(num_frames, num_nodes, 3)` degrees about z, x, y with R = Rz Rx Ry, without jumps.

    Args:
        rotations: `(num_frames, num_nodes, 3, 3)`.
    """
    x = np.arcsin(np.clip(rotations[..., 2, 1], -1, 1))
    z = np.arctan2(-rotations[..., 0, 1], rotations[..., 1, 1])
    y = np.arctan2(-rotations[..., 2, 0], rotations[..., 2, 2])
    return np.degrees(np.unwrap(np.stack([z, x, y], axis=-1), axis=0))


def _hierarchy(bones: Bones, node: int, scale: float, depth: int, whole: bool) -> list[str]:
    """Return the lines of a node and of the nodes below it; `whole`: its ends are joints, too."""
    tab = "\t" * depth
    offset = " ".join(f"{value:.6f}" for value in scale * bones.offsets_m[node])
    children = bones.children(node)
    moves = _moves(bones, node, whole)
    kind = "ROOT" if node == 0 else "JOINT" if moves else "End Site"
    lines = [f"{tab}{kind} {bones.names[node]}" if moves else f"{tab}{kind}", f"{tab}{{"]
    lines.append(f"{tab}\tOFFSET {offset}")
    if moves:
        what = f"{PLACES} " * (node == 0 or node in bones.moved_m)
        what = (what + CHANNELS * _turns(bones, node)).strip()
        lines.append(f"{tab}\tCHANNELS {len(what.split())} {what}")
    for child in children:
        lines += _hierarchy(bones, child, scale, depth + 1, whole)
    if moves and not children:
        end = " ".join(f"{value:.6f}" for value in scale * END_SHARE * bones.offsets_m[node])
        lines += [f"{tab}\tEnd Site", f"{tab}\t{{", f"{tab}\t\tOFFSET {end}", f"{tab}\t}}"]
    return [*lines, f"{tab}}}"]


def _moves(bones: Bones, node: int, whole: bool) -> bool:
    """Return whether a node has numbers a frame."""
    return whole or node in bones.moved_m or bool(bones.children(node))


def _turns(bones: Bones, node: int) -> bool:
    """Return whether a node has angles a frame."""
    return node not in bones.moved_m or bool(bones.measured[:, node].any())


def _depth_first(bones: Bones, node: int) -> list[int]:
    return [node, *(n for child in bones.children(node) for n in _depth_first(bones, child))]
