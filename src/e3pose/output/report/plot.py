"""Plot one slot of a take in a notebook."""

from __future__ import annotations

from typing import Any

import numpy as np

from e3pose.base.errors import InputError
from e3pose.model.take import Take


def plot(take: Take, slot: int | None = None, axes: Any = None) -> Any:
    """Draw the people of one slot in 3D with matplotlib; return its axes.

    Args:
        take: the people.
        slot: which slot; by default the last one with people.
        axes: 3D axes to draw on; new ones by default.

    Raises:
        InputError: when the slot has no people.
    """
    dense, tracks, first = take.dense()
    if slot is None and len(dense):
        there = np.flatnonzero(np.isfinite(dense).any(axis=(1, 2, 3)))
        slot = first + int(there[-1])
    if slot is None or not 0 <= slot - first < len(dense):
        last = first + max(len(dense) - 1, 0)
        raise InputError("slot", slot, f"{first} to {last}" if len(dense) else "a take with people")
    if axes is None:
        import matplotlib.pyplot as pyplot

        axes = pyplot.figure(figsize=(6, 6)).add_subplot(projection="3d")
    shown = dense[slot - first]
    for person, (track, joints_m) in enumerate(zip(tracks, shown, strict=True)):
        known = np.isfinite(joints_m).all(axis=-1)
        if not known.any():
            continue
        colour = f"C{person % 10}"
        axes.scatter(*joints_m[known].T, s=8, color=colour, label=f"person {track}")
        for a, b in take.skeleton.limbs:
            if known[a] and known[b]:
                axes.plot(*joints_m[[a, b]].T, color=colour)
    axes.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)", title=f"slot {slot}")
    axes.set_aspect("equal")
    if np.isfinite(shown).any():
        axes.legend(loc="upper left")
    return axes
