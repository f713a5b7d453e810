"""A skeleton with feet and hands, live from end to end: edge, store, report, exports, stream, page.

The site is ended with SIGTERM; one of `test_programs.py` with Ctrl-C.
"""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest
from mcap.reader import make_reader
from tests.cli import commands
from tests.live.processes import e3pose, up
from tests.output.exports.feet import (
    NEAR_M,
    assert_feet_are_drawn,
    assert_feet_are_exported,
    error_of_feet_m,
    in_whole_slots,
)
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.base.errors import InputError
from e3pose.model.skeleton import load_skeleton
from e3pose.store import Store

pytestmark = pytest.mark.nightly

FPS, SKELETON = 20.0, "coco133"
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
SECONDS = 8


def test_feet_and_hands_are_followed_where_one_detector_knows_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The site takes what each camera has."""
    for folder, skeleton in (("feet", SKELETON), ("none", "coco17")):
        code = commands.run(
            "simulate", tmp_path / folder, "--people", "2", "--seconds", SECONDS, "--fps",
            f"{FPS:g}", "--cameras", "4", "--seed", "701", "--skeleton", skeleton,
        )  # fmt: skip
        assert code == 0, capsys.readouterr().err
    # Without a skeleton, a site takes the joints that all cameras have.
    content = SITE.format(fps=FPS, port=free_port()).replace(
        "[link]", f'skeleton = "{SKELETON}"\n[link]'
    )
    for camera in range(4):
        content += CAMERA.format(id=f"cam{camera}", source="none" if camera == 3 else "feet")
    site, store = tmp_path / "site.toml", tmp_path / "live.db"
    site.write_text(content)
    code, out = commands.run("check", site), capsys.readouterr().out
    said = " ".join(out.split())
    assert "camera cam3" in said and "coco17, converted, without" in said, out
    assert code == 0, out
    with up(site, signal.SIGTERM, "--quiet"):
        assert eventually(lambda: whole_poses(store) > 100), whole_poses(store)
        stream = e3pose("stream", str(site), f"mcap:{tmp_path}/live.mcap", "--for", "2")
        assert subprocess.run(stream, timeout=60, check=False).returncode == 0
        assert {"left_hand_root", "right_pinky4", "face_30"} <= streamed(tmp_path / "live.mcap")
        assert_the_page_has_every_joint(site)
    num_slots = round(SECONDS * FPS)  # of the recording, which is played in a loop
    slots = np.round(Store(store).query().time_ns % (SECONDS * 10**9) / 1e9 * FPS).astype(int)
    assert error_of_feet_m(store, tmp_path / "feet", slots % num_slots) < NEAR_M
    assert_feet_are_exported(store)
    page = tmp_path / "page.html"
    assert commands.run("export", site, page) == 0
    assert_feet_are_drawn(page, SKELETON)


def streamed(file: Path) -> set[str]:
    """Return the joints of people in a file of `stream`."""
    with file.open("rb") as opened:
        found = make_reader(opened).iter_messages(topics=["/poses"])
        slots = [json.loads(message.data) for _, _, message in found]
    return {joint for slot in slots for person in slot["people"] for joint in person["joints"]}


def assert_the_page_has_every_joint(site: Path) -> None:
    """Start a page, and ask it for the skeleton and for stored people."""
    listen, whole = f"127.0.0.1:{free_port()}", load_skeleton(SKELETON)

    def asked(path: str) -> Any:
        try:
            with urlopen(f"http://{listen}/api/{path}", timeout=10) as answer:
                return json.load(answer)
        except OSError:  # it begins
            return None

    with subprocess.Popen(e3pose("view", str(site), "--listen", listen)) as view:
        try:
            assert eventually(lambda: asked("site"))
            room = asked("site")
            assert tuple(room["joints"]) == whole.joints
            assert room["limbs"] == [list(limb) for limb in whole.limbs]
            people = [one for slot in asked("poses?start=-20s")["slots"] for one in slot["people"]]
            known = np.isfinite(np.array([one["joints_m"] for one in people], dtype=float))
            assert known.shape[1:] == (len(whole), 3) and known.any(axis=0).all()
        finally:
            view.terminate()


def whole_poses(store: Path) -> int:
    """Return how many poses are stored so far, of slots with enough views."""
    try:
        return int(in_whole_slots(store).sum())
    except InputError:  # it is being made
        return 0
