"""How many of the views ordered of each camera arrive in time, and which bring too few.

A camera that films 12.5 frames per second cannot fill 25 slots: half of the views ordered of it
never come, and nothing else tells of it. The share is a running mean over the newest orders; two
limits and a time after each warning keep it from flapping.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.edge.roster import CameraState

SHORT, ENOUGH = 0.9, 0.95  # shares at which the warning begins and ends
MEMORY_ORDERS = 500
MIN_ORDERS = 50  # before which a share says little
SETTLED_S = 20.0  # after a warning before the next


@dataclass(frozen=True, slots=True, eq=False)
class Delivery:
    """What cameras deliver of the views ordered of them; a value.

    Attributes:
        orders: `(num_cameras,)` orders counted, at most `MEMORY_ORDERS`.
        arrived: `(num_cameras,)` share of them whose view arrived in time.
        late: `(num_cameras,)` share of them after which a view of the camera came too late.
        short: `(num_cameras,)` whether a camera brings too few.
        since_s: `(num_cameras,)` seconds since that changed.
    """

    orders: Floats
    arrived: Floats
    late: Floats
    short: Flags
    since_s: Floats

    @classmethod
    def none(cls, num_cameras: int) -> Delivery:
        """Return the state before the first order."""
        zeros = np.zeros(num_cameras)
        short = np.zeros(num_cameras, dtype=bool)
        return cls(zeros, zeros, zeros, short, np.full(num_cameras, SETTLED_S))

    def share(self, camera: int) -> float | None:
        """Return the share of the newest orders whose view arrived; None while they are few."""
        return float(self.arrived[camera]) if self.orders[camera] >= MIN_ORDERS else None


def after_slot(
    before: Delivery,
    wanted: Flags,
    arrived: Flags,
    late: Flags,
    given_up: Flags,
    interval_s: float,
) -> Delivery:
    """Return what cameras deliver after one more slot.

    Args:
        before: the state before.
        wanted: `(num_cameras,)` cameras that had an order in time and were online.
        arrived: `(num_cameras,)` cameras whose view arrived in time.
        late: `(num_cameras,)` cameras of which a view came too late since the slot before.
        given_up: `(num_cameras,)` cameras that the failure detector gave up; they are counted anew
            once they are back.
        interval_s: seconds per slot.
    """
    orders = np.where(given_up, 0, np.minimum(before.orders + wanted, MEMORY_ORDERS))
    weight = np.where(wanted, 1 / np.maximum(orders, 1), 0.0)
    share = before.arrived + weight * (arrived - before.arrived)
    shorter = ~before.short & (orders >= MIN_ORDERS) & (share < SHORT)
    enough = before.short & (orders >= MIN_ORDERS) & (share >= ENOUGH)
    changed = (shorter & (before.since_s >= SETTLED_S)) | enough
    return Delivery(
        orders=orders,
        arrived=share,
        late=before.late + weight * (late - before.late),
        short=before.short ^ changed,
        since_s=np.where(changed, 0.0, before.since_s + interval_s),
    )


def shortages(
    delivery: Delivery, cameras: Sequence[CameraState], slots_hz: float, pace: float
) -> list[str]:
    """Return for each camera that brings too few views what is wrong and what to do; else empty.

    Args:
        delivery: of the cameras.
        cameras: their states.
        slots_hz: slots per second.
        pace: seconds of the scene per second.
    """
    return [
        _shortage(camera, delivery.share(index), float(delivery.late[index]), slots_hz, pace)
        if delivery.short[index] and (camera.frames_hz is not None or camera.counted is None)
        else ""  # also until the rate of its frames is known
        for index, camera in enumerate(cameras)
    ]


def _shortage(
    camera: CameraState, arrived: float | None, late: float, slots_hz: float, pace: float
) -> str:
    if arrived is None:
        return "too few views arrived before it was left out, its views are counted anew"
    frames_hz, share = camera.frames_hz, f"{arrived:.0%} of the views ordered of it arrive in time"
    if frames_hz is not None and frames_hz < SHORT * slots_hz:
        slower = f"fps = {frames_hz / pace:.3g}" if pace == 1 else "a lower pace"
        return (
            f"its source brings {frames_hz:.3g} frames per second, the site has {slots_hz:.3g} "
            f"slots: {share}; set {slower} in the site file, or raise the camera's frame rate"
        )
    if late > (1 - arrived) / 2:
        return f"{share}, the others too late: raise deadline_ms, or lower fps"
    if camera.dropped_hz is not None and camera.dropped_hz > (1 - arrived) * slots_hz / 4:
        return f"{share}, its detector is too slow: lower fps, or take a faster network"
    return f"{share}, the others get lost: check its network connection"
