"""The program on a camera: a camera file in, a running `CameraNode` out."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from e3pose.camera.base import LiveDetector, NodeSettings
from e3pose.camera.live import CameraNode
from e3pose.camera.live_source import RecordedDetector, make_source
from e3pose.clock import Clock
from e3pose.energy.meters.charge_file import RememberedCharge
from e3pose.errors import InputError
from e3pose.settings.site_file import NodeTable, place
from e3pose.wire.access import Link, check_link, split_endpoint
from e3pose.wire.keys.folder import certificates_in, check_certificates
from e3pose.wire.transport import Transport

RECORDED = "recorded"
ALONE_S = 5.0


def camera_link(node: NodeTable, folder: Path) -> Link:
    """Return how a camera joins its site.

    Args:
        node: its configuration.
        folder: to which its paths are relative.

    Raises:
        InputError: for an endpoint that is not safe, or certificates that cannot be used.
    """
    certificates = None
    if split_endpoint(node.endpoint)[0] == "tls" and node.keys is not None:
        certificates = certificates_in(place(folder, node.keys), "camera")
        check_certificates(certificates, datetime.datetime.now(datetime.timezone.utc))
    link = Link("camera", node.site, node.endpoint, certificates, insecure=node.insecure)
    check_link(link)
    return link


def remembered_charge(
    node: NodeTable, config: Path | None, tell: Callable[[str], None]
) -> RememberedCharge | None:
    """Return what is left in a camera's battery; None on mains.

    Args:
        node: its configuration.
        config: the camera file, beside which the charge is remembered unless it says where.
        tell: called with what a person should know.
    """
    if node.battery_wh is None:
        return None
    path = None
    if node.state:
        path = place(Path() if config is None else config.parent, node.state)
    elif node.state is None and config is not None:
        path = config.with_name(f"{config.stem}.battery.json")
    elif node.state is None:
        tell("a battery without a gauge is taken to be full at every start; --state remembers it")
    return RememberedCharge(path, node.camera, node.battery_wh, tell)


@dataclass(slots=True, eq=False)
class EdgeWatch:
    """Tells a person whether the edge is there: a camera without one waits in silence.

    Attributes:
        tell: called with what a person should know.
        endpoint: where the edge is looked for.
        alone_s: seconds without the edge, at the start, before that is told.
    """

    tell: Callable[[str], None]
    endpoint: str
    alone_s: float = ALONE_S
    _there: bool = False
    _since_s: float | None = None
    _told: bool = False

    def look(self, there: bool, now_s: float) -> None:
        """Tell of a change since the last look, and once of an edge that does not come."""
        if self._since_s is None:
            self._since_s = now_s
        if there != self._there:
            self._there, self._told = there, True
            self.tell("the edge is there" if there else "the edge is away, waiting for it")
        elif not (there or self._told) and now_s - self._since_s >= self.alone_s:
            self._told = True
            self.tell(f"no edge of this site answers at {self.endpoint} yet, waiting for it")


def make_camera(
    node: NodeTable,
    folder: Path,
    transport: Transport,
    clock: Clock,
    tell: Callable[[str], None],
    meter: Callable[[Any], dict[str, Any]],
) -> CameraNode:
    """Return a camera, its network loaded and tried, not yet started.

    Args:
        node: its configuration.
        folder: to which its paths are relative.
        transport: how to reach the edge.
        clock: its own.
        tell: called with what a person should know.
        meter: the power fields of its heartbeats.

    Raises:
        InputError: when the source or the network cannot be used.
    """
    name = node.source
    kind, colon, rest = name.partition(":")
    if kind == RECORDED and not rest:
        raise InputError(f"source {name!r}: expected recorded:RECORDING, the folder of a recording")
    if kind == RECORDED and colon:
        name = f"{RECORDED}:{place(folder, rest)}"
    elif "://" not in name and kind not in ("usb", "gstreamer"):
        name = str(place(folder, name))
    source = make_source(name, node.camera, clock, node.fps, node.pace, node.begin_s)
    detector, joints = _detector(node, folder, source)
    settings = NodeSettings(
        site=node.site,
        camera_id=node.camera,
        joints=joints,
        wake_s=node.wake_s,
        detector=node.detector,
        battery_wh=node.battery_wh,
    )
    return CameraNode(settings, source, detector, transport, clock, meter, tell)


def _detector(node: NodeTable, folder: Path, source: Any) -> tuple[LiveDetector, tuple[str, ...]]:
    if node.source.startswith(f"{RECORDED}:"):
        return RecordedDetector(), source.recording.skeleton.joints
    import numpy as np

    from e3pose.detectors import make_detector

    model = None if node.model is None else place(folder, node.model)
    detector = make_detector(node.detector, model, node.provider, node.threads)
    detector.detect(np.zeros((480, 640, 3), dtype=np.uint8))  # the first look is slow: now, then
    return detector, detector.skeleton.joints
