"""Ask the store of a site: yesterday's poses as arrays, a table and a picture.

Run: python examples/08_query.py STORE [START] [END]
such as `python examples/08_query.py lab.db -10min`; also while the site runs.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from e3pose import plot, query, to_frame


def main(store: str | Path, start: str | None = None, end: str | None = None) -> None:
    """Print how high everybody's head was, and draw the last slot."""
    take = query(store, start, end)
    joints_m, tracks, first = take.dense()  # (num_slots, num_tracks, num_joints, 3)
    print(f"slots {first} to {first + len(joints_m) - 1}, {len(tracks)} tracks")
    frame = to_frame(take)
    heads = frame[frame.joint == "nose"].groupby("track").z.median()
    for track, height_m in heads.items():
        print(f"track {track}: nose at {height_m:.2f} m")
    print(f"{np.isfinite(joints_m).all(axis=-1).mean():.0%} of the joints are known")
    plot(take).figure.savefig("slot.png")


if __name__ == "__main__":
    main(*sys.argv[1:])
