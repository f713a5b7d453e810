"""A model of a whole body for OpenSim: bones and joints without muscles.

Bodies have x ahead, y up and z to the right, and begin at the joint towards the pelvis. Bodies,
coordinates, axes and signs are named as in OpenSim's full-body models, so that results of one are
understood by the other. Lengths are those of `model.proportions` for one stature; the scale tool
makes them a person's. Masses are shares of Winter (Biomechanics and Motor Control of Human
Movement, table 4.1), inertias those of rods about as thick as limbs.
"""

from __future__ import annotations

import math
from typing import NamedTuple
from xml.etree import ElementTree as xml

from e3pose.model.proportions import KINDS, STATURE_M

MASS_KG = 70.0
HIPS_M, SHOULDERS_M, TRUNK_M, THIGH_M, SHANK_M, ARM_M, FOREARM_M = (
    KINDS[kind].share * STATURE_M
    for kind in (
        ("hip", "hip"), ("shoulder", "shoulder"), ("hip", "shoulder"), ("hip", "knee"),
        ("ankle", "knee"), ("elbow", "shoulder"), ("elbow", "wrist"),
    )
)  # fmt: skip
SPINE_M = math.sqrt(TRUNK_M**2 - ((SHOULDERS_M - HIPS_M) / 2) ** 2)
PELVIS_M = 0.1  # of the spine, below the joint of the back
HEEL_M, BALL_M, SOLE_M = -0.06, 0.18, -0.055  # ankle to heel, heel to ball of the foot, to the sole
HAND_M = 0.1
THICKNESS = 0.25  # of a limb, as a share of its length

Vector = tuple[float, float, float]
# The axis of the subtalar joint is 42 degrees above the sole and 23 inwards (Inman 1976).
SUBTALAR = (0.684, 0.669, -0.290)
Z_AXIS, X_AXIS, Y_AXIS = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


class Body(NamedTuple):
    """A body on its joint.

    Attributes:
        name: without side where there are two.
        parent: the body that it hangs on.
        joint: the joint's name.
        at_m: the joint in the parent: ahead, up, outwards (right, in the middle).
        towards_m: the far end in the body, for its shape and inertia.
        mass: share of the whole mass.
        turns: coordinates and their axes; of a left body x and y are turned around, so that signs
            mean the same on both sides.
    """

    name: str
    parent: str
    joint: str
    at_m: Vector
    towards_m: Vector
    mass: float
    turns: tuple[tuple[str, Vector], ...] = ()


def _ball(flexion: str, adduction: str, rotation: str) -> tuple[tuple[str, Vector], ...]:
    return (flexion, Z_AXIS), (adduction, X_AXIS), (rotation, Y_AXIS)


MIDDLE = (
    Body("pelvis", "ground", "ground_pelvis", (0.0, 0.95, 0.0), (0.0, PELVIS_M, 0.0), 0.142,
         _ball("pelvis_tilt", "pelvis_list", "pelvis_rotation")),
    Body("torso", "pelvis", "back", (0.0, PELVIS_M, 0.0), (0.0, SPINE_M - PELVIS_M, 0.0), 0.436,
         _ball("lumbar_extension", "lumbar_bending", "lumbar_rotation")),
)  # fmt: skip
LIMBS = (
    Body("femur", "pelvis", "hip", (0.0, 0.0, HIPS_M / 2), (0.0, -THIGH_M, 0.0), 0.1,
         _ball("hip_flexion", "hip_adduction", "hip_rotation")),
    Body("tibia", "femur", "knee", (0.0, -THIGH_M, 0.0), (0.0, -SHANK_M, 0.0), 0.0465,
         (("knee_angle", (0.0, 0.0, -1.0)),)),
    Body("talus", "tibia", "ankle", (0.0, -SHANK_M, 0.0), (0.0, SOLE_M, 0.0), 0.0015,
         (("ankle_angle", Z_AXIS),)),
    Body("calcn", "talus", "subtalar", (HEEL_M, SOLE_M, 0.0), (BALL_M, 0.0, 0.0), 0.011,
         (("subtalar_angle", SUBTALAR),)),
    Body("toes", "calcn", "mtp", (BALL_M, 0.0, 0.0), (0.05, 0.0, 0.0), 0.002),
    Body("humerus", "torso", "acromial", (0.0, SPINE_M - PELVIS_M, SHOULDERS_M / 2),
         (0.0, -ARM_M, 0.0), 0.028, _ball("arm_flex", "arm_add", "arm_rot")),
    Body("ulna", "humerus", "elbow", (0.0, -ARM_M, 0.0), (0.0, -FOREARM_M, 0.0), 0.008,
         (("elbow_flex", Z_AXIS),)),
    Body("radius", "ulna", "radioulnar", (0.0, 0.0, 0.0), (0.0, -FOREARM_M, 0.0), 0.008),
    Body("hand", "radius", "radius_hand", (0.0, -FOREARM_M, 0.0), (0.0, -HAND_M, 0.0), 0.006),
)  # fmt: skip
SHIFTS = ("pelvis_tx", "pelvis_ty", "pelvis_tz")


def sided(body: Body, suffix: str, outwards: float) -> Body:
    """Return a limb's body of the right (`r`, 1) or left side (`l`, -1)."""
    x, y, z = body.at_m
    mirrored = tuple(
        (f"{name}_{suffix}", (outwards * axis[0], outwards * axis[1], axis[2]))
        for name, axis in body.turns
    )
    parent = body.parent if body.parent in ("pelvis", "torso") else f"{body.parent}_{suffix}"
    return body._replace(
        name=f"{body.name}_{suffix}",
        parent=parent,
        joint=f"{body.joint}_{suffix}",
        at_m=(x, y, outwards * z),
        turns=mirrored,
    )


def bodies() -> list[Body]:
    """Return the bodies of the model, each after its parent."""
    sides = [sided(body, *side) for side in (("r", 1.0), ("l", -1.0)) for body in LIMBS]
    return [*MIDDLE, *sides]


def model_xml(name: str) -> xml.Element:
    """Return the model as a document of OpenSim 4."""
    document = xml.Element("OpenSimDocument", Version="40000")
    model = xml.SubElement(document, "Model", name=name)
    _text(model, "gravity", "0 -9.81 0")
    _text(model, "length_units", "meters")
    _text(model, "force_units", "N")
    body_objects = xml.SubElement(xml.SubElement(model, "BodySet", name="bodyset"), "objects")
    joint_objects = xml.SubElement(xml.SubElement(model, "JointSet", name="jointset"), "objects")
    for body in bodies():
        _add_body(body_objects, body)
        _add_joint(joint_objects, body)
    return document


def _add_body(objects: xml.Element, body: Body) -> None:
    node = xml.SubElement(objects, "Body", name=body.name)
    middle = [value / 2 for value in body.towards_m]
    length = math.hypot(*body.towards_m)
    along = [abs(value) / length for value in body.towards_m]
    radii = [length * (share / 2 + (1 - share) * THICKNESS / 2) for share in along]
    shapes = xml.SubElement(node, "components")
    frame = xml.SubElement(shapes, "PhysicalOffsetFrame", name=f"{body.name}_middle")
    shape = xml.SubElement(xml.SubElement(frame, "attached_geometry"), "Ellipsoid")
    shape.set("name", f"{body.name}_shape")
    _text(shape, "socket_frame", "..")
    _text(shape, "radii", _numbers(radii))
    _text(frame, "socket_parent", "..")
    _text(frame, "translation", _numbers(middle))
    mass_kg = body.mass * MASS_KG
    _text(node, "mass", f"{mass_kg:.6g}")
    _text(node, "mass_center", _numbers(middle))
    a, b, c = (radius**2 / 5 for radius in radii)  # of an ellipsoid, per kilogram
    inertia = [mass_kg * (b + c), mass_kg * (a + c), mass_kg * (a + b), 0.0, 0.0, 0.0]
    _text(node, "inertia", _numbers(inertia))


def _add_joint(objects: xml.Element, body: Body) -> None:
    kind = "CustomJoint" if body.turns else "WeldJoint"
    node = xml.SubElement(objects, kind, name=body.joint)
    parent = body.parent.strip("/")
    _text(node, "socket_parent_frame", f"{parent}_offset")
    _text(node, "socket_child_frame", f"{body.name}_offset")
    free = body.parent == "ground"
    names = [turn for turn, _ in body.turns] + (list(SHIFTS) if free else [])
    if names:
        coordinates = xml.SubElement(node, "coordinates")
        for name in names:
            coordinate = xml.SubElement(coordinates, "Coordinate", name=name)
            _text(coordinate, "default_value", "0.95" if name == "pelvis_ty" else "0")
            _text(coordinate, "range", "-50 50" if name in SHIFTS else "-3.1415927 3.1415927")
    frames = xml.SubElement(node, "frames")
    at_m = (0.0, 0.0, 0.0) if free else body.at_m
    sockets = (("/" + parent if free else f"/bodyset/{parent}", parent, at_m),
               (f"/bodyset/{body.name}", body.name, (0.0, 0.0, 0.0)))  # fmt: skip
    for socket, name, place in sockets:
        frame = xml.SubElement(frames, "PhysicalOffsetFrame", name=f"{name}_offset")
        _text(frame, "socket_parent", socket)
        _text(frame, "translation", _numbers(place))
        _text(frame, "orientation", "0 0 0")
    if body.turns:
        _add_transform(node, body)


def _add_transform(joint: xml.Element, body: Body) -> None:
    free = body.parent == "ground"
    transform = xml.SubElement(joint, "SpatialTransform")
    turns = [*body.turns, *(("", axis) for axis in _others(body.turns))]
    shifts = [(name if free else "", axis) for name, axis in zip(SHIFTS, AXES, strict=True)]
    for kind, moves in (("rotation", turns), ("translation", shifts)):
        for number, (name, axis) in enumerate(moves, start=1):
            move = xml.SubElement(transform, "TransformAxis", name=f"{kind}{number}")
            _text(move, "coordinates", name)
            _text(move, "axis", _numbers(axis))
            if name:
                function = xml.SubElement(move, "LinearFunction", name="function")
                _text(function, "coefficients", "1 0")
            else:
                _text(xml.SubElement(move, "Constant", name="function"), "value", "0")


AXES = (X_AXIS, Y_AXIS, Z_AXIS)


def _others(turns: tuple[tuple[str, Vector], ...]) -> list[Vector]:
    """Return axes for the rotations that a joint does not have: the format wants three."""
    used = [max(range(3), key=lambda i: abs(axis[i])) for _, axis in turns]
    return [axis for index, axis in enumerate(AXES) if index not in used]


def _text(parent: xml.Element, tag: str, text: str) -> None:
    xml.SubElement(parent, tag).text = text


def _numbers(values: tuple[float, ...] | list[float]) -> str:
    return " ".join(f"{value:.6g}" for value in values)
