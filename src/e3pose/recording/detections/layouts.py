"""Orders of keypoints that networks write, and which of the skeletons here has their joints."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.proportions import KINDS, kind_of
from e3pose.model.skeleton import (
    BODY_JOINTS,
    BODY_LIMBS,
    MEANS,
    NAMES,
    SIDES,
    SKELETONS,
    Skeleton,
    load_skeleton,
    not_used,
)

SAMPLE = 2000  # people whose limbs tell the order
FEW = 20  # people that do not tell an order that is stated apart
SURE = 0.2  # by so much less must the right order misfit people than the next
ODD = 0.5  # misfit of an order that is hardly right; right ones misfit by 0.1 to 0.2
LONGER = {"mediapipe33": 543, "mediapipe75": 553}  # keypoints of what has a mesh of the face, too


@dataclass(frozen=True, slots=True)
class Layout:
    """An order of keypoints.

    Attributes:
        skeleton: that takes its joints; what it lacks is missing.
        count: keypoints of a person.
        columns: of each joint of `skeleton`, where it stands in the order; -1 if nowhere.
        names: of the keypoints, as far as they are known.
    """

    skeleton: Skeleton
    count: int
    columns: tuple[int, ...]
    names: tuple[str, ...] = ()

    def of_skeleton(self, people: Floats) -> Floats:
        """Return `(num_people, count, 3)` keypoints as those of the skeleton; 0 where missing."""
        columns = np.array(self.columns)
        found = np.where((columns < 0)[:, None], 0.0, people[:, np.maximum(columns, 0)])
        for middle, ends in MEANS.items():
            if middle in self.skeleton.joints and columns[self.skeleton.index(middle)] < 0:
                both = found[:, [self.skeleton.index(end) for end in ends]]
                mean = np.concatenate([both[..., :2].mean(1), both[..., 2].min(1)[:, None]], axis=1)
                found[:, self.skeleton.index(middle)] = mean
        return found

    @property
    def unused(self) -> str:
        """A remark on keypoints that no joint takes; empty if there are none."""
        taken = {*self.columns}
        left = [self.names[i] if i < len(self.names) else f"keypoint {i + 1}"
                for i in range(self.count) if i not in taken]  # fmt: skip
        return not_used(left, self.count)


def named_layout(names: Sequence[str], skeleton: Skeleton | None = None) -> Layout | None:
    """Return the layout of keypoints with these names, such as `Left Wrist` or `wrist_l`.

    Args:
        names: of the keypoints.
        skeleton: whose joints they are; that of e3pose which takes most of them if None.

    Returns:
        None if fewer than the eight joints of arms and legs are among them.
    """
    known = {_plain(name): at for at, name in reversed(list(enumerate(names)))}
    choices = [skeleton] if skeleton else sorted(SKELETONS.values(), key=len)
    found = [tuple(_place(joint, one, known) for joint in one.joints) for one in choices]
    best = max(range(len(choices)), key=lambda i: (sum(c >= 0 for c in found[i]), -i))
    limbs = {f"{side}_{j}" for side in SIDES for j in ("elbow", "wrist", "knee", "ankle")}
    joints = zip(choices[best].joints, found[best], strict=True)
    if skeleton is None and not limbs <= {joint for joint, at in joints if at >= 0}:
        return None
    return Layout(choices[best], len(names), found[best], tuple(names))


def _place(joint: str, skeleton: Skeleton, known: Mapping[str, int]) -> int:
    """Return where a joint or what others call it is among plain names; -1 if nowhere."""
    others = (*(other for own, other in skeleton.same if own == joint), *NAMES.same.get(joint, ()))
    return next((known[_plain(n)] for n in (joint, *others) if _plain(n) in known), -1)


def _plain(name: str) -> str:
    """Return a joint's name without case, marks and order of its side."""
    words = name.lower().replace("-", "_").replace(" ", "_").replace(".", "_").split("_")
    sides = {"l": "left", "r": "right", "left": "left", "right": "right"}
    side = [sides[word] for word in words if word in sides]
    rest = "".join(word for word in words if word and word not in sides)
    for prefix in ("left", "right"):
        if not side and rest.startswith(prefix) and len(rest) > len(prefix):
            side, rest = [prefix], rest.removeprefix(prefix)
    return "".join([*side[:1], rest])


def _layout(skeleton: Skeleton, count: int | None = None) -> Layout:
    places = tuple(range(len(skeleton)))
    return Layout(skeleton, count or len(skeleton), places, skeleton.joints)


_BODIES = [one for one in SKELETONS.values() if set(one.joints) >= BODY_JOINTS]
LAYOUTS = (
    *map(_layout, _BODIES), *(_layout(SKELETONS[name], count) for name, count in LONGER.items())
)  # fmt: skip
ASKED = {25}  # where two orders are in use; else the first is taken unless limbs say otherwise
BEGINNINGS = ("coco17", "coco18", "body25")  # of longer orders
COUNTS = sorted({layout.count for layout in LAYOUTS})


def choose_layout(people: Floats, name: str | None, where: str) -> tuple[Layout, str]:
    """Return the order of people's keypoints, and a remark on it for the user.

    Orders of one count are told apart by limbs: those of the right one are the shortest.

    Args:
        people: `(num_people, count, 3)` x, y in pixels and score; 0 where missing.
        name: of the skeleton or its file, where the user says it.
        where: the source, for errors.

    Raises:
        InputError: for a count that no layout has, an unknown name, or orders that limbs cannot
            tell apart.
    """
    count = people.shape[1]
    fitting = [layout for layout in LAYOUTS if layout.count == count]
    if not fitting and count > max(len(SKELETONS[begin]) for begin in BEGINNINGS):
        fitting = [_layout(SKELETONS[begin], count) for begin in BEGINNINGS]
    if name is not None:
        return _named(name, count, fitting), ""
    if not fitting:
        parts = [one.name for one in SKELETONS.values() if len(one) == count]
        wanted = f"one of {', '.join(map(str, COUNTS))}, or " if not parts else ""
        wanted += f"--skeleton {' or '.join(parts) or 'with a TOML file that names them'}"
        raise InputError(f"{where}: found {count} keypoints a person, expected {wanted}")
    misfits = _misfits(people, fitting)
    misfit, best = misfits[0][0], fitting[misfits[0][1]]
    sure = len(fitting) == 1 or misfits[1][0] - misfit > SURE
    if not sure and count not in ASKED:
        best = fitting[0]
    elif not sure:
        names = " or ".join(layout.skeleton.name for layout in fitting)
        raise InputError(
            f"{where}: {count} keypoints are {names}, and limbs do not tell which; "
            "expected --skeleton NAME"
        )
    chosen = best.skeleton.name
    if best != fitting[0]:
        return best, f"keypoints are {chosen}, by the lengths of limbs (--skeleton)"
    if misfit > ODD:
        return best, f"limbs do not have the lengths of people's: is the order not {chosen}?"
    return best, ""


def _named(name: str, count: int, fitting: Sequence[Layout]) -> Layout:
    """Return the layout of a skeleton that the user names, also of one with fewer joints."""
    known = [layout for layout in fitting if layout.skeleton.name == name]
    if known:
        return known[0]
    wanted = ", ".join(layout.skeleton.name for layout in fitting) or "a TOML file of the joints"
    refused = InputError(f"--skeleton: found {name[:40]!r}, expected of {count}: {wanted}")
    if name not in SKELETONS and not Path(name).is_file():
        raise refused
    skeleton = load_skeleton(name)
    if len(skeleton) == count:
        return _layout(skeleton)
    for layout in fitting if len(fitting) == 1 else ():
        places = {joint: at for at, joint in enumerate(layout.names)}
        if layout.count == len(layout.skeleton) and places.keys() >= {*skeleton.joints}:
            columns = tuple(places[joint] for joint in skeleton.joints)
            return Layout(skeleton, count, columns, layout.names)
    raise refused


def better_order(people: Floats, skeleton: Skeleton) -> str:
    """Return the skeleton of as many joints whose limbs fit clearly better; empty without any.

    Args:
        people: `(num_people, num_joints, 3)` x, y in pixels and score; 0 where missing.
        skeleton: that they are said to be in.
    """
    fitting = [layout for layout in LAYOUTS if layout.count == len(skeleton)]
    if len(people) < FEW or skeleton not in [layout.skeleton for layout in fitting]:
        return ""
    (best, first), *_ = misfits = _misfits(people, fitting)
    own = next(misfit for misfit, i in misfits if fitting[i].skeleton == skeleton)
    return fitting[first].skeleton.name if own - best > SURE else ""


def _misfits(people: Floats, fitting: Sequence[Layout]) -> list[tuple[float, int]]:
    """Return how badly limbs fit layouts, and their places, the best first."""
    sample = people[:: max(1, len(people) // SAMPLE)]
    return sorted(
        (_misfit(one.of_skeleton(sample), one.skeleton), i) for i, one in enumerate(fitting)
    )


def _misfit(people: Floats, skeleton: Skeleton) -> float:
    """Return how far the lengths of limbs are from people's up to a scale, as a mean logarithm."""
    points = np.where(people[..., 2:] > 0, people[..., :2], np.nan)
    limbs = [(skeleton.index(a), skeleton.index(b)) for a, b in BODY_LIMBS]
    apart = np.stack([points[:, a] - points[:, b] for a, b in limbs])
    lengths = np.hypot(apart[..., 0], apart[..., 1])
    shares = np.array([list(KINDS.values())[kind_of(a, b)].share for a, b in BODY_LIMBS])
    with np.errstate(divide="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a limb that nobody shows
        ratio = np.nanmedian(np.log(lengths / shares[:, None] + 1e-3), axis=1)
    ratio = ratio[np.isfinite(ratio)]
    return float(np.abs(ratio - np.median(ratio)).mean()) if len(ratio) > 3 else np.inf
