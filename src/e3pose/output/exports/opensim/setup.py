"""Set-up files of OpenSim's scale tool and of its inverse kinematics, beside the markers.

The tools are described in OpenSim's user guide (Scale Setup File, Inverse Kinematics Setup File).
Scale factors are measured between markers over the whole time, since a recorded walk has no static
pose; markers stay where they are on the model, because they are joints. What keypoints do not tell
(how the pelvis tilts by itself, how limbs turn about themselves) is held near zero by a weak task.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree as xml

import numpy as np
from numpy.typing import NDArray

from e3pose.base.atomic import atomic_file
from e3pose.base.bounded import read_bytes
from e3pose.estimate.smooth.gaps import stretches
from e3pose.model.skeleton import Skeleton, not_used
from e3pose.model.take import Motion, Take
from e3pose.output.exports.opensim.markers import NAMES, Marker, markers
from e3pose.output.exports.opensim.model import MASS_KG, model_xml

# What is measured between which joints of either side, and what it scales along which axes.
MEASURES = (
    ("hips", (("left_hip", "right_hip"),), ("pelvis",), "X Z"),
    ("trunk", (("left_hip", "left_shoulder"), ("right_hip", "right_shoulder")),
     ("pelvis", "torso"), "Y"),
    ("shoulders", (("left_shoulder", "right_shoulder"),), ("torso",), "X Z"),
    ("thighs", (("left_hip", "left_knee"), ("right_hip", "right_knee")),
     ("femur_l", "femur_r"), "X Y Z"),
    ("shanks", (("left_knee", "left_ankle"), ("right_knee", "right_ankle")),
     ("tibia_l", "tibia_r"), "X Y Z"),
    ("feet", (("left_heel", "left_big_toe"), ("right_heel", "right_big_toe")),
     ("talus_l", "calcn_l", "toes_l", "talus_r", "calcn_r", "toes_r"), "X Y Z"),
    ("upper_arms", (("left_shoulder", "left_elbow"), ("right_shoulder", "right_elbow")),
     ("humerus_l", "humerus_r"), "X Y Z"),
    ("forearms", (("left_elbow", "left_wrist"), ("right_elbow", "right_wrist")),
     ("ulna_l", "radius_l", "hand_l", "ulna_r", "radius_r", "hand_r"), "X Y Z"),
)  # fmt: skip
# Coordinates that markers of joints hardly tell, with the weight that holds them near zero.
HELD = {
    "lumbar_extension": 0.1,
    **{f"{name}_{side}": 0.001 for name in ("hip_rotation", "arm_rot") for side in "lr"},
    **{f"{name}_{side}": 0.001 for name in ("ankle_angle", "subtalar_angle") for side in "lr"},
}


MAX_MODEL_BYTES = 2**27  # of a model that somebody else made
LEAST_MARKERS = 3  # of a frame, for inverse kinematics: OpenSim gives up at a frame without any


def write_setup(trc: Path, take: Take, names: str, osim: Path | None = None) -> str:
    """Write model, marker set, scale and inverse-kinematics set-ups beside a file of markers.

    OpenSim measures nothing between markers that are missing in a frame of its time range, and ends
    at a frame without markers: each tool gets the longest time without such frames.

    Args:
        trc: the file, `walk.trc`; the others are `walk-model.osim`, `walk-markers.xml`,
            `walk-scale.xml` and `walk-ik.xml`, and name what the tools will write.
        take: of the one person.
        names: a key of `NAMES`.
        osim: the model to scale; that beside the markers if None.

    Returns:
        A note about them.
    """
    (motion,), skeleton = take.motions, take.skeleton
    there = markers(skeleton, names)
    joints = {NAMES[names].get(joint): row for row, joint in enumerate(skeleton.joints)}
    known = motion.known[:, [joints[marker.name] for marker in there]]
    whole_s = _longest_s(np.asarray(known.all(axis=1)), motion, take.interval_s)
    some_s = _longest_s(np.asarray(known.sum(axis=1) >= LEAST_MARKERS), motion, take.interval_s)
    model, held = f"{trc.stem}-model.osim", HELD
    if osim is not None:
        model, text = (
            str(osim.absolute()),
            read_bytes(osim, MAX_MODEL_BYTES).decode(errors="replace"),
        )
        held = {name: HELD[name] for name in HELD if f'<Coordinate name="{name}"' in text}
    documents = {
        **({"-model.osim": model_xml("e3pose")} if osim is None else {}),
        "-markers.xml": _document(_marker_set(there)),
        "-scale.xml": _document(_scale(trc.stem, model, skeleton, names, whole_s or some_s)),
        "-ik.xml": _document(_inverse_kinematics(trc.stem, there, held, some_s)),
    }
    paths = []
    for ending, document in documents.items():
        path = trc.with_name(f"{trc.stem}{ending}")
        xml.indent(document)
        with atomic_file(path, private=True) as temporary:
            xml.ElementTree(document).write(temporary, encoding="UTF-8", xml_declaration=True)
        paths.append(path)
    missing = "" if whole_s else "; no frame has all markers, which the scale tool needs: --fill"
    core = set(skeleton.core)
    details = [joint for index, joint in enumerate(skeleton.joints) if index not in core]
    left = f"; the model: {not_used(details, len(skeleton))}" if details else ""
    return f"beside it {', '.join(path.name for path in paths)}{missing}{left}"


def _longest_s(
    good: NDArray[np.bool_], motion: Motion, interval_s: float
) -> tuple[float, float] | None:
    """Return the first and last time of the longest run of good frames; None without any."""
    found = max(stretches(good, 0), key=lambda run: run[1] - run[0], default=None)
    if found is None:
        return None
    return (motion.first + found[0]) * interval_s, (motion.first + found[1] - 1) * interval_s


def _document(content: xml.Element) -> xml.Element:
    document = xml.Element("OpenSimDocument", Version="40000")
    document.append(content)
    return document


def _marker_set(there: Sequence[Marker]) -> xml.Element:
    root = xml.Element("MarkerSet", name="markerset")
    objects = xml.SubElement(root, "objects")
    for marker in there:
        node = _node(objects, "Marker", name=marker.name)
        _fill(node, socket_parent_frame=f"/bodyset/{marker.body}",
              location=_numbers(marker.at_m), fixed="true")  # fmt: skip
    return root


def _scale(
    stem: str, model: str, skeleton: Skeleton, names: str, span_s: tuple[float, float] | None
) -> xml.Element:
    root = xml.Element("ScaleTool", name=stem)
    _fill(root, mass=f"{MASS_KG:g}")
    maker = _node(root, "GenericModelMaker")
    _fill(maker, model_file=model, marker_set_file=f"{stem}-markers.xml")
    scaler = _node(root, "ModelScaler")
    _fill(scaler, apply="true", scaling_order="measurements")
    objects = _node(_node(scaler, "MeasurementSet"), "objects")
    for name, pairs, bodies, axes in MEASURES:
        if not {joint for pair in pairs for joint in pair} <= set(skeleton.joints):
            continue
        measure = _node(objects, "Measurement", name=name)
        _fill(measure, apply="true")
        ends = _node(_node(measure, "MarkerPairSet"), "objects")
        for pair in pairs:
            _fill(_node(ends, "MarkerPair"), markers=" ".join(NAMES[names][j] for j in pair))
        scales = _node(_node(measure, "BodyScaleSet"), "objects")
        for body in bodies:
            _fill(_node(scales, "BodyScale", name=body), axes=axes)
    _fill(scaler, marker_file=f"{stem}.trc", time_range=_numbers(span_s or ()),
          preserve_mass_distribution="true", output_model_file=f"{stem}-scaled.osim",
          output_scale_file=f"{stem}-factors.xml")  # fmt: skip
    return root


def _inverse_kinematics(
    stem: str,
    there: Sequence[Marker],
    held: Mapping[str, float],
    span_s: tuple[float, float] | None,
) -> xml.Element:
    root = xml.Element("InverseKinematicsTool", name=stem)
    _fill(root, model_file=f"{stem}-scaled.osim", constraint_weight="20", accuracy="1e-05")
    tasks = _node(_node(root, "IKTaskSet"), "objects")
    for marker in there:
        task = _node(tasks, "IKMarkerTask", name=marker.name)
        _fill(task, apply="true", weight=f"{marker.weight:g}")
    for name, weight in held.items():
        task = _node(tasks, "IKCoordinateTask", name=name)
        _fill(task, apply="true", weight=f"{weight:g}", value_type="manual_value", value="0")
    _fill(root, marker_file=f"{stem}.trc", time_range=_numbers(span_s or ()), report_errors="true",
          output_motion_file=f"{stem}-ik.mot", report_marker_locations="false")  # fmt: skip
    return root


def _node(parent: xml.Element, tag: str, **attributes: str) -> xml.Element:
    return xml.SubElement(parent, tag, attributes)


def _fill(parent: xml.Element, **values: str) -> None:
    for tag, text in values.items():
        xml.SubElement(parent, tag).text = text


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:.6f}" for value in values)
