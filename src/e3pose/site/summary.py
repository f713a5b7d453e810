"""The summary that a program prints when it stops."""

from __future__ import annotations

from e3pose.base.quantities import plural
from e3pose.camera.status import CameraCounts
from e3pose.model.blind_slot import blind_words
from e3pose.wire.site_messages import CameraStatus, Status


def edge_summary(status: Status, slots: int, views: int) -> list[str]:
    """Return a summary of an edge's run, and the final state of each camera, one per line.

    Args:
        status: its last.
        slots: that it computed.
        views: that came in time.
    """
    if slots == 0:
        lines = ["No slots: fewer than two cameras connected"]
    else:
        lines = [
            f"{plural(slots, 'slot')}, {status.slots_lost} lost, {_blind(status)}, "
            f"{plural(views, 'view')} in "
            f"time; lead {status.lead}; computing {_quantiles(status.step_ms)} per slot, latency "
            f"{_quantiles(status.latency_ms)} after the last view"
        ]
    return lines + [f"  {c.title}: {_camera(c)}" for c in status.cameras]


def _blind(status: Status) -> str:
    causes = f" ({blind_words(status.blind)})" if status.blind else ""
    return f"{sum(status.blind.values())} blind{causes}"


def camera_summary(
    camera_id: str, done: CameraCounts, orders: int, late: int, problem: str = ""
) -> str:
    """Return the summary of a camera.

    Args:
        camera_id: who.
        done: what it counted.
        orders: that came.
        late: of those, that came too late.
        problem: of its source, in the end.
    """
    if not done.captured:
        return f"{camera_id}: no frames" + (f": {problem}" if problem else "")
    if not orders:
        return f"{camera_id}: {plural(done.captured, 'frame')}, but no orders from the edge"
    return (
        f"{camera_id}: {plural(done.captured, 'frame')}, {done.detected} processed, "
        f"{plural(done.sent, 'view')} sent, {plural(late, 'late order')}"
    )


def _camera(camera: CameraStatus) -> str:
    state = ", ".join(word for word in ("online" if camera.online else "", camera.why) if word)
    if camera.last_seen_s is None:
        return state
    return (
        f"{state}; active in {camera.duty:.0%} of the last minute's slots, "
        f"{plural(camera.late, 'view')} late, {camera.lost} lost"
    )


def _quantiles(durations_ms: tuple[float, float]) -> str:
    return f"{durations_ms[0]:.1f} ms (99 %: {durations_ms[1]:.1f})"
