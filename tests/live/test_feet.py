"""Skeletons with feet, live from end to end: edge, store, report and exports.

Their sites are ended with SIGTERM; one of `test_programs.py` with Ctrl-C.
"""

from __future__ import annotations

import json
import signal
import struct
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from tests.cli import commands
from tests.live.processes import up
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.model.skeleton import skeleton_by_name
from e3pose.recording import load_recording
from e3pose.store import Store

pytestmark = pytest.mark.live

FPS = 20.0
SITE = """
format = "e3pose-site"
version = 1
name = "lab"
calibration = "feet/calibration.toml"
fps = {fps}
[link]
endpoint = "tcp/127.0.0.1:{port}"
[store]
path = "live.db"
[loop]
policy = "round-robin"
cameras = 3
"""
CAMERA = """
[[camera]]
id = "{id}"
source = "recorded:{source}"
"""
NEAR_M = 0.12  # of the median joint of a foot, from three cameras per slot


@pytest.mark.parametrize(
    ("name", "fewer"), [("body25", ""), ("halpe26", "cam3")], ids=["body25", "mixed"]
)
def test_feet_are_followed_stored_and_exported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, fewer: str
) -> None:
    """In the mixed site, one camera's detector knows no feet, and the site takes what it has."""
    for folder, skeleton in (("feet", name), ("none", "coco17"))[: 2 if fewer else 1]:
        code = commands.run(
            "simulate", tmp_path / folder, "--people", "2", "--seconds", "8", "--fps",
            f"{FPS:g}", "--cameras", "4", "--seed", "701", "--skeleton", skeleton,
        )  # fmt: skip
        assert code == 0, capsys.readouterr().err
    content = SITE.format(fps=FPS, port=free_port())
    if fewer:  # without a word, a site takes the joints that all cameras have
        content = content.replace("[link]", f'skeleton = "{name}"\n[link]')
    for camera in range(4):
        source = "none" if f"cam{camera}" == fewer else "feet"
        content += CAMERA.format(id=f"cam{camera}", source=source)
    site, store = tmp_path / "site.toml", tmp_path / "live.db"
    site.write_text(content)
    if fewer:
        code, out = commands.run("check", site), capsys.readouterr().out
        said = " ".join(out.split())
        assert f"camera {fewer}" in said and "coco17, converted, without" in said, out
        assert code == 0, out
    with up(site, signal.SIGTERM, "--quiet"):
        assert eventually(lambda: stored(store) > 100), stored(store)
    assert error_m(tmp_path, name) < NEAR_M
    feet = skeleton_by_name(name)
    heels = {feet.index(f"{side}_heel") for side in ("left", "right")}
    exported(tmp_path, [limb for limb in feet.limbs if set(limb) & heels])


def stored(store: Path) -> int:
    """Return how many poses are stored so far."""
    try:
        return len(Store(store).query().time_ns)
    except Exception:  # it is being made
        return 0


def error_m(folder: Path, name: str) -> float:
    """Return the median error of the stored joints of feet."""
    truth = load_recording(folder / "feet").truth
    assert truth is not None
    found = Store(folder / "live.db").query()
    skeleton = skeleton_by_name(name)
    assert found.joints == skeleton.joints
    feet = [i for i, joint in enumerate(skeleton.joints) if joint.endswith(("toe", "heel"))]
    length_ns = round(len(truth.joints_m) / FPS * 1e9)
    slot = np.round(found.time_ns % length_ns / 1e9 * FPS).astype(int) % len(truth.joints_m)
    off = truth.joints_m[slot][:, :, feet] - found.joints_m[:, None, feet]
    distance = np.linalg.norm(off, axis=-1)  # (num_rows, num_persons, 6)
    assert np.isfinite(distance).any(axis=1).mean() > 0.5
    return float(np.nanmedian(np.nanmin(np.nanmedian(distance, axis=2), axis=1)))


def exported(folder: Path, foot_limbs: list[tuple[int, int]]) -> None:
    """Export the stored run to TRC, C3D and glTF, make its report, and look for feet in each."""
    assert foot_limbs
    for file in ("poses.trc", "poses.c3d", "poses.glb"):
        assert commands.run("export", folder / "live.db", folder / file) == 0
    trc = next(folder.glob("poses*.trc")).read_text()
    assert "left_heel" in trc or "LHeel" in trc
    points = ezc3d.c3d(str(next(folder.glob("poses*.c3d"))))["parameters"]["POINT"]["LABELS"]
    assert any("heel" in label.lower() for label in points["value"])
    data = next(folder.glob("poses*.glb")).read_bytes()
    (length,) = struct.unpack("<I", data[12:16])
    nodes = [node.get("name", "") for node in json.loads(data[20 : 20 + length])["nodes"]]
    assert any("left_big_toe" in node for node in nodes), nodes
    page = folder / "page.html"
    assert commands.run("report", folder / "site.toml", page) == 0
    assert all(f"[{a},{b}]" in page.read_text().replace(" ", "") for a, b in foot_limbs)
