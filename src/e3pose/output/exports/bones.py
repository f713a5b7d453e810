"""Inverse kinematics: joints to a skeleton of bones with fixed lengths and rotations.

Animation formats know a tree of bones, each with an offset from its parent at rest and a rotation a
frame. The offset's length is the median of the limb over the take; the rest pose is a T-pose that
faces z with y up. From the root on, frame by frame, a bone is turned by the least rotation that
points it at where its joint is; hips, shoulders and head by the rotation that fits all of their
joints best (Kabsch 1976). Where those joints are at rest is measured: the median over the take of
where they are in the body's own frame, since no detector's hips are in line with its middle of the
hips. Bones point at joints from where the fixed lengths put their own ends, so that errors of
lengths do not add up along a limb. How a single bone turns about itself no keypoint tells: it turns
with its parent. All other joints of the skeleton, as fingers and the face, are nodes that move
beside their parents; hands and fingers turn as well, so that they point at the next joint.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats
from e3pose.base.errors import InputError
from e3pose.model.rotations import cross_matrices, nearest_rotation
from e3pose.model.skeleton import MEANS, Skeleton
from e3pose.model.take import Motion
from e3pose.output.exports.base import person_name, y_up

ROOT = "mid_hip"
# Nodes at the place of their parent, which let spine and head turn by themselves.
HINGES = {"spine": ROOT, "head": "neck"}
# Each bone's parents, the first that is there, and where it points at rest: x left, y up, z ahead.
REST: dict[str, tuple[tuple[str, ...], tuple[float, float, float]]] = {
    "neck": (("spine",), (0, 1, 0)),
    "top_head": (("head",), (0, 1, 0)),
    "mid_ear": (("head",), (0, 1, 0.2)),
    "nose": (("mid_ear", "head"), (0, 0, 1)),
    **{f"{s}_hip": ((ROOT,), (x, 0, 0)) for s, x in (("left", 1.0), ("right", -1.0))},
    **{f"{s}_knee": ((f"{s}_hip",), (0, -1, 0)) for s in ("left", "right")},
    **{f"{s}_ankle": ((f"{s}_knee",), (0, -1, 0)) for s in ("left", "right")},
    **{f"{s}_big_toe": ((f"{s}_ankle",), (0, -0.3, 1)) for s in ("left", "right")},
    **{f"{s}_shoulder": (("neck",), (x, 0, 0)) for s, x in (("left", 1.0), ("right", -1.0))},
    **{f"{s}_elbow": ((f"{s}_shoulder",), (x, 0, 0)) for s, x in (("left", 1.0), ("right", -1.0))},
    **{f"{s}_wrist": ((f"{s}_elbow",), (x, 0, 0)) for s, x in (("left", 1.0), ("right", -1.0))},
}
# Nodes that several joints turn, children or not; all others point at their one child.
FITTED = {
    ROOT: ("left_hip", "right_hip", "neck"),
    "neck": ("left_shoulder", "right_shoulder", ROOT),
    "head": ("top_head", "mid_ear", "nose"),
}
# Of these, the joints whose places at rest are measured; the others say which way is up.
MEASURED_AT_REST = {
    ROOT: ("left_hip", "right_hip"),
    "neck": ("left_shoulder", "right_shoulder"),
    "head": ("mid_ear", "nose"),
}
# At rest, the axes in which a skeleton's own rest has a hand: ahead, to the thumb, out of the palm.
HAND_AXES = {
    s: np.array([[x, 0, 0], [0, 0, 1.0], [0, -1, 0]]) for s, x in (("left", 1), ("right", -1))
}
STRETCH = 5000  # frames whose bones are in memory at once, which take 5 kB each
FRAMES_OF_A_JOINT = 100  # in a sample, at least, of those that show it
ROUNDS = 4  # of fitting, then measuring; the first three bring nearly all of it


@dataclass(frozen=True, slots=True, eq=False)
class Bones:
    """One person as bones that turn; y up, metres.

    Attributes:
        names: of the nodes, the root first, each after its parent.
        parents: `(num_nodes,)` index of each node's parent, -1 at the root.
        offsets_m: `(num_nodes, 3)` from the parent at rest; 0 at the root.
        root_m: `(num_frames, 3)` where the root is; NaN where it is missing.
        rotations: `(num_frames, num_nodes, 3, 3)` of each node beside its parent; where nothing
            tells it, that of the frame before (of the first one that is known, at the start).
        measured: `(num_frames, num_nodes)` whether the frame shows a node's rotation; nodes at the
            ends of limbs have none.
        moved_m: by node that moves, `(num_frames, 3)` where it is beside its parent, in place of
            its offset; NaN where it is missing and no node below it is there.
    """

    names: tuple[str, ...]
    parents: NDArray[np.int64]
    offsets_m: Floats
    root_m: Floats
    rotations: Floats
    measured: Flags
    moved_m: Mapping[int, Floats] = field(default_factory=dict)

    def children(self, node: int) -> list[int]:
        """Return the nodes that hang on a node."""
        return [n for n, parent in enumerate(self.parents.tolist()) if parent == node]

    def keyed(self, node: int) -> Flags:
        """Return `(num_frames,)`: where the rotation is measured, or places a joint that moves."""
        found = self.measured[:, node]
        for child in self.children(node):
            found = found | self.keyed(child)
            if child in self.moved_m:
                found = found | present(self.moved_m[child])
        return np.asarray(found)

    def turns(self, node: int) -> bool:
        """Return whether nodes other than the moving ones tell how a node turns."""
        return any(child not in self.moved_m for child in self.children(node))


def bones_of(motion: Motion, skeleton: Skeleton) -> Bones:
    """Return a person as bones.

    Raises:
        InputError: for a person whose hips were never both seen.
    """
    names, parents, offsets = rest_of(motion, skeleton)
    return _with_others(posed(names, parents, offsets, motion, skeleton), motion, skeleton)


def stretches_of(motion: Motion, skeleton: Skeleton) -> Iterator[tuple[int, Bones]]:
    """Yield a person as bones, a stretch of frames at a time, with the first frame of each.

    A motion of more frames than a stretch has is at rest as a sample of its frames is.

    Raises:
        InputError: for a person whose hips were never both seen.
    """
    if len(motion) <= STRETCH:
        yield 0, bones_of(motion, skeleton)
        return
    roots = [index for index, name in enumerate(skeleton.joints) if name in (ROOT, *MEANS[ROOT])]
    root = motion.known[:, roots or [skeleton.parents.index(-1)]].all(axis=1)  # all hang on it
    each = [np.flatnonzero(shown) for known in motion.known.T for shown in (known, known & root)]
    spread = [rows[:: max(1, len(rows) // FRAMES_OF_A_JOINT)] for rows in each]
    rows = np.unique(np.concatenate([*spread, np.arange(0, len(motion), len(motion) // STRETCH)]))
    rest = bones_of(_frames(motion, rows), skeleton)
    base = slice(len(rest.names) - len(rest.moved_m))
    before: Bones | None = None
    for begin in range(0, len(motion), STRETCH):
        part = _frames(motion, slice(begin, begin + STRETCH))
        fixed = rest.names[base], rest.parents[base], rest.offsets_m[base]
        before = _with_others(posed(*fixed, part, skeleton, before), part, skeleton, rest, before)
        yield begin, before


def _frames(motion: Motion, rows: slice | NDArray[np.int64]) -> Motion:
    names = ("joints_m", "sigma_m", "scores", "origin")
    return replace(motion, **{name: getattr(motion, name)[rows] for name in names}, dynamics=None)


def _with_others(
    bones: Bones,
    motion: Motion,
    skeleton: Skeleton,
    rest: Bones | None = None,
    before: Bones | None = None,
) -> Bones:
    """Return bones with a node for each joint that has none, if it was ever seen.

    Args:
        bones: of the motion.
        motion: of one person.
        skeleton: of its joints.
        rest: where the others are at rest; None for where they mostly are in the motion.
        before: the same of the frames before; None for none.
    """
    names, parents, offsets = list(bones.names), bones.parents.tolist(), [*bones.offsets_m]
    rotations, measured = [*bones.rotations.swapaxes(0, 1)], [*bones.measured.T]
    places, hands = _places(motion, skeleton), _hands_at_rest(skeleton)
    world, ends, moved = list[Floats](), list[Floats](), dict[int, Floats]()
    for node, parent in enumerate(parents):
        world.append(rotations[node] if parent < 0 else world[parent] @ rotations[node])
        end = bones.root_m if parent < 0 else ends[parent] + world[parent] @ offsets[node]
        ends.append(end)
    for index in sorted(range(len(skeleton)), key=skeleton.depth):
        name, above = skeleton.joints[index], skeleton.parents[index]
        if name not in names:
            while above >= 0 and skeleton.joints[above] not in names:
                above = skeleton.parents[above]
            parent = names.index(skeleton.joints[above]) if above >= 0 else 0
            local = np.einsum("fba,fb->fa", world[parent], places[name] - ends[parent])
            known = present(local)
            if not known.any() if rest is None else name not in rest.names:
                continue
            if rest is not None:
                offset = rest.offsets_m[rest.names.index(name)]
            else:
                offset = np.median(local[known], axis=0)
            if rest is None and index in hands and len(_pointed(skeleton, above, hands)) == 1:
                length = np.median(np.linalg.norm(local[known], axis=1))
                offset = hands[index] / np.linalg.norm(hands[index]) * length
            moved[len(names)] = local
            here = np.where(known[:, None], local, offset)
            ends.append(ends[parent] + np.einsum("fab,fb->fa", world[parent], here))
            world.append(world[parent])
            names.append(name)
            parents.append(parent)
            offsets.append(offset)
            rotations.append(np.tile(np.eye(3), (len(local), 1, 1)))
            measured.append(np.zeros(len(local), dtype=bool))
        if pointed := _pointed(skeleton, index, hands):
            node = names.index(name)
            wanted = np.stack([places[skeleton.joints[j]] for j in pointed], axis=1)
            wanted -= ends[node][:, None]
            measured[node] = present(wanted).all(axis=1)
            if measured[node].any():
                upper = world[parents[node]] if node else np.tile(np.eye(3), (len(wanted), 1, 1))
                still = np.array(list(pointed.values()))
                seen = np.where(measured[node][:, None, None], wanted, still)
                fitted = np.swapaxes(upper, 1, 2) @ _fit(upper, still, seen)
                rotations[node] = held(fitted, measured[node], _last(before, name))
                world[node] = upper @ rotations[node]
    made = Bones(
        tuple(names),
        np.array(parents, dtype=np.int64),
        np.stack(offsets),
        bones.root_m,
        np.stack(rotations, axis=1),
        np.stack(measured, axis=1),
        moved,
    )
    for node, local in moved.items():
        local[made.keyed(node) & ~present(local)] = offsets[node]
    return made


def _hands_at_rest(skeleton: Skeleton) -> dict[int, Floats]:
    """Return by joint of hands where it is beside its parent in a T-pose, palms down."""
    found = {}
    for index, (name, rest_m) in enumerate(zip(skeleton.joints, skeleton.rest_m, strict=False)):
        side = HAND_AXES.get(name.partition("_")[0])
        there = np.isfinite(rest_m).all() and np.any(rest_m)
        if skeleton.moves[index] == "finger" and there and side is not None:
            found[index] = np.array(rest_m) @ side
    return found


def _pointed(skeleton: Skeleton, index: int, hands: Mapping[int, Floats]) -> dict[int, Floats]:
    """Return the joints of a hand that tell how a joint turns, and where they are at rest from it.

    They are the next one of a finger, and the first one of each finger for the wrist.
    """
    below = {j: hands[j] for j in hands if skeleton.parents[j] == index}
    if index in hands and skeleton.parents[index] >= 0:
        return below if len(below) == 1 else {}  # the root of a hand stands still on the wrist
    if len(below) == 1:
        (root,) = below
        return {j: hands[root] + hands[j] for j in hands if skeleton.parents[j] == root}
    return below


def posed(
    names: tuple[str, ...],
    parents: NDArray[np.int64],
    offsets: Floats,
    motion: Motion,
    skeleton: Skeleton,
    before: Bones | None = None,
) -> Bones:
    """Return a motion as bones whose rest is known; see `Bones` for the arguments.

    `before` is the same of the frames before, if any.
    """
    places = _places(motion, skeleton)
    joints = np.stack([places[HINGES.get(name, name)] for name in names], axis=1)
    root_m, rotations, measured = _turned(names, joints, parents, offsets, before)
    return Bones(names, parents, offsets, root_m, rotations, measured)


def rest_of(
    motion: Motion, skeleton: Skeleton
) -> tuple[tuple[str, ...], NDArray[np.int64], Floats]:
    """Return names, parents and offsets of a person's bones at rest, as `Bones` has them.

    Raises:
        InputError: for a person whose hips were never both seen.
    """
    places = _places(motion, skeleton)
    root = ROOT if ROOT in places else skeleton.joints[skeleton.parents.index(-1)]
    if not present(places[root]).any():
        what = "both hips" if root == ROOT else root
        raise InputError(
            f"{person_name(motion.track_id)}: found no frame with {what}, which the bones hang "
            "on: leave the person out with --track"
        )
    nodes: dict[str, tuple[str, Floats]] = {root: ("", np.zeros(3))}  # parent and offset
    for name, (above, direction) in REST.items():
        near = {one: HINGES.get(one, one) for one in above}  # the joint at whose place a node is
        parent = next((one for one in above if near[one] in nodes), None)
        if parent is None or name not in places:
            continue
        length = np.linalg.norm(places[name] - places[near[parent]], axis=-1)
        if not np.isfinite(length).any():
            continue
        if parent not in nodes:
            nodes[parent] = (near[parent], np.zeros(3))
        rest = np.array(direction, dtype=np.float64)
        nodes[name] = (parent, rest / np.linalg.norm(rest) * float(np.nanmedian(length)))
    names = list(nodes)
    parents = np.array([names.index(p) if p else -1 for p, _ in nodes.values()], dtype=np.int64)
    offsets = np.stack([offset for _, offset in nodes.values()])
    joints = np.stack([places[HINGES.get(name, name)] for name in names], axis=1)
    return tuple(names), parents, _measured_at_rest(names, joints, parents, offsets)


def _measured_at_rest(
    names: Sequence[str], joints: Floats, parents: NDArray[np.int64], offsets: Floats
) -> Floats:
    """Return offsets with the joints of hips, shoulders and head where the take has them.

    Args:
        names: of the nodes.
        joints: `(num_frames, num_nodes, 3)` metres, NaN where missing.
        parents: `(num_nodes,)`.
        offsets: `(num_nodes, 3)` at rest, of the right lengths.
    """
    offsets = offsets.copy()
    known = present(joints)
    for name, all_of_it in FITTED.items():
        if name not in names or not set(all_of_it) <= set(names):
            continue
        node, asked = names.index(name), [names.index(each) for each in all_of_it]
        there = known[:, [node, *asked]].all(axis=1)
        if not there.any():
            continue
        wanted = joints[there][:, asked] - joints[there, node, None]
        for _ in range(ROUNDS):
            rest = rest_places(parents, offsets)
            still = rest[asked] - rest[node]
            turned = nearest_rotation(np.einsum("fca,cb->fab", wanted, still))
            local = np.median(np.einsum("fba,fcb->fca", turned, wanted), axis=0)
            for each in MEASURED_AT_REST[name]:
                row = asked.index(names.index(each))
                above = parents[asked[row]]  # itself a node whose place was measured, or this one
                base = local[asked.index(above)] if above in asked else rest[above] - rest[node]
                offsets[asked[row]] = local[row] - base
    return offsets


def held(values: Floats, known: Flags, before: Floats | None = None) -> Floats:
    """Return values with the one before where none is known, and the first known one before that.

    Args:
        values: `(num_frames, *batch)`.
        known: `(num_frames,)`, once at least.
        before: `(*batch)` the value of the frame before, if any.
    """
    last = np.maximum.accumulate(np.where(known, np.arange(len(known)), -1))
    found = values[np.where(last < 0, int(known.argmax()), last)]
    if before is not None:
        found[last < 0] = before
    return np.asarray(found)


def _last(before: Bones | None, name: str) -> Floats | None:
    """Return the rotation of a node in the last frame, if there is one."""
    if before is None:
        return None
    return np.asarray(before.rotations[-1, before.names.index(name)])


def _places(motion: Motion, skeleton: Skeleton) -> dict[str, Floats]:
    """Return joints and means of joints by name, `(num_frames, 3)` metres, y up."""
    names = skeleton.joints
    places = {name: y_up(motion.joints_m[:, index]) for index, name in enumerate(names)}
    for name, parts in MEANS.items():
        if name not in places and set(parts) <= set(names):
            places[name] = np.asarray(sum(places[part] for part in parts) / len(parts))
    return places


def _turned(
    names: Sequence[str],
    joints: Floats,
    parents: NDArray[np.int64],
    offsets: Floats,
    before: Bones | None,
) -> tuple[Floats, Floats, Flags]:
    """Return places of the root, rotations beside the parents, and where a frame tells them."""
    num_frames, num_nodes = joints.shape[:2]
    known = present(joints)
    rest = rest_places(parents, offsets)
    upright = np.tile(np.eye(3), (num_frames, 1, 1))
    local = np.tile(np.eye(3), (num_frames, num_nodes, 1, 1))
    world, ends = local.copy(), np.zeros_like(joints)
    measured = np.zeros((num_frames, num_nodes), dtype=bool)
    for node, parent in enumerate(parents.tolist()):
        above = upright if parent < 0 else world[:, parent]
        if parent < 0:
            ends[:, node] = held(joints[:, node], known[:, node])
        else:
            ends[:, node] = ends[:, parent] + above @ offsets[node]
        asked = [names.index(n) for n in FITTED.get(names[node], ()) if n in names]
        asked = asked if len(asked) == 3 else np.flatnonzero(parents == node).tolist()
        if asked:
            measured[:, node] = known[:, asked].all(axis=1) & known[:, 0]
            still = rest[asked] - rest[node]
            wanted = joints[:, asked] - ends[:, node, None]
            fitted = _fit(above, still, np.where(measured[:, node, None, None], wanted, still))
            if node == 0 and len(asked) == 3:  # the middle of the hips errs as much as either
                off = wanted[:, :2] - np.einsum("fab,cb->fca", fitted, still[:2])
                ends[:, 0] += np.where(measured[:, :1], off.sum(axis=1) / 3, 0.0)
            last = _last(before, names[node])
            if measured[:, node].any():
                local[:, node] = held(np.swapaxes(above, 1, 2) @ fitted, measured[:, node], last)
            elif last is not None:
                local[:, node] = last
        world[:, node] = above @ local[:, node]
    return np.where(known[:, :1], ends[:, 0], np.nan), local, measured


def _fit(above: Floats, rest: Floats, wanted: Floats) -> Floats:
    """Return the rotations `(num_frames, 3, 3)` of a node in the world.

    Args:
        above: `(num_frames, 3, 3)` of the parent.
        rest: `(num_joints, 3)` where joints are at rest, from the node.
        wanted: `(num_frames, num_joints, 3)` where they should be.
    """
    if len(rest) == 1:
        start = np.einsum("fab,b->fa", above, rest[0])
        return least_rotation(start, wanted[:, 0]) @ above
    return nearest_rotation(np.einsum("fca,cb->fab", wanted, rest))


def least_rotation(start: Floats, end: Floats) -> Floats:
    """Return `(num_frames, 3, 3)`: what points one vector as another, by the least angle."""
    a, b = (v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9) for v in (start, end))
    axis, cosine = np.cross(a, b), (a * b).sum(axis=-1)
    # Straight back: half a turn about any axis across.
    other = np.cross(a, np.where(np.abs(a[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    other /= np.maximum(np.linalg.norm(other, axis=-1, keepdims=True), 1e-9)
    half = 2 * other[:, :, None] * other[:, None, :] - np.eye(3)
    skew = cross_matrices(axis)
    back = cosine < -1 + 1e-9
    factor = 1 / np.where(back, 1.0, 1 + cosine)
    turned = np.eye(3) + skew + (skew @ skew) * factor[:, None, None]
    return np.where(back[:, None, None], half, turned)


def rest_places(parents: NDArray[np.int64], offsets: Floats) -> Floats:
    """Return `(num_nodes, 3)` where nodes are at rest."""
    places = np.zeros_like(offsets)
    for node, parent in enumerate(parents.tolist()):
        places[node] = offsets[node] + (places[parent] if parent >= 0 else 0.0)
    return places


def present(points: Floats) -> Flags:
    """Return `(*batch)`: which of `(*batch, 3)` points are there."""
    return np.asarray(np.isfinite(points).all(axis=-1))


def count_held(bones: Bones) -> int:
    """Return in how many frames some bone keeps the rotation of the frame before."""
    turning = [node for node in range(len(bones.names)) if bones.turns(node)]
    return int((~bones.measured[:, turning].all(axis=1)).sum())
