"""Camera pictures with the skeletons of their moment, while a page shows them.

Cameras are asked only when a page asks, and however many pages do, each camera at most so often
a second. A picture arrives before the poses of its moment are published: the one before is shown
until they are.
"""

from __future__ import annotations

import base64
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, HTTPException, Query

from e3pose.base.errors import InputError
from e3pose.base.jpeg import jpeg_size
from e3pose.model.camera import Camera, Rig
from e3pose.site.connect import LiveSlot
from e3pose.site.web.control import Ask
from e3pose.site.web.feed import Feed
from e3pose.wire.codec import decode, encode
from e3pose.wire.site_messages import Picture, PictureQuestion

POSES_S = 2.0  # to wait for the poses of a picture's moment
AHEAD_S = 5.0  # that the clock of a camera may be ahead of the edge's
LARGE_S = 2.0  # large pictures are asked for so long after somebody wanted one


@dataclass(frozen=True, slots=True)
class PictureRules:
    """Rules for pictures: viewers, and the rate of requests to a camera.

    Attributes:
        shown: whether pictures can be shown at all.
        why: not, or what it takes; empty where nothing needs to be said.
        open: whether whoever may read sees them; otherwise it takes the write token.
        per_s: the most pictures a second that are requested from each camera.
    """

    shown: bool = False
    why: str = ""
    open: bool = False
    per_s: float = 2.0

    def for_scope(self, scope: str) -> dict[str, Any]:
        """Return whether a token's scope may see pictures, why not, and how often."""
        allowed = self.open or scope == "write"
        why = self.why if allowed or not self.shown else "Pictures need the write token."
        return {"shown": self.shown and allowed, "why": why, "per_s": self.per_s}


@dataclass(frozen=True, slots=True, eq=False)
class _Shown:
    """A picture with the slot of its moment; None where no slot was computed then."""

    picture: Picture
    large: bool
    slot: LiveSlot | None


@dataclass(eq=False)
class CameraPictures:
    """The newest picture of one camera; its methods may be called on any thread.

    Attributes:
        camera: its calibration.
        feed: has the poses of recent slots, and whether the camera is online.
        ask: asks the camera.
        interval_s: seconds per slot, by the clock on the wall.
        per_s: how often it is asked at most.
        now_s: a clock that only goes forward.
    """

    camera: Camera
    feed: Feed
    ask: Ask
    interval_s: float
    per_s: float
    now_s: Callable[[], float] = time.monotonic
    _shown: _Shown | None = None
    _coming: tuple[Picture, bool, float] | None = None  # picture, whether large, when it came
    _asked_s: float = -np.inf
    _large_s: float = -np.inf
    _why: str = ""
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def newest(self, have: str, large: bool) -> dict[str, Any]:
        """Return the newest picture as the API shows it.

        Args:
            have: `have` of the picture that the page has, whose image is left out.
            large: whether a large one is wanted.
        """
        if large:
            self._large_s = self.now_s()
        # Somebody else is asking: what is there is shown meanwhile.
        if self._lock.acquire(blocking=False):
            try:
                self._update()
            finally:
                self._lock.release()
        return self._body(have)

    def _update(self) -> None:
        now_s = self.now_s()
        if self._coming is None and now_s - self._asked_s >= 1 / self.per_s:
            self._asked_s = now_s
            self._request(now_s - self._large_s < LARGE_S)
        if self._coming is None:
            return
        picture, large, came_s = self._coming
        slot, newest = self.feed.slot_at(picture.captured_edge_ns), self.feed.slot
        published = newest is not None and newest.time_ns >= picture.captured_edge_ns
        if not published and self.now_s() - came_s < POSES_S:
            return
        apart_ns = np.inf if slot is None else abs(slot.time_ns - picture.captured_edge_ns)
        near = apart_ns <= 1e9 * self.interval_s
        self._shown, self._coming = _Shown(picture, large, slot if near else None), None

    def _request(self, large: bool) -> None:
        shown = self._shown
        had = shown is not None and (shown.large or not large)
        have_ns = shown.picture.captured_edge_ns if shown is not None and had else 0
        answer = self.ask(encode(PictureQuestion(have_ns, large)))
        if answer is None:
            self._why = self._silent()
            return
        try:
            found = decode(answer, Picture, self.camera.camera_id)
            self._check(found)
        except InputError as error:
            self._why = str(error)
            return
        self._why = found.why
        if found.jpeg:
            self._coming = found, large, self.now_s()

    def _check(self, found: Picture) -> None:
        """Refuse a picture that no honest camera sends, before a browser decodes it."""
        camera_id, edge_ns = self.camera.camera_id, self.feed.edge_ns()
        if found.camera_id != camera_id:
            raise InputError(f"{camera_id}: picture: found one of {found.camera_id}")
        if not found.jpeg:
            return
        try:
            jpeg_size(found.jpeg)
        except InputError as error:
            raise InputError(f"{camera_id}: {error}") from None
        ahead_s = 0.0 if edge_ns is None else (found.captured_edge_ns - edge_ns) / 1e9
        if ahead_s > AHEAD_S:
            raise InputError(f"{camera_id}: picture: found one of {ahead_s:.0f} s from now")

    def _silent(self) -> str:
        """Return why a camera does not answer."""
        if not self.feed.there() or self.feed.status is None:
            return "edge gone"
        for camera in self.feed.status.cameras:
            if camera.camera_id == self.camera.camera_id and not camera.online:
                return f"offline: {camera.why}" if camera.why else "offline"
        return "no answer: does the camera file have pictures = true?"

    def _body(self, have: str) -> dict[str, Any]:
        shown, edge_ns = self._shown, self.feed.edge_ns()
        body: dict[str, Any] = {"camera": self.camera.camera_id, "why": self._why, "jpeg": None}
        if shown is None:
            return {**body, "have": "", "captured_ns": None}
        picture, slot = shown.picture, shown.slot
        captured_ns = picture.captured_edge_ns
        here = f"{captured_ns}{'-large' if shown.large else ''}"
        if here != have:
            body["jpeg"] = base64.b64encode(picture.jpeg).decode()
        return {
            **body,
            "have": here,
            "captured_ns": captured_ns,
            "age_s": None if edge_ns is None else max(edge_ns - captured_ns, 0) / 1e9,
            "size": picture.image_size,
            "drawn": picture.drawn,
            "slot": None if slot is None else slot.slot,
            "apart_ms": None if slot is None else (slot.time_ns - captured_ns) / 1e6,
            "people": [] if slot is None else reprojected(slot, self.camera),
            "count": picture.count,
            "energy_j": picture.energy_j,
        }


def make_pictures(
    rig: Rig, feed: Feed, asks: Mapping[str, Ask], interval_s: float, per_s: float
) -> APIRouter:
    """Return the route of pictures.

    Args:
        rig: the cameras.
        feed: has the poses of recent slots.
        asks: camera to what asks it for a picture.
        interval_s: seconds per slot, by the clock on the wall.
        per_s: the most pictures a second that are requested from each camera.
    """
    pictures = APIRouter(prefix="/api/pictures")
    cameras = {
        camera.camera_id: CameraPictures(camera, feed, asks[camera.camera_id], interval_s, per_s)
        for camera in rig.cameras
    }

    @pictures.get("/{camera_id}", summary="The newest picture that a camera detected in")
    def picture(
        camera_id: str, have: Annotated[str, Query(max_length=40)] = "", large: bool = False
    ) -> dict[str, Any]:
        if camera_id not in cameras:
            raise HTTPException(404, f"no camera {camera_id[:60]!r}")
        return cameras[camera_id].newest(have, large)

    return pictures


def reprojected(slot: LiveSlot, camera: Camera) -> list[dict[str, Any]]:
    """Return people as a camera sees them: track, joints in pixels with None where unknown, and
    which of them a view of the slot measured."""
    pixels = camera.project(slot.people.joints_m.astype(np.float64)).round(1)
    masked = pixels.astype(object)
    masked[~np.isfinite(pixels)] = None
    ids, measured = slot.people.track_ids.tolist(), slot.people.measured.tolist()
    rows = zip(ids, masked.tolist(), measured, strict=True)
    return [
        {"track": track, "joints_px": joints, "measured": measured}
        for track, joints, measured in rows
    ]
