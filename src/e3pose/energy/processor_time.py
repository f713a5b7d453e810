"""What resting saves of a camera's processor time. Pure functions."""

from __future__ import annotations

LEAST = 5  # looks and frames from which the time of one is known


def share_saved(
    cpu_s: float,
    look_cpu_s: float,
    looks: int,
    frames: int,
    span_s: float,
    slots_hz: float,
    frames_hz: float,
) -> float | None:
    """Return the share saved of the processor time that looking in every slot would take.

    What that would take is put together of the camera's own measured time of a look, and of a frame
    with all else that the program does: exact where these do not depend on how often it looks.

    Args:
        cpu_s: processor time of the program.
        look_cpu_s: part of it that looking took.
        looks: that it took.
        frames: that it captured.
        span_s: seconds in which that was.
        slots_hz: slots per second.
        frames_hz: frames per second of its source while it captures.

    Returns:
        A share in [0, 1]; None while looks or frames are too few.
    """
    if min(looks, frames) < LEAST or cpu_s <= 0:
        return None
    look_s = look_cpu_s / looks
    frame_s = max(cpu_s - look_cpu_s, 0.0) / frames
    every_s = max(span_s * slots_hz, looks) * look_s + max(span_s * frames_hz, frames) * frame_s
    return min(max(1 - cpu_s / every_s, 0.0), 1.0)
