"""What resting saves of a camera's processor time. Pure functions."""

from __future__ import annotations

LEAST = 5  # looks and frames from which the time of one is known
MOST_ASLEEP = 0.999  # of the time; of one that slept longer too little is known


def share_saved(
    cpu_s: float,
    look_cpu_s: float,
    looks: int,
    frames: int,
    slots: float,
    asleep_share: float = 0.0,
) -> float | None:
    """Return the share saved of the processor time that looking in every slot would take.

    What that would take is put together of the camera's own measured time of a look, and of a frame
    with all else that the program does: exact where these do not depend on how often it looks.

    Args:
        cpu_s: processor time of the program.
        look_cpu_s: part of it that looking took.
        looks: that it took.
        frames: that it captured.
        slots: that it could have looked in.
        asleep_share: of the time in which it captured nothing, as it slept, [0, 1].

    Returns:
        A share in [0, 1]; None while looks or frames are too few.
    """
    if min(looks, frames) < LEAST or cpu_s <= 0:
        return None
    look_s = look_cpu_s / looks
    frames_cpu_s = max(cpu_s - look_cpu_s, 0.0) / (1 - min(asleep_share, MOST_ASLEEP))
    return min(max(1 - cpu_s / (max(slots, looks) * look_s + frames_cpu_s), 0.0), 1.0)
