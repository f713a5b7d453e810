"""Names of bones in humanoid rigs: VRM (also Unity and VMC), Mixamo, Unreal.

A bone of theirs begins where a node of `bones` is: an upper leg at the hip. Nodes that no rig has
(nose, ears beside a head, the top of the head) keep their names. The rigs differ in how many bones
a spine has; ours has one below the shoulders, and those that turn it are `spine` and `chest`.
"""

from __future__ import annotations

from collections.abc import Sequence

# Node -> VRM 1.0 (the names of Unity's humanoid in lower case at the beginning), Mixamo, Unreal;
# of a side as `left_`: L, Left or _l takes its place.
_MIDDLE = {
    "mid_hip": ("hips", "Hips", "pelvis"),
    "spine": ("spine", "Spine", "spine_01"),
    "neck": ("chest", "Spine2", "spine_03"),
    "head": ("neck", "Neck", "neck_01"),
    "mid_ear": ("head", "Head", "head"),
}
_SIDED = {
    "hip": ("UpperLeg", "UpLeg", "thigh"),
    "knee": ("LowerLeg", "Leg", "calf"),
    "ankle": ("Foot", "Foot", "foot"),
    "big_toe": ("Toes", "ToeBase", "ball"),
    "shoulder": ("UpperArm", "Arm", "upperarm"),
    "elbow": ("LowerArm", "ForeArm", "lowerarm"),
    "wrist": ("Hand", "Hand", "hand"),
}
FINGERS = ("thumb", "index", "middle", "ring", "pinky")
_PHALANGES = ("Proximal", "Intermediate", "Distal")  # of VRM
VRM, MIXAMO, UNREAL = range(3)
MIXAMO_PREFIX = "mixamorig:"


def _named(rig: int) -> dict[str, str]:
    prefix = MIXAMO_PREFIX if rig == MIXAMO else ""
    names = {node: prefix + each[rig] for node, each in _MIDDLE.items()}
    for side in ("left", "right"):
        for node, each in _SIDED.items():
            if rig == UNREAL:
                name = f"{each[rig]}_{side[0]}"
            else:
                name = (side if rig == VRM else side.capitalize()) + each[rig]
            names[f"{side}_{node}"] = prefix + name
        for finger in FINGERS:
            parts = ("Metacarpal", "Proximal", "Distal") if finger == "thumb" else _PHALANGES
            for number, part in enumerate(parts, 1):
                called = "little" if finger == "pinky" and rig == VRM else finger
                name = (
                    f"{side}{called.capitalize()}{part}",
                    f"{prefix}{side.capitalize()}Hand{called.capitalize()}{number}",
                    f"{called}_{number:02}_{side[0]}",
                )[rig]
                names[f"{side}_{finger}{number}"] = name
    return names


BONE_NAMES = {"vrm": _named(VRM), "mixamo": _named(MIXAMO), "unreal": _named(UNREAL)}


def bone_names(nodes: Sequence[str], rig: str | None) -> list[str]:
    """Return the names of nodes in a rig.

    Args:
        nodes: of `bones.Bones`.
        rig: a key of `BONE_NAMES`; None for the nodes' own names.
    """
    if rig is None:
        return list(nodes)
    known = dict(BONE_NAMES[rig])
    if "mid_ear" not in nodes:  # a skeleton without ears: the top of the head stands for it
        known["top_head"] = known["mid_ear"]
    return [known.get(node, node) for node in nodes]
