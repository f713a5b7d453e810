"""The static layout of a site for the page: cameras, skeleton, room."""

from __future__ import annotations

from typing import Any

import numpy as np

from e3pose.output.report.scene import FRUSTUM_SHARE, bounds, frustum, millimetres, neck
from e3pose.settings.resolved import ResolvedSite


def describe(site: ResolvedSite) -> dict[str, Any]:
    """Return a site as lists, numbers and strings; lengths of the drawing in millimetres.

    Args:
        site: what its file says.
    """
    low, high = bounds(site.rig, [])
    low[2] = min(low[2], 0.0)
    size_m = FRUSTUM_SHARE * float((high - low).max())
    return {
        "site": site.file.name,
        "fps": site.file.fps,
        "slots_per_s": site.file.fps * site.file.pace,
        "skeleton": site.skeleton.name,
        "joints": list(site.skeleton.joints),
        "limbs": [list(limb) for limb in site.skeleton.limbs],
        "neck": neck(site.skeleton),
        "cameras": list(site.rig.camera_ids),
        "centers_m": np.round(site.rig.centers_m, 4).tolist(),
        "frustums": [millimetres(frustum(camera, size_m)) for camera in site.rig.cameras],
        "low": millimetres(low),
        "high": millimetres(high),
        "floor": 0,
        "battery_wh": list(site.plan.battery_wh),
        "tells": site.file.events is not None,
        "zones": [{"name": z.name, "corners": z.corners} for z in site.file.zone],
    }
