"""What must be true of feet that were followed and stored: where they are, and what is exported."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import ezc3d
import numpy as np
from numpy.typing import NDArray
from tests.cli import commands

from e3pose.model.skeleton import load_skeleton
from e3pose.recording import load_recording
from e3pose.store import Store

CAMERAS = 3  # per slot
NEAR_M = 0.12  # of the median joint of a foot, from so many cameras


def in_whole_slots(store: Path) -> NDArray[np.bool_]:
    """Return `(num_rows,)`: stored poses of slots with views of `CAMERAS` cameras or more.

    On a busy machine cameras connect one after the other, and some views come too late.
    """
    rows = Store(store).rows("slots")
    whole = [row["slot"] for row in rows if row["arrived"].count("1") >= CAMERAS]
    return np.isin(Store(store).query().slots, whole)


def error_of_feet_m(store: Path, recording: Path, slots: NDArray[np.int64]) -> float:
    """Return the median error of the joints of feet, in slots with all views.

    Args:
        store: the database.
        recording: the folder that the cameras played, with its truth.
        slots: `(num_rows,)` of the recording, of each stored pose.
    """
    truth = load_recording(recording).truth
    assert truth is not None
    found = Store(store).query()
    assert found.joints == truth.skeleton.joints
    feet = [i for i, joint in enumerate(found.joints) if joint.endswith(("toe", "heel"))]
    whole = in_whole_slots(store)
    off = truth.joints_m[slots[whole]][:, :, feet] - found.people.joints_m[whole][:, None, feet]
    distance = np.linalg.norm(off, axis=-1)  # (num_rows, num_persons, 6)
    assert np.isfinite(distance).any(axis=1).mean() > 0.5
    followed = np.isfinite(distance).any(axis=(1, 2))  # who comes in has no feet yet
    return float(np.median(np.nanmin(np.nanmedian(distance[followed], axis=2), axis=1)))


def assert_feet_are_exported(store: Path) -> None:
    """Export a store to TRC, C3D and glTF beside it, and look for feet in each."""
    folder = store.parent
    for file in ("poses.trc", "poses.c3d", "poses.glb"):
        assert commands.run("export", store, folder / file) == 0
    trc = next(folder.glob("poses*.trc")).read_text()
    assert "left_heel" in trc
    points = ezc3d.c3d(str(next(folder.glob("poses*.c3d"))))["parameters"]["POINT"]["LABELS"]
    assert any("heel" in label.lower() for label in points["value"])
    data = next(folder.glob("poses*.glb")).read_bytes()
    (length,) = struct.unpack("<I", data[12:16])
    nodes = [node.get("name", "") for node in json.loads(data[20 : 20 + length])["nodes"]]
    assert any("left_big_toe" in node for node in nodes), nodes


def assert_feet_are_drawn(page: Path, skeleton: str) -> None:
    """Look for the limbs of the heels in a report."""
    feet = load_skeleton(skeleton)
    heels = {feet.index(f"{side}_heel") for side in ("left", "right")}
    limbs = [limb for limb in feet.limbs if set(limb) & heels]
    text = page.read_text().replace(" ", "")
    assert limbs and all(f"[{a},{b}]" in text for a, b in limbs)
