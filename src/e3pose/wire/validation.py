"""Check what types and bounds of a message do not say: shapes, lengths, names, printable text."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.model.camera_fields import check_camera_id
from e3pose.model.skeleton import MAX_JOINTS
from e3pose.wire.arrays import DTYPES, MAX_PERSONS, unpack
from e3pose.wire.bounds import MAX_SLOT
from e3pose.wire.messages import Array, ClockQuestion, Heartbeat, Hello, Order, View
from e3pose.wire.site_messages import (
    Control,
    Controlled,
    Picture,
    Poses,
    Status,
)

MAX_EXPECTED = 32  # people; where there are more, their part of the image is most of it
MAX_PIXEL = 1e6
MAX_CAMERAS = 1000
MAX_EVENTS = 1000
MAX_CAUSES = 32  # of blind slots
CAUSE = re.compile(r"[a-z-]{0,32}")
MAX_RESTS = 8


def _check_array(array: Array, where: str, dtype: str, *shape: int | None) -> NDArray[Any]:
    fits = len(array.shape) == len(shape) and all(
        0 <= found <= MAX_JOINTS and (wanted is None or found == wanted)
        for found, wanted in zip(array.shape, shape, strict=True)
    )
    if not fits or array.dtype != dtype:
        wanted = ", ".join("any" if length is None else str(length) for length in shape)
        raise InputError(
            f"{where}: found {array.dtype} {str(array.shape)[:60]}, expected {dtype} ({wanted})"
        )
    if len(array.data) != math.prod(array.shape) * DTYPES[dtype].itemsize:
        raise InputError(f"{where}: found {len(array.data)} bytes, expected shape {array.shape}")
    if dtype == "b1" and max(array.data, default=0) > 1:
        raise InputError(f"{where}: found a flag that is neither 0 nor 1")
    return unpack(array)


def _check_persons(array: Array, where: str, most: int = MAX_PERSONS) -> int:
    persons = array.shape[0] if array.shape else -1
    if not 0 <= persons <= most:
        raise InputError(f"{where}: found {persons} people, expected at most {most}")
    return persons


def _check_image_size(size: tuple[int, int], where: str) -> None:
    for name, pixels in zip(("width", "height"), size, strict=True):
        if not 1 <= pixels <= MAX_PIXEL:
            raise InputError(f"{where}: {name}: found {pixels}, expected 1 to {MAX_PIXEL:g}")


def _check_text(where: str, *texts: str) -> None:
    for text in texts:
        if len(text) > 500 or not text.isprintable():
            raise InputError(f"{where}: found text {text[:40]!r}, expected one printable line")


def _check_cause(cause: str, where: str) -> None:
    """Check why a slot is blind: one of `blind_slot.CAUSES`, or one that a newer edge knows."""
    if not CAUSE.fullmatch(cause):
        raise InputError(f"{where}: blind: found {cause[:40]!r}, expected words such as views-late")


def _check_hello(hello: Hello, where: str) -> None:
    check_camera_id(hello.camera_id)
    if not 1 <= len(hello.joints) <= MAX_JOINTS:
        raise InputError(f"{where}: joints: found {len(hello.joints)}, expected 1 to {MAX_JOINTS}")
    _check_text(where, hello.detector, hello.software, *hello.joints)
    _check_image_size(hello.image_size, where)
    if len(hello.rests) > MAX_RESTS:
        raise InputError(f"{where}: rests: found {len(hello.rests)}, expected at most {MAX_RESTS}")
    _check_text(where, *hello.rests)


def _check_view(view: View, where: str) -> None:
    check_camera_id(view.camera_id)
    persons = _check_persons(view.scores, where)
    scores = _check_array(view.scores, f"{where}: scores", "f4", persons, None)
    keypoints = _check_array(
        view.keypoints_px, f"{where}: keypoints", "f4", persons, scores.shape[1], 2
    )
    if not (scores.min(initial=0) >= 0 and scores.max(initial=0) <= 1):  # NaN fails too
        raise InputError(f"{where}: scores: found one outside 0 to 1")
    if (np.abs(keypoints) > MAX_PIXEL).any():  # NaN is a missing keypoint
        raise InputError(f"{where}: keypoints: found one beyond {MAX_PIXEL:g} pixels")


def _check_heartbeat(beat: Heartbeat, where: str) -> None:
    check_camera_id(beat.camera_id)
    _check_text(where, beat.problem)


def _check_order(order: Order, where: str) -> None:
    check_camera_id(order.camera_id)
    if order.expected_px is None or order.reach_px is None:
        return
    persons = _check_persons(order.reach_px, where, MAX_EXPECTED)
    reach_px = _check_array(order.reach_px, f"{where}: reach", "f4", persons)
    expected_px = _check_array(order.expected_px, f"{where}: expected", "f4", persons, None, 2)
    if not ((reach_px >= 0) & (reach_px <= MAX_PIXEL)).all():  # NaN fails too
        raise InputError(f"{where}: reach: found one outside 0 to {MAX_PIXEL:g} pixels")
    if (np.abs(expected_px) > MAX_PIXEL).any():  # NaN is a joint that nobody knows of
        raise InputError(f"{where}: expected: found one beyond {MAX_PIXEL:g} pixels")


def _check_question(question: ClockQuestion, where: str) -> None:
    check_camera_id(question.camera_id)


def _check_poses(poses: Poses, where: str) -> None:
    for name in ("stored_from", "stored_to", "store_shed"):
        if not -1 <= getattr(poses, name) <= MAX_SLOT:
            raise InputError(
                f"{where}: {name}: found {getattr(poses, name)}, expected a slot or -1"
            )
    _check_text(where, *poses.joints)
    for camera_id in (*poses.selected, *poses.arrived):
        check_camera_id(camera_id)
    _check_cause(poses.blind, where)
    if len(poses.selected) > MAX_CAMERAS or len(poses.arrived) > MAX_CAMERAS:
        raise InputError(f"{where}: cameras: found more than {MAX_CAMERAS}")
    persons, joints = _check_persons(poses.track_ids, where), len(poses.joints)
    _check_array(poses.track_ids, f"{where}: track_ids", "i8", persons)
    _check_array(poses.joints_m, f"{where}: joints_m", "f4", persons, joints, 3)
    _check_array(poses.sigma_m, f"{where}: sigma_m", "f4", persons, joints)
    _check_array(poses.measured, f"{where}: measured", "b1", persons, joints)


def _check_control(control: Control, where: str) -> None:
    if control.camera_id:
        check_camera_id(control.camera_id)
    _check_text(where, control.budget)


def _check_controlled(controlled: Controlled, where: str) -> None:
    _check_text(where, controlled.said, controlled.problem)


def _check_picture(picture: Picture, where: str) -> None:
    check_camera_id(picture.camera_id)
    _check_text(where, picture.why)
    _check_image_size(picture.image_size, where)


def _check_status(status: Status, where: str) -> None:
    for cause in status.blind:
        _check_cause(cause, where)
    for name, found, most in (
        ("cameras", len(status.cameras), MAX_CAMERAS),
        ("blind", len(status.blind), MAX_CAUSES),
        ("events", len(status.events), MAX_EVENTS),
        ("events_ns", len(status.events_ns), len(status.events)),
    ):
        if found > most:
            raise InputError(f"{where}: {name}: found {found}, expected at most {most}")
    texts = (status.site, status.overload, status.doubt, status.check)
    _check_text(where, *texts, *status.events)
    for camera in status.cameras:
        _check_text(f"{where}: camera {check_camera_id(camera.camera_id)}", camera.why)


# Of kinds of which that is not all; a number has its bounds where it is declared.
CHECKS: dict[type[Any], Any] = {
    Hello: _check_hello,
    View: _check_view,
    Heartbeat: _check_heartbeat,
    Order: _check_order,
    ClockQuestion: _check_question,
    Poses: _check_poses,
    Control: _check_control,
    Controlled: _check_controlled,
    Picture: _check_picture,
    Status: _check_status,
}
