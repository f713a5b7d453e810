"""Skeletons: joints, limbs and kinematic trees of the conventions in use, and their conversion.

A skeleton is a TOML file, one of `model/skeletons` or a user's own; docs/reference/skeletons.md has
its fields. Joint names are shared between skeletons: `left_shoulder` is the same anatomical point
everywhere, so conversion is by name, plus a few joints that are means of others, plus the one
special case of Shelf-14, whose head joints no detector gives.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.bounded import read_shipped
from e3pose.base.errors import InputError
from e3pose.base.table import read_table

PACKAGE = "e3pose.model.skeletons"
FORMAT, VERSION = "e3pose-skeleton", 1
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
MAX_BYTES = 1_000_000
MAX_JOINTS = 512  # as messages have them
FAR_M = 2.0  # that a joint may be from the one that it hangs on
MOST_PARTS, MOST_LIMBS = 6, 4 * MAX_JOINTS
SHOWN = 5  # joints that a message names
DETAILS = ("finger", "skin")  # ways to move of joints that do not tell people apart
SIDES = ("left", "right")


class Names(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of `names.toml`.

    Attributes:
        parents: of a joint: it hangs on the first of these that a skeleton has.
        moves: joints by how they move beside their parents.
        means: of which a joint is the mean where a skeleton lacks it.
        same: what others call a joint.
    """

    parents: dict[str, list[str]]
    moves: dict[str, list[str]]
    means: dict[str, tuple[str, ...]]
    same: dict[str, tuple[str, ...]]


NAMES = read_table(Names, read_shipped("names", PACKAGE, ("names",), "skeleton", MAX_BYTES)[0])
MEANS: Mapping[str, tuple[str, ...]] = NAMES.means
_MOVES = {joint: how for how, joints in NAMES.moves.items() for joint in joints}
HOW = (*NAMES.moves, "end", *DETAILS)  # ways to move
_RANKS = {joint: rank for rank, joint in enumerate(NAMES.parents)}


class SkeletonFile(msgspec.Struct, forbid_unknown_fields=True):
    """The content of a skeleton's file.

    Attributes:
        format: always the same.
        version: likewise.
        name: by default that of the file.
        about: in words.
        parts: skeletons whose joints come first, in order.
        joints: the others, in order.
        limbs: joints in a row, each a limb with the next.
        tree: joints in a row, each the parent of the next; by default by names and limbs.
        pairs: a left and a right joint, beside those that their names tell.
        moves: joints by how they move beside their parents, where names do not tell.
        same: what others call a joint.
        rest: where a joint usually is beside its parent, metres: ahead or along the forearm, left
            or to the thumb's side, up or out of the palm.
    """

    format: Literal["e3pose-skeleton"]
    version: Literal[1]
    name: str = ""
    about: str = ""
    parts: list[str] = []
    joints: list[str] = []
    limbs: list[str] = []
    tree: list[str] = []
    pairs: list[str] = []
    moves: dict[str, list[str]] = {}
    same: dict[str, list[str]] = {}
    rest: dict[str, tuple[float, float, float]] = {}


@dataclass(frozen=True, slots=True)
class Skeleton:
    """A convention: joint names in axis order, and how joints hang together.

    Attributes:
        name: of the convention.
        joints: names.
        limbs: pairs of joint indices.
        parents: by joint, index of the one that it hangs on, -1 at the root.
        moves: by joint, how it moves beside its parent, as `filter.tree.HABITS` has them.
        pairs: indices of left joints and their right ones.
        rest_m: by joint, where it usually is beside its parent, see `SkeletonFile`; NaN if unknown.
        same: a joint, and what others call it.
    """

    name: str
    joints: tuple[str, ...]
    limbs: tuple[tuple[int, int], ...]
    parents: tuple[int, ...] = ()
    moves: tuple[str, ...] = ()
    pairs: tuple[tuple[int, int], ...] = ()
    rest_m: tuple[tuple[float, float, float], ...] = ()
    same: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        names, given = self.joints, object.__setattr__
        if not self.parents:
            limbs = [(names[a], names[b]) for a, b in self.limbs]
            given(self, "parents", hang(names, {}, limbs))
        if not self.moves:
            given(self, "moves", tuple(_MOVES.get(name, "end") for name in names))
        if not self.pairs:
            given(self, "pairs", pairs_of(names, ()))

    def __len__(self) -> int:
        return len(self.joints)

    def index(self, joint: str) -> int:
        """Return where `joint` stands on the joint axis; raise `InputError` if it is not there."""
        try:
            return self.joints.index(joint)
        except ValueError:
            raise InputError(f"skeleton {self.name} has no joint {joint!r}") from None

    def depth(self, index: int) -> int:
        """Return how many joints are between a joint and the root, itself included."""
        parent = self.parents[index]
        return 0 if parent < 0 else 1 + self.depth(parent)

    @property
    def core(self) -> tuple[int, ...]:
        """Joints that tell people apart: without fingers and skin, if there are others."""
        found = tuple(i for i, how in enumerate(self.moves) if how not in DETAILS)
        return found or tuple(range(len(self)))


def hang(
    names: Sequence[str], stated: Mapping[str, str], limbs: Sequence[tuple[str, str]]
) -> tuple[int, ...]:
    """Return the parent of each joint: as stated, else by its name, else by limbs, else the root.

    Args:
        names: of the joints.
        stated: parents of joints.
        limbs: of joints.

    Raises:
        InputError: for a tree that goes round.
    """
    found = {n: stated.get(n, "") or _named_parent(n, names) for n in names}
    free = [name for name in names if not found[name]]
    root = min(free, key=lambda n: _RANKS.get(n, len(_RANKS)), default="")
    hung = {n for n in free if n == root or n in _RANKS}
    near: dict[str, list[str]] = {name: [] for name in names}
    for a, b in limbs:
        near[a].append(b)
        near[b].append(a)
    while len(hung) < len(names):
        grown = {n for n in names if found[n] in hung} - hung
        if not grown:  # of joints that names do not place, the first that a limb joins to these
            loose = [n for n in free if n not in hung]
            if not loose:
                (first, *_) = (n for n in names if n not in hung)
                raise InputError("tree", f"{first} below itself", "joints that hang on a root")
            ends = ((n, end) for n in loose for end in near[n] if end in hung)
            name, above = next(ends, (loose[0], root))
            found[name], grown = above, {name}
        hung |= grown
    return tuple(-1 if n == root else names.index(found[n] or root) for n in names)


def _named_parent(name: str, names: Sequence[str]) -> str:
    return next((parent for parent in NAMES.parents.get(name, ()) if parent in names), "")


def pairs_of(
    names: Sequence[str], stated: Sequence[tuple[str, str]]
) -> tuple[tuple[int, int], ...]:
    """Return left joints with their right ones, by `left_` and `right_`, and those stated."""
    opposite = {name: name.replace("left_", "right_", 1) for name in names if name[:5] == "left_"}
    pairs = [*((left, right) for left, right in opposite.items() if right in names), *stated]
    return tuple((names.index(left), names.index(right)) for left, right in pairs)


def load_skeleton(name_or_path: str | Path) -> Skeleton:
    """Load one of the skeletons that come with the package, or a TOML file of the user's own.

    Raises:
        InputError: naming the file and the field that is wrong.
    """
    known = str(name_or_path) in SHIPPED
    return _shipped(str(name_or_path)) if known else _loaded(str(name_or_path), ())


@lru_cache(maxsize=32)
def _shipped(name: str) -> Skeleton:
    return _loaded(name, ())


def _loaded(name_or_path: str, within: tuple[str, ...]) -> Skeleton:
    table, where = read_shipped(name_or_path, PACKAGE, SHIPPED, "skeleton", MAX_BYTES)
    try:
        if name_or_path in within or len(within) > MOST_PARTS:
            raise InputError("parts", f"{name_or_path} within itself", "other skeletons")
        file, path = read_table(SkeletonFile, table), Path(name_or_path)
        if len(set(file.parts)) < len(file.parts) or len(file.parts) > MOST_PARTS:
            wanted = f"at most {MOST_PARTS}, each once"
            raise InputError("parts", f"{len(file.parts)} skeletons", wanted)
        paths = [str(path.parent / part) for part in file.parts]
        above = (*within, name_or_path)
        parts = [_shipped(part) if part in SHIPPED else _loaded(beside, above)
                 for part, beside in zip(file.parts, paths, strict=True)]  # fmt: skip
        return _of_file(file, file.name or path.stem, parts, name_or_path in SHIPPED)
    except InputError as error:
        raise error.at(where) from None


def _names(file: SkeletonFile, parts: Sequence[Skeleton]) -> tuple[str, ...]:
    """Return the joints of a file and its parts, checked."""
    names = (*(joint for part in parts for joint in part.joints), *file.joints)
    twice = [joint for joint in set(names) if len(names) <= MAX_JOINTS and names.count(joint) > 1]
    if not 1 <= len(names) <= MAX_JOINTS or twice or not all(map(str.isidentifier, names)):
        wrong = next((joint for joint in names if not joint.isidentifier()), f"{len(names)} joints")
        found = f"{min(twice)} twice" if twice else wrong[:60]
        wanted = f"1 to {MAX_JOINTS} different names of letters, digits and _"
        raise InputError("joints", found, wanted)
    return names


def _links(field: str, rows: Sequence[str], known: Collection[str]) -> list[tuple[str, str]]:
    """Return pairs of joints that stand beside each other in the rows of a field, checked."""
    for joint in (joint for row in rows for joint in row.split()):
        if joint not in known:
            raise InputError(field, joint[:60], "joints of the skeleton")
    pairs = [pair for row in rows for pair in pairwise(row.split())]
    if len(pairs) > MOST_LIMBS:
        raise InputError(field, f"{len(pairs)} pairs", f"at most {MOST_LIMBS}")
    if twice := next((a for a, b in pairs if a == b), ""):
        raise InputError(field, f"{twice} twice in a row", "two joints")
    return pairs


def _of_file(file: SkeletonFile, name: str, parts: Sequence[Skeleton], shipped: bool) -> Skeleton:
    names = _names(file, parts)
    links = partial(_links, known=set(names))
    limbs, parents = list[tuple[str, str]](), dict[str, str]()
    moves = {joint: how for joint, how in _MOVES.items() if joint in names}
    rest: dict[str, tuple[float, float, float]] = {}
    pairs, same = list[tuple[str, str]](), list[tuple[str, str]]()
    for part in parts:
        own = part.joints
        limbs += [(own[a], own[b]) for a, b in part.limbs]
        pairs += [(own[a], own[b]) for a, b in part.pairs]
        parents |= {own[i]: own[p] for i, p in enumerate(part.parents)
                    if p >= 0 and own[i] not in _RANKS}  # fmt: skip
        moves |= dict(zip(own, part.moves, strict=True))
        rest |= dict(zip(own, part.rest_m, strict=False))
        same += part.same
    parents |= {child: parent for parent, child in links("tree", file.tree)}
    limbs += links("limbs", file.limbs)
    pairs = [pair for pair in (*pairs, *links("pairs", file.pairs))
             if pair[1] != pair[0].replace("left_", "right_", 1)]  # fmt: skip
    for how, joints in file.moves.items():
        links("moves", joints)
        if how not in HOW:
            raise InputError("moves", how[:60], f"one of {', '.join(HOW)}")
        moves |= dict.fromkeys(joints, how)
    for field in ("rest", "same"):
        links(field, list(getattr(file, field)))
    far = next((x for place in file.rest.values() for x in place if not abs(x) <= FAR_M), None)
    if far is not None:
        raise InputError("rest", far, f"metres, up to {FAR_M}")
    rest |= file.rest
    same += [(joint, other) for joint, others in file.same.items() for other in others]
    nowhere = (np.nan,) * 3
    made = Skeleton(
        name,
        names,
        tuple((names.index(a), names.index(b)) for a, b in limbs),
        hang(names, parents, limbs),
        tuple(moves.get(joint, "end") for joint in names),
        pairs_of(names, pairs),
        tuple(rest.get(joint, nowhere) for joint in names) if rest else (),
        tuple(same),
    )
    if not shipped and (name in SHIPPED or not NAME.fullmatch(name)):
        wanted = "up to 64 letters, digits, _ and -, which no skeleton of e3pose has as its name"
        raise InputError("name", name[:70], wanted)
    return made


def skeleton_table(skeleton: Skeleton) -> dict[str, Any]:
    """Return the content of a skeleton's file, without parts."""
    names = skeleton.joints

    def rows(pairs: Iterable[tuple[int, int]]) -> list[str]:
        return [f"{names[a]} {names[b]}" for a, b in pairs]

    moves: dict[str, list[str]] = {}
    for joint, how in zip(names, skeleton.moves, strict=True):
        moves.setdefault(how, []).append(joint)
    same: dict[str, list[str]] = {}
    for joint, other in skeleton.same:
        same.setdefault(joint, []).append(other)
    rest = zip(names, skeleton.rest_m, strict=False)
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": skeleton.name,
        "joints": list(names),
        "limbs": rows(skeleton.limbs),
        "tree": rows((parent, i) for i, parent in enumerate(skeleton.parents) if parent >= 0),
        "pairs": rows(skeleton.pairs),
        "moves": moves,
        "same": same,
        "rest": {joint: list(place) for joint, place in rest if np.isfinite(place).all()},
    }


def own_file(skeleton: Skeleton) -> str:
    """Return the file of a skeleton of the user's own as JSON; empty for a shipped one."""
    own = skeleton.limbs and skeleton.name not in SHIPPED
    return json.dumps(skeleton_table(skeleton)) if own else ""


SHIPPED = (
    "coco17", "coco18", "body25", "halpe26", "shelf14", "panoptic19", "cmu31", "coco23", "body25b",
    "h36m17", "mediapipe33", "mediapipe75", "coco133", "halpe136", "openpose67", "openpose137",
    "openpose60", "openpose88", "openpose95", "openpose130", "openpose135", "left_hand20",
    "right_hand20", "left_hand21", "right_hand21", "face68", "face70",
)  # fmt: skip


class _Shipped(Mapping[str, Skeleton]):
    """Skeletons of the package by name, each read when it is first asked for."""

    def __getitem__(self, name: str) -> Skeleton:
        if name not in SHIPPED:
            raise KeyError(name)
        return load_skeleton(name)

    def __iter__(self) -> Iterator[str]:
        return iter(SHIPPED)

    def __len__(self) -> int:
        return len(SHIPPED)


SKELETONS = _Shipped()
COCO17, COCO18 = SKELETONS["coco17"], SKELETONS["coco18"]
BODY25, HALPE26 = SKELETONS["body25"], SKELETONS["halpe26"]
SHELF14, PANOPTIC19, CMU31 = (SKELETONS[name] for name in ("shelf14", "panoptic19", "cmu31"))
_COCO_LIMBS = tuple((COCO17.joints[a], COCO17.joints[b]) for a, b in COCO17.limbs)
BODY_LIMBS, FACE_LIMBS = _COCO_LIMBS[:-4], _COCO_LIMBS[-4:]
BODY_JOINTS = frozenset(joint for limb in BODY_LIMBS for joint in limb)


def skeleton_of_joints(joints: tuple[str, ...], name: str = "", own: str = "") -> Skeleton:
    """Return the known skeleton with these joints, of this name if it has one; else one of points.

    Args:
        joints: their names, in order.
        name: of the skeleton; empty for that of whichever has the joints.
        own: what `own_file` returned for one of the user's own.

    Raises:
        InputError: for another `own`, or one of other joints.
    """
    if own:
        try:
            made = _of_file(read_table(SkeletonFile, json.loads(own)), name, (), True)
        except (ValueError, RecursionError):
            raise InputError("skeleton", own[:40], "the JSON of a skeleton") from None
        if made.joints != joints:
            raise InputError("skeleton", f"{len(made)} joints", f"the {len(joints)} of its poses")
        return made
    known = SHIPPED if not name else (name,) if name in SHIPPED else ()
    found = next((SKELETONS[one] for one in known if SKELETONS[one].joints == joints), None)
    return found or Skeleton(name or "live", joints, ())


def lacking(joints: Collection[str], target: Collection[str]) -> tuple[str, ...]:
    """Return the joints of a target that cannot be had from others, neither as is nor as means.

    Args:
        joints: names of those that there are.
        target: names of those wanted.
    """
    return tuple(
        joint
        for joint in target
        if joint not in joints and not (joint in MEANS and set(MEANS[joint]) <= set(joints))
    )


def not_used(left: Sequence[str], count: int) -> str:
    """Return a remark on unused joints of so many; empty if there are none."""
    return f"{len(left)} of {count} joints not used: {some(left)}" if left else ""


def some(joints: Sequence[str]) -> str:
    """Return the first of some joints, and how many more there are."""
    more = "" if len(joints) <= SHOWN else f" and {len(joints) - SHOWN} more"
    return ", ".join(joints[:SHOWN]) + more


def unused(joints: Sequence[str], target: Collection[str]) -> str:
    """Return a remark on joints lost in a conversion to a target; empty if none is.

    Args:
        joints: names of those that there are.
        target: names of those wanted.
    """
    means = {part for joint in target if joint not in joints for part in MEANS.get(joint, ())}
    taken = means.union(target)
    left = [j for j in joints if j not in taken and not (j in MEANS and taken.issuperset(MEANS[j]))]
    return not_used(left, len(joints))


def serves(joints: Collection[str], target: Collection[str]) -> bool:
    """Return whether poses with these joints can stand for those of a target: no limb is lost."""
    return not set(lacking(joints, target)) & (set(target) & BODY_JOINTS or set(target))


def convert(
    positions: Floats, scores: Floats, source: Skeleton, target: Skeleton
) -> tuple[Floats, Floats]:
    """Express poses of one skeleton in another.

    Args:
        positions: `(*batch, num_joints, 2 or 3)` pixels or metres, NaN where missing.
        scores: `(*batch, num_joints)` in [0, 1], 0 where missing.
        source: the skeleton of the arguments.
        target: the skeleton wanted.

    Returns:
        Positions and scores with the target's joint axis; a joint that the source cannot give is
        NaN with score 0. A mean of joints takes the lowest of their scores. COCO-17 to Shelf-14 in
        3D estimates the head from face and shoulders (z up), as the Shelf protocol does.

    Raises:
        InputError: when the shapes do not fit the source skeleton.
    """
    if positions.shape[-2] != len(source) or scores.shape != positions.shape[:-1]:
        raise InputError(
            f"convert: positions {positions.shape} and scores {scores.shape} do not fit "
            f"skeleton {source.name} of {len(source)} joints"
        )
    if source == target:
        return positions, scores
    if target == SHELF14 and positions.shape[-1] == 3 and set(COCO17.joints) <= set(source.joints):
        return _shelf14(*convert(positions, scores, source, COCO17))
    new_positions = np.full((*positions.shape[:-2], len(target), positions.shape[-1]), np.nan)
    new_scores = np.zeros((*scores.shape[:-1], len(target)))
    for index, joint in enumerate(target.joints):
        names = (joint,) if joint in source.joints else MEANS.get(joint, ())
        if names and set(names) <= set(source.joints):
            columns = [source.joints.index(name) for name in names]
            new_positions[..., index, :] = positions[..., columns, :].mean(axis=-2)
            new_scores[..., index] = scores[..., columns].min(axis=-1)
    return np.where(new_scores[..., None] > 0, new_positions, np.nan), new_scores


def _shelf14(joints_m: Floats, scores: Floats) -> tuple[Floats, Floats]:
    """Map COCO-17 in metres, z up, to Shelf-14 by the formulas of the Shelf PCP protocol.

    The protocol takes the nose and both ears. Few cameras seldom see them all, so the nearest face
    joints that were seen stand in: for the mid-ear one ear, else the eyes, else the nose; for the
    nose the eyes, else the ears. With nose and ears seen this is the protocol to the letter.
    """
    body = [COCO17.joints.index(name) for name in SHELF14.joints[:12]]
    face = [_mean_seen(joints_m, scores, columns) for columns in ([3, 4], [1, 2], [0])]
    ears, eyes, nose_seen = face
    head_centre, centre_score = _first_seen(ears, eyes, nose_seen)
    nose, nose_score = _first_seen(nose_seen, eyes, ears)
    middle_shoulder = joints_m[..., [5, 6], :].mean(axis=-2)
    head_bottom = (middle_shoulder + head_centre) / 2
    head_top = head_bottom + 2 * (head_centre - head_bottom)
    forward = nose - middle_shoulder
    bottom = 0.75 * (middle_shoulder + 0.5 * forward) + 0.25 * head_bottom
    top = 0.75 * (middle_shoulder + forward * [0.75, 0.75, 1.5]) + 0.25 * head_top
    new_joints = np.concatenate(
        [joints_m[..., body, :], bottom[..., None, :], top[..., None, :]], axis=-2
    )
    shoulder_score = scores[..., [5, 6]].min(axis=-1)
    head_score = np.minimum(np.minimum(centre_score, nose_score), shoulder_score)[..., None]
    new_scores = np.concatenate([scores[..., body], head_score, head_score], axis=-1)
    return np.where(new_scores[..., None] > 0, new_joints, np.nan), new_scores


def _mean_seen(joints_m: Floats, scores: Floats, columns: list[int]) -> tuple[Floats, Floats]:
    """Return the mean `(*batch, 3)` of the seen joints, and the best of their scores."""
    seen = scores[..., columns] > 0
    total = np.where(seen[..., None], joints_m[..., columns, :], 0.0).sum(axis=-2)
    count = seen.sum(axis=-1)
    mean = total / np.maximum(count, 1)[..., None]
    return np.where(count[..., None] > 0, mean, np.nan), scores[..., columns].max(axis=-1)


def _first_seen(*choices: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    position, score = choices[-1]
    for earlier_position, earlier_score in choices[-2::-1]:
        position = np.where(earlier_score[..., None] > 0, earlier_position, position)
        score = np.where(earlier_score > 0, earlier_score, score)
    return position, score


def common_skeleton(detectors: Iterable[Skeleton]) -> Skeleton:
    """Return the skeleton in which poses of several detectors are told.

    Args:
        detectors: what each of them outputs.

    Returns:
        That of theirs which lacks fewest joints in any of them, and of several the one with fewest
        joints, as what a detector does not find is made of others; COCO's without a detector.
    """
    known = list(dict.fromkeys(detectors))

    def cost(target: Skeleton) -> tuple[int, int]:
        return sum(len(lacking(other.joints, target.joints)) for other in known), len(target)

    return min(known, key=cost, default=COCO17)
