"""Calibration files of Qualisys Track Manager (`.qca.txt`, XML).

Lengths are millimetres, pixels are counted in 64ths, `transform` holds the camera's axes as rows
and its centre, and the camera looks along its negative z axis with y up. The distortion is of
normalised points, as OpenCV's: its coefficients are not in 64ths.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.recording.calibration import fields

SUBPIXELS = 64
MODELS_WITH_VIDEO = ("video", "none")  # others of Qualisys' cameras see markers only
TO_OPENCV = np.diag([1.0, -1.0, -1.0])  # from y up, looking along -z


def load(path: Path, notes: list[str]) -> Rig:
    """Read the active video cameras of a Qualisys calibration."""
    text = fields.read_text(path)
    if "<!DOCTYPE" in text:  # hence no entities of any kind
        raise InputError(f"{path}: found a document type declaration, expected plain XML")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: found text that is not whole XML: {error}") from None
    if root.tag != "calibration":
        raise InputError(f"{path}: found XML of <{root.tag[:40]}>, expected <calibration>")
    entries = [e for e in root.findall("cameras/camera") if e.get("active", "1") == "1"]
    videos = [e for e in entries if _films(e)]
    cameras = [_camera(path, index, entry, notes) for index, entry in enumerate(videos or entries)]
    return fields.make_rig(path, cameras, "millimetres", notes)


def _films(entry: ElementTree.Element) -> bool:
    model = entry.get("model", "none").lower()
    return any(word in model for word in MODELS_WITH_VIDEO)


def _camera(path: Path, index: int, entry: ElementTree.Element, notes: list[str]) -> Camera:
    name = entry.get("serial", "")
    where = f"{path}: camera {fields.name_of(name)[:80]} (number {index + 1})"

    def value(tag: str, attribute: str, default: str | None = None) -> float:
        element = entry.find(tag)
        text = default if element is None else element.get(attribute, default)
        if text is None:
            raise InputError(f"{where}: {tag} {attribute}: found nothing, expected a number")
        return fields.scalar(text, f"{where}: {tag} {attribute}")

    turned = entry.get("viewrotation", "0")
    if turned != "0":
        raise InputError(
            f"{where}: viewrotation: found {turned!r:.40}, expected 0; if the videos are stored as "
            'the sensor sees them, write viewrotation="0"'
        )
    left, top = value("fov_video", "left"), value("fov_video", "top")
    size = (value("fov_video", "right") - left + 1, value("fov_video", "bottom") - top + 1)
    resolution = entry.get("video_resolution", "").removesuffix("p")
    # 1080p cameras have 1088 lines; a field of view cut smaller than the sensor is fine too.
    if resolution.isdecimal() and int(resolution[:6]) + 8 < min(size):
        raise InputError(
            f"{where}: video_resolution: found {resolution[:6]}p for a field of view of "
            f"{size[0]:g} x {size[1]:g}, expected video at full resolution"
        )
    fu, fv, cu, cv, skew = (
        value("intrinsic", attribute, default) / SUBPIXELS
        for attribute, default in (
            ("focalLengthU", None),
            ("focalLengthV", None),
            ("centerPointU", None),
            ("centerPointV", None),
            ("skew", "0"),
        )
    )
    K = np.array([[fu, skew, cu - left], [0.0, fv, cv - top], [0.0, 0.0, 1.0]])
    k1, k2, k3 = (value("intrinsic", f"radialDistortion{i}", "0") for i in (1, 2, 3))
    # The attribute is spelled so by Qualisys.
    p1, p2 = (value("intrinsic", f"tangentalDistortion{i}", "0") for i in (1, 2))
    axes = np.array([[value("transform", f"r{i}{j}") for j in (1, 2, 3)] for i in (1, 2, 3)])
    center_m = np.array([value("transform", axis) for axis in "xyz"]) / 1000
    rotation = TO_OPENCV @ axes
    distortion = np.array([k1, k2, p1, p2, k3])
    with np.errstate(all="ignore"):
        translation_m = -rotation @ center_m
    return fields.make_camera(path, name, size, K, rotation, translation_m, distortion)
