"""Check every field of a message on arrival: ranges, shapes, lengths, printable text."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.model.camera_fields import check_camera_id
from e3pose.wire.arrays import DTYPES, MAX_PERSONS, unpack
from e3pose.wire.messages import Array, ClockAnswer, ClockQuestion, Heartbeat, Hello, Order, View
from e3pose.wire.site_messages import (
    CameraStatus,
    Control,
    Controlled,
    Picture,
    PictureQuestion,
    Poses,
    Status,
)

MAX_JOINTS = 512
MAX_EXPECTED = 32  # people; where there are more, their part of the image is most of it
MAX_SLOT = 2**53
MAX_TIME_NS = 2**62
MAX_PIXEL = 1e6
MAX_FIGURE = 1e15  # of a status: watts, milliseconds, millimetres; clocks that were set go far
MAX_CAMERAS = 1000
MAX_EVENTS = 1000
MAX_CAUSES = 32  # of blind slots
CAUSE = re.compile(r"[a-z-]{0,32}")
MAX_RESTS = 8
MAX_WAKE_S = 3600.0
SLOTS = ("slot", "session", "asleep_until_slot")
TEMPERATURES_C = (-273.15, 1000.0)


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


def _check_whole(where: str, **values: int) -> None:
    for name, value in values.items():
        limit = MAX_SLOT if name in SLOTS else MAX_TIME_NS
        if not 0 <= value <= limit:
            raise InputError(f"{where}: {name}: found {value}, expected 0 to {limit}")


def _check_numbers(where: str, low: float, high: float, **values: float | None) -> None:
    for name, value in values.items():
        if value is not None and not (math.isfinite(value) and low <= value <= high):
            raise InputError(f"{where}: {name}: found {value}, expected {low:g} to {high:g}")


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
    _check_whole(where, session=hello.session)
    if not 1 <= len(hello.joints) <= MAX_JOINTS:
        raise InputError(f"{where}: joints: found {len(hello.joints)}, expected 1 to {MAX_JOINTS}")
    _check_text(where, hello.detector, hello.software, *hello.joints)
    width, height = hello.image_size
    _check_numbers(where, 1, MAX_PIXEL, width=width, height=height)
    _check_numbers(where, 0.01, 1000, fps=hello.fps)
    _check_numbers(where, 0, 3600, wake_s=hello.wake_s)
    _check_numbers(where, 1e-6, 1e6, battery_wh=hello.battery_wh)
    if len(hello.rests) > MAX_RESTS:
        raise InputError(f"{where}: rests: found {len(hello.rests)}, expected at most {MAX_RESTS}")
    _check_text(where, *hello.rests)


def _check_view(view: View, where: str) -> None:
    check_camera_id(view.camera_id)
    _check_whole(
        where,
        session=view.session,
        slot=view.slot,
        captured_edge_ns=view.captured_edge_ns,
        clock_error_ns=view.clock_error_ns,
        detect_ns=view.detect_ns,
        sent_edge_ns=view.sent_edge_ns,
    )
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
    _check_whole(
        where,
        session=beat.session,
        sent_edge_ns=beat.sent_edge_ns,
        captured=beat.captured,
        detected=beat.detected,
        sent=beat.sent,
        dropped=beat.dropped,
        late_orders=beat.late_orders,
        orders=beat.orders,
        clock_error_ns=beat.clock_error_ns,
        order_delay_ns=beat.order_delay_ns,
        focused=beat.focused,
        asleep_until_slot=beat.asleep_until,
    )
    _check_numbers(where, -1e6, 1e6, clock_drift_ppm=beat.clock_drift_ppm)
    _check_numbers(
        where, -MAX_TIME_NS, MAX_TIME_NS, offset=beat.clock_offset_ns, margin=beat.order_margin_ns
    )
    _check_numbers(
        where,
        0,
        1e12,
        power_w=beat.power_w,
        energy_j=beat.energy_j,
        active_s=beat.active_s,
        idle_s=beat.idle_s,
        battery_j=beat.battery_j,
        charging_w=beat.charging_w,
        recording_j=beat.recording_j,
        asleep_s=beat.asleep_s,
        cpu_s=beat.cpu_s,
        look_cpu_s=beat.look_cpu_s,
    )
    _check_numbers(where, *TEMPERATURES_C, temperature_c=beat.temperature_c)
    _check_text(where, beat.problem)


def _check_order(order: Order, where: str) -> None:
    check_camera_id(order.camera_id)
    _check_whole(
        where,
        slot=order.slot,
        session=order.session,
        sent_edge_ns=order.sent_edge_ns,
        asleep_until_slot=order.asleep_until,
    )
    # Negative where a machine began at 1970 and goes on with the slots of before.
    _check_numbers(where, -MAX_TIME_NS, MAX_TIME_NS, origin_edge_ns=order.origin_edge_ns)
    _check_numbers(where, 1e6, 3.6e12, interval_ns=order.interval_ns)
    _check_numbers(where, 1, 1000, lead=order.lead)
    _check_numbers(where, 0, MAX_WAKE_S, wake_s=order.wake_s)
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
    _check_whole(where, sent_ns=question.sent_ns)


def _check_answer(answer: ClockAnswer, where: str) -> None:
    _check_whole(
        where,
        asked_ns=answer.asked_ns,
        received_edge_ns=answer.received_edge_ns,
        sent_edge_ns=answer.sent_edge_ns,
    )


def _check_poses(poses: Poses, where: str) -> None:
    _check_whole(where, slot=poses.slot, time_edge_ns=poses.time_edge_ns)
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
    _check_numbers(
        where,
        0,
        MAX_FIGURE,
        cameras=control.cameras,
        target_error_mm=control.target_error_mm,
        quality_weight=control.quality_weight,
    )
    if control.camera_id:
        check_camera_id(control.camera_id)
    _check_text(where, control.budget)


def _check_controlled(controlled: Controlled, where: str) -> None:
    _check_text(where, controlled.said, controlled.problem)


def _check_picture_question(question: PictureQuestion, where: str) -> None:
    _check_whole(where, have_ns=question.have_ns)


def _check_picture(picture: Picture, where: str) -> None:
    check_camera_id(picture.camera_id)
    _check_whole(
        where,
        slot=picture.slot,
        count=picture.count,
        captured_edge_ns=picture.captured_edge_ns,
    )
    _check_text(where, picture.why)
    width, height = picture.image_size
    _check_numbers(where, 1, MAX_PIXEL, width=width, height=height)
    _check_numbers(where, 0, MAX_FIGURE, energy_j=picture.energy_j)


def _check_status(status: Status, where: str) -> None:
    _check_whole(
        where,
        slot=status.slot,
        lead=status.lead,
        people=status.people,
        slots_lost=status.slots_lost,
        slots=status.slots,
    )
    for cause, slots in status.blind.items():
        _check_cause(cause, where)
        _check_whole(where, blind=slots)
    for name, found, most in (
        ("cameras", len(status.cameras), MAX_CAMERAS),
        ("blind", len(status.blind), MAX_CAUSES),
        ("events", len(status.events), MAX_EVENTS),
        ("events_ns", len(status.events_ns), len(status.events)),
    ):
        if found > most:
            raise InputError(f"{where}: {name}: found {found}, expected at most {most}")
    _check_text(where, status.site, status.overload, status.check, *status.events)
    for time_ns in status.events_ns:
        _check_whole(where, events_ns=time_ns)
    _check_numbers(where, 0, 1, blind_share=status.blind_share)
    _check_numbers(where, 0, MAX_FIGURE, fps=status.fps, error=status.expected_error_mm)
    _check_numbers(
        where,
        0,
        MAX_FIGURE,
        num_selected=status.num_selected,
        target_error_mm=status.target_error_mm,
        quality_weight=status.quality_weight,
        compiling_s=status.compiling_s,
    )
    # Below zero where a clock was set back meanwhile.
    for name, durations in (("step_ms", status.step_ms), ("latency_ms", status.latency_ms)):
        for value in durations:
            _check_numbers(where, -MAX_FIGURE, MAX_FIGURE, **{name: value})
    _check_numbers(where, -MAX_FIGURE, MAX_FIGURE, uptime_s=status.uptime_s)
    for camera in status.cameras:
        _check_camera_status(camera, f"{where}: camera {check_camera_id(camera.camera_id)}")


def _check_camera_status(camera: CameraStatus, where: str) -> None:
    _check_text(where, camera.why)
    _check_whole(
        where,
        late=camera.late,
        lost=camera.lost,
        focused=camera.focused,
        ordered=camera.ordered,
    )
    _check_numbers(
        where, 0, 1, duty=camera.duty, battery=camera.battery, delivered=camera.delivered
    )
    _check_numbers(where, 0, MAX_FIGURE, power_w=camera.power_w, source_fps=camera.source_fps)
    _check_numbers(where, 0, MAX_FIGURE, wake_s=camera.wake_s, cpu_s=camera.cpu_s)
    _check_numbers(where, 0, 1, cpu_saved=camera.cpu_saved)
    _check_numbers(
        where,
        -MAX_FIGURE,
        MAX_FIGURE,
        last_seen_s=camera.last_seen_s,
        deficit=camera.deficit,
        clock_offset_ms=camera.clock_offset_ms,
        gain_nats=camera.gain_nats,
        price=camera.price,
        asleep_s=camera.asleep_s,
    )
    _check_numbers(where, 0, 1, occlusion=camera.occlusion, budget=camera.budget)
    _check_numbers(where, *TEMPERATURES_C, temperature_c=camera.temperature_c)


CHECKS: dict[type[Any], Any] = {
    Hello: _check_hello,
    View: _check_view,
    Heartbeat: _check_heartbeat,
    Order: _check_order,
    ClockQuestion: _check_question,
    ClockAnswer: _check_answer,
    Poses: _check_poses,
    Control: _check_control,
    Controlled: _check_controlled,
    PictureQuestion: _check_picture_question,
    Picture: _check_picture,
    Status: _check_status,
}
