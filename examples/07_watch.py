"""Watch a running site: slots as arrays while they come, then a few seconds as a table.

Run: python examples/07_watch.py SITE
with the site file, or its folder, of a running site; `e3pose up try --example` starts one. From
another machine: `connect("tls/edge.local:7447", keys="FOLDER")`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from e3pose import connect, to_frame


def main(place: str | Path, seconds: float = 3.0) -> None:
    """Print who is where for a moment, then how fast each person moved."""
    with connect(place) as site:
        for slot in site:
            middles_m = np.nanmedian(slot.people.joints_m, axis=1)
            where = ", ".join(
                f"track {track} at ({x:.1f}, {y:.1f}) m"
                for track, (x, y, _) in zip(slot.people.track_ids, middles_m, strict=True)
            )
            print(f"slot {slot.slot}, cameras {' '.join(slot.arrived) or 'none'}: {where}")
            if len(slot):
                break
        take = site.take(seconds)
    joints_m, tracks, _ = take.dense()  # (num_slots, num_tracks, num_joints, 3)
    moved_m = np.linalg.norm(np.diff(joints_m, axis=0), axis=-1)
    for index, track in enumerate(tracks):
        known_m = moved_m[:, index][np.isfinite(moved_m[:, index])]
        speed_mps = known_m.mean() * take.fps if known_m.size else 0.0
        print(f"track {track}: joints move {speed_mps:.1f} m/s")
    print(to_frame(take).groupby("origin").size().to_string())


if __name__ == "__main__":
    main(sys.argv[1])
