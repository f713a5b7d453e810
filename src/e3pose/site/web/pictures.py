"""Camera pictures with the skeletons of the same slot, while an operator watches."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from fastapi import APIRouter, HTTPException

from e3pose.errors import InputError
from e3pose.geometry.camera import Camera, Rig
from e3pose.site.connect import LiveSlot
from e3pose.site.web.control import Ask
from e3pose.site.web.feed import Feed
from e3pose.wire.codec import decode
from e3pose.wire.site_messages import Picture


def make_pictures(rig: Rig, feed: Feed, asks: dict[str, Ask]) -> APIRouter:
    """Return the route of pictures.

    Args:
        rig: the cameras.
        feed: has the poses of recent slots.
        asks: camera to what asks it for a picture.
    """
    pictures = APIRouter(prefix="/api/pictures")
    cameras = {camera.camera_id: camera for camera in rig.cameras}

    @pictures.get("/{camera_id}", summary="A small picture of what a camera detects in")
    def picture(camera_id: str) -> dict[str, Any]:
        if camera_id not in asks:
            raise HTTPException(404, f"no camera {camera_id[:60]!r}")
        answer = asks[camera_id](b"")
        if answer is None:
            raise HTTPException(
                404, "no picture: the camera was not active, shows no images, or allows none"
            )
        try:
            found = decode(answer, Picture, camera_id)
        except InputError as error:
            raise HTTPException(502, str(error)) from None
        slot = feed.recent.get(found.slot)
        return {
            "camera": camera_id,
            "slot": found.slot,
            "size": found.image_size,
            "jpeg": base64.b64encode(found.jpeg).decode(),
            "count": found.count,
            "energy_j": found.energy_j,
            "people": [] if slot is None else reprojected(slot, cameras[camera_id]),
        }

    return pictures


def reprojected(slot: LiveSlot, camera: Camera) -> list[dict[str, Any]]:
    """Return people as a camera sees them: track and joints in pixels, None where unknown."""
    pixels = camera.project(slot.joints_m.astype(np.float64)).round(1)
    masked = pixels.astype(object)
    masked[~np.isfinite(pixels)] = None
    return [
        {"track": track, "joints_px": joints}
        for track, joints in zip(slot.track_ids.tolist(), masked.tolist(), strict=True)
    ]
