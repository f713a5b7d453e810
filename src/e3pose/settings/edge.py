"""Settings of the edge server."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from e3pose.model.skeleton import Skeleton
from e3pose.wire.messages import CameraMode


@dataclass(frozen=True, slots=True)
class EdgeSettings:
    """Settings of an edge server.

    Attributes:
        site: its name, and so its topics.
        skeleton: of the poses.
        deadline_s: how long after the middle of a slot its views are waited for.
        idle_modes: what each camera does in slots without an order.
        adaptive_lead: whether the lead follows the delays; otherwise it stays.
        start_wait_s: how long to wait for the rest once two cameras are there.
        pace: seconds of the scene that pass in a second; below 1 recordings are played slower.
        publish_stored: whether poses are published once they are stored, not at once.
        known: joints of detectors that the skeleton was chosen for: those of others must not be
            lost in the conversion. None for any.
        wakes_s: `(num_cameras,)` configured wake-up times; empty where none are.
        smooth_delay_s: how much later poses are published a second time, smoothed; 0 for never.
    """

    site: str
    skeleton: Skeleton
    deadline_s: float
    idle_modes: Sequence[CameraMode]
    adaptive_lead: bool = True
    start_wait_s: float = 3.0
    pace: float = 1.0
    smooth_delay_s: float = 0.0
    publish_stored: bool = False
    wakes_s: Sequence[float] = ()
    known: Collection[tuple[str, ...]] | None = None
