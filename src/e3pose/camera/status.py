"""Reports of a camera about itself: hello and heartbeat."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from e3pose import __version__
from e3pose.camera.base import NodeSettings
from e3pose.camera.schedule import Schedule
from e3pose.model.pose import Poses2D
from e3pose.wire.arrays import pack_poses
from e3pose.wire.codec import one_line
from e3pose.wire.messages import RESTING, Heartbeat, Hello, View
from e3pose.wire.offset import Offset


@dataclass(slots=True)
class CameraCounts:
    """Counters of a camera.

    Attributes:
        captured: frames taken.
        detected: frames on which the detector ran.
        unchanged: frames in which nothing changed since the last look, so that it did not run.
        sent: views sent.
        focused: detected frames with an expected view.
        cpu_s: processor time of the program.
        look_cpu_s: part of it that looking took.
        margin_ns: least time from an order to its slot since the last heartbeat; None without one.
        delay_ns: longest time from the slot in which an order was made to its arrival, likewise.
    """

    captured: int = 0
    detected: int = 0
    unchanged: int = 0
    sent: int = 0
    focused: int = 0
    cpu_s: float = 0.0
    look_cpu_s: float = 0.0
    margin_ns: int | None = None
    delay_ns: int = 0


def hello_message(
    settings: NodeSettings, session: int, fps: float, image_size: tuple[int, int]
) -> Hello:
    """Return the hello of a camera.

    Args:
        settings: of the camera.
        session: of its program.
        fps: of its source.
        image_size: `(width, height)` in pixels of its frames.
    """
    return Hello(
        camera_id=settings.camera_id,
        session=session,
        joints=settings.joints,
        image_size=image_size,
        fps=fps,
        wake_s=settings.wake_s,
        detector=settings.detector,
        software=__version__,
        battery_wh=settings.battery_wh,
        rests=settings.rests,
    )


def view_message(
    camera_id: str,
    session: int,
    slot: int,
    poses: Poses2D,
    captured_edge_ns: int,
    detect_ns: int,
    now_edge_ns: int,
    clock_error_ns: int,
) -> View:
    """Return the view of a camera; times are estimates of the edge's, which may be before 1970.

    Args:
        camera_id: of the camera.
        session: of its program.
        slot: of the frame.
        poses: who is in it.
        captured_edge_ns: when it was taken.
        detect_ns: how long looking took.
        now_edge_ns: the time.
        clock_error_ns: how far these times may be off.
    """
    keypoints_px, scores = pack_poses(poses)
    return View(
        camera_id=camera_id,
        session=session,
        slot=slot,
        captured_edge_ns=max(captured_edge_ns, 0),
        keypoints_px=keypoints_px,
        scores=scores,
        clock_error_ns=clock_error_ns,
        detect_ns=detect_ns,
        sent_edge_ns=max(now_edge_ns, 0),
        unchanged_ns=round(1e9 * poses.unchanged_s),
    )


def heartbeat_message(
    camera_id: str,
    session: int,
    counts: CameraCounts,
    schedule: Schedule,
    offset: Offset,
    now_ns: int,
    spent: Mapping[str, Any],
    *,
    dropped: int,
    problem: str,
    ends: bool,
) -> Heartbeat:
    """Return a heartbeat of a camera.

    Args:
        camera_id: of the camera.
        session: of its program.
        counts: its counters.
        schedule: its orders.
        offset: of its clock.
        now_ns: the time, by its own clock.
        spent: fields of the heartbeat: its mode, the time in each, power and energy.
        dropped: frames and views that a newer one replaced.
        problem: why it does not work; empty if it does.
        ends: whether its program is stopped.
    """
    edge_ns = offset.edge_ns(now_ns)
    return Heartbeat(
        camera_id=camera_id,
        session=session,
        sent_edge_ns=max(edge_ns, 0),
        captured=counts.captured,
        detected=counts.detected,
        sent=counts.sent,
        dropped=dropped,
        late_orders=schedule.late,
        orders=schedule.orders,
        order_margin_ns=counts.margin_ns or 0,
        clock_offset_ns=edge_ns - now_ns,
        clock_drift_ppm=offset.drift_ppm,
        clock_error_ns=offset.error_ns or 0,
        problem=one_line(problem),
        order_delay_ns=max(counts.delay_ns, 0),
        ends=ends,
        focused=counts.focused,
        asleep_until=schedule.asleep_until if spent["mode"] in RESTING else 0,
        cpu_s=counts.cpu_s,
        look_cpu_s=counts.look_cpu_s,
        unchanged=counts.unchanged,
        **spent,
    )
