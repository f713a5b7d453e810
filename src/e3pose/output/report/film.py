"""Pictures of cameras for the page's player: what was filmed, with the skeletons drawn in."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.base.errors import InputError
from e3pose.camera.provenance import load_video_starts
from e3pose.model.blind_slot import duty
from e3pose.output.report.overlay.panels import overlay_images
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording

MOST_CAMERAS = 2  # those that looked most
MOST_IMAGES = 500  # of all cameras: some 8 MB of page
HEIGHT_PX, QUALITY = 270, 70  # of JPEG


def film(
    recording: Recording, shown: Sequence[SlotRecord], folder: Path | None
) -> dict[str, Any] | None:
    """Return pictures of the cameras that looked most; None where nothing was filmed.

    Args:
        recording: with videos or without.
        shown: the slots that the page shows, in order.
        folder: the recording's, for videos that stand in it; None of one that has none.

    Returns:
        `cameras`; `at`, for each picture the index of its slot among those shown; `jpeg`, for each
        camera its pictures as base64. Where videos cannot be read, `why` alone.
    """
    shares = duty(shown, len(recording.rig)) if shown else np.zeros(len(recording.rig))
    order = [recording.rig.camera_ids[index] for index in np.argsort(-shares, kind="stable")]
    chosen = [name for name in order if name in recording.videos][:MOST_CAMERAS]
    if not chosen or not shown:
        return None
    count = min(len(shown), MOST_IMAGES // len(chosen))
    at = np.unique(np.linspace(0, len(shown) - 1, count).round().astype(int)).tolist()
    try:
        pictures = [_pictures(recording, [shown[i] for i in at], folder, name) for name in chosen]
    except InputError as error:
        return {"why": str(error.elsewhere())}
    except ModuleNotFoundError as error:
        return {"why": f"{error.name} is not installed: pip install 'e3pose[camera]'"}
    return {"cameras": chosen, "at": at, "jpeg": pictures}


def _pictures(
    recording: Recording, slots: Sequence[SlotRecord], folder: Path | None, name: str
) -> list[str]:
    import cv2

    made, starts_s = [], {} if folder is None else load_video_starts(folder)
    for image in overlay_images(
        recording, slots, folder, HEIGHT_PX, video_starts_s=starts_s, cameras=[name]
    ):
        _, jpeg = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        made.append(base64.b64encode(jpeg.tobytes()).decode())
    return made
