"""The static layout of a site for the page: cameras, skeleton, room."""

from __future__ import annotations

from typing import Any

import numpy as np

from e3pose.report.scene import FRUSTUM_SHARE, bounds, frustum, millimetres, neck
from e3pose.settings.live import LiveSite


def describe(live: LiveSite) -> dict[str, Any]:
    """Return a site as lists, numbers and strings; lengths of the drawing in millimetres.

    Args:
        live: the site with its rig.
    """
    low, high = bounds(live.rig, [])
    low[2] = min(low[2], 0.0)
    size_m = FRUSTUM_SHARE * float((high - low).max())
    return {
        "site": live.site.name,
        "fps": live.site.fps,
        "slots_per_s": live.site.fps * live.site.pace,
        "skeleton": live.skeleton.name,
        "joints": list(live.skeleton.joints),
        "limbs": [list(limb) for limb in live.skeleton.limbs],
        "neck": neck(live.skeleton),
        "cameras": list(live.rig.camera_ids),
        "centers_m": np.round(live.rig.centers_m, 4).tolist(),
        "frustums": [millimetres(frustum(camera, size_m)) for camera in live.rig.cameras],
        "low": millimetres(low),
        "high": millimetres(high),
        "floor": 0,
        "zones": [{"name": z.name, "corners": z.corners} for z in live.site.zone],
    }
