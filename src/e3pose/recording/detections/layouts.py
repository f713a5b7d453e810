"""Orders of keypoints that networks write, and which of the skeletons here has their joints."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.proportions import KINDS, kind_of
from e3pose.model.skeleton import BODY_LIMBS, SKELETONS, Skeleton

SAMPLE = 2000  # people whose limbs tell the order
SURE = 0.2  # by so much less must the right order misfit people than the next
ODD = 0.5  # misfit of an order that is hardly right; right ones misfit by 0.1 to 0.2
FEET = """left_big_toe left_small_toe left_heel right_big_toe right_small_toe right_heel"""
_COCO = " ".join(SKELETONS["coco17"].joints)
_HALPE = " ".join(SKELETONS["halpe26"].joints)
_MEDIAPIPE = """nose - left_eye - - right_eye - left_ear right_ear - -
        left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist - - - - - -
        left_hip right_hip left_knee right_knee left_ankle right_ankle left_heel right_heel
        left_big_toe right_big_toe"""
# Name, skeleton, count of keypoints and the joints of the first; a dash is a joint that no skeleton
# has. What stands behind them, as hands and faces, is not used.
_TABLE = (
    ("body25", "body25", 25, " ".join(SKELETONS["body25"].joints)),
    ("body25b", "halpe26", 25, f"{_COCO} neck top_head {FEET}"),
    ("coco17", "coco17", 17, _COCO),
    ("h36m17", "panoptic19", 17, """mid_hip right_hip right_knee right_ankle left_hip left_knee
        left_ankle - neck - - left_shoulder left_elbow left_wrist right_shoulder right_elbow
        right_wrist"""),
    ("coco18", "coco18", 18, " ".join(SKELETONS["coco18"].joints)),
    ("coco23", "halpe26", 23, f"{_COCO} {FEET}"),
    ("halpe26", "halpe26", 26, _HALPE),
    ("mediapipe33", "halpe26", 33, _MEDIAPIPE),
    ("coco133", "halpe26", 133, f"{_COCO} {FEET}"),
    ("halpe136", "halpe26", 136, _HALPE),
    ("mediapipe543", "halpe26", 543, _MEDIAPIPE),
    ("mediapipe553", "halpe26", 553, _MEDIAPIPE),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Layout:
    """An order of keypoints.

    Attributes:
        name: of the order.
        skeleton: that takes its joints; what it lacks is missing.
        count: keypoints of a person.
        columns: of each joint of `skeleton`, where it stands in the order; -1 if nowhere.
    """

    name: str
    skeleton: Skeleton
    count: int
    columns: tuple[int, ...]

    def of_skeleton(self, people: Floats) -> Floats:
        """Return `(num_people, count, 3)` keypoints as those of the skeleton; 0 where missing."""
        columns = np.array(self.columns)
        found = np.where((columns < 0)[:, None], 0.0, people[:, np.maximum(columns, 0)])
        for middle, ends in (
            ("neck", ("left_shoulder", "right_shoulder")),
            ("mid_hip", ("left_hip", "right_hip")),
        ):
            if middle in self.skeleton.joints and columns[self.skeleton.index(middle)] < 0:
                both = found[:, [self.skeleton.index(end) for end in ends]]
                mean = np.concatenate([both[..., :2].mean(1), both[..., 2].min(1)[:, None]], axis=1)
                found[:, self.skeleton.index(middle)] = mean
        return found

    @property
    def unused(self) -> int:
        """How many of its keypoints no joint takes."""
        return self.count - sum(column >= 0 for column in self.columns)


def named_layout(names: Sequence[str]) -> Layout | None:
    """Return the layout of keypoints with these names, such as `Left Wrist` or `wrist_l`.

    None if fewer than the eight joints of arms and legs are among them.
    """
    known = {_plain(name): at for at, name in reversed(list(enumerate(names)))}
    skeletons = [SKELETONS[name] for name in ("coco17", "halpe26", "panoptic19")]
    found = [[known.get(_plain(joint), -1) for joint in one.joints] for one in skeletons]
    best = max(range(len(skeletons)), key=lambda i: (sum(c >= 0 for c in found[i]), -i))
    needed = [
        skeletons[best].index(f"{side}_{joint}")
        for side in ("left", "right")
        for joint in ("elbow", "wrist", "knee", "ankle")
    ]
    if any(found[best][at] < 0 for at in needed):
        return None
    return Layout("named", skeletons[best], len(names), tuple(found[best]))


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


def _layout(name: str, skeleton: str, count: int, joints: str) -> Layout:
    order = joints.split()
    columns = tuple(order.index(j) if j in order else -1 for j in SKELETONS[skeleton].joints)
    return Layout(name, SKELETONS[skeleton], count, columns)


LAYOUTS = tuple(_layout(*row) for row in _TABLE)
ASKED = {25}  # where two orders are in use; else the first is taken unless limbs say otherwise
BEGINNINGS = {"coco17": 17, "coco18": 18, "body25": 25}  # of longer orders, with their counts
COUNTS = sorted({layout.count for layout in LAYOUTS})


def choose_layout(people: Floats, name: str | None, where: str) -> tuple[Layout, str]:
    """Return in which order the keypoints of people are, and what to tell the user of it.

    Orders of one count are told apart by limbs: those of the right one are the shortest.

    Args:
        people: `(num_people, count, 3)` x, y in pixels and score; 0 where missing.
        name: of the layout or its skeleton, where the user says it.
        where: the source, for errors.

    Raises:
        InputError: for a count that no layout has, an unknown name, or orders that limbs cannot
            tell apart.
    """
    count = people.shape[1]
    fitting = [layout for layout in LAYOUTS if layout.count == count]
    if not fitting and count > max(BEGINNINGS.values()):  # joints of its own behind a known order
        fitting = [layout for layout in LAYOUTS if layout.name in BEGINNINGS]
    if name is not None:
        chosen = [layout for layout in fitting if name in (layout.name, layout.skeleton.name)]
        if not chosen:
            names = ", ".join(layout.name for layout in fitting) or "none"
            raise InputError(f"--skeleton: found {name[:40]!r}, expected of {count}: {names}")
        return chosen[0], ""
    if not fitting:
        counts = ", ".join(map(str, COUNTS))
        raise InputError(f"{where}: found {count} keypoints a person, expected one of {counts}")
    sample = people[:: max(1, len(people) // SAMPLE)]
    misfits = sorted((_misfit(one.of_skeleton(sample), one.skeleton), i)
                     for i, one in enumerate(fitting))  # fmt: skip
    misfit, best = misfits[0][0], fitting[misfits[0][1]]
    sure = len(fitting) == 1 or misfits[1][0] - misfit > SURE
    if not sure and count not in ASKED:
        best = fitting[0]
    elif not sure:
        names = " or ".join(layout.name for layout in fitting)
        raise InputError(
            f"{where}: {count} keypoints are {names}, and limbs do not tell which; "
            "expected --skeleton NAME"
        )
    if best.count < count:
        return best, f"of {count} keypoints, no known number, the first {best.count} are read"
    if best != fitting[0]:
        return best, f"keypoints are {best.name}, by the lengths of limbs (--skeleton)"
    if misfit > ODD:
        return best, f"limbs do not have the lengths of people's: is the order not {best.name}?"
    return best, ""


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
