"""A skeleton with feet, live from end to end: edge, store, report and exports.

The site is ended with SIGTERM; one of `test_programs.py` with Ctrl-C.
"""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pytest
from tests.cli import commands
from tests.live.processes import up
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
from e3pose.store import Store

pytestmark = pytest.mark.nightly

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
SECONDS = 8


def test_feet_are_followed_where_one_detector_knows_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The site takes what each camera has."""
    for folder, skeleton in (("feet", "halpe26"), ("none", "coco17")):
        code = commands.run(
            "simulate", tmp_path / folder, "--people", "2", "--seconds", SECONDS, "--fps",
            f"{FPS:g}", "--cameras", "4", "--seed", "701", "--skeleton", skeleton,
        )  # fmt: skip
        assert code == 0, capsys.readouterr().err
    # Without a skeleton, a site takes the joints that all cameras have.
    content = SITE.format(fps=FPS, port=free_port()).replace(
        "[link]", 'skeleton = "halpe26"\n[link]'
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
    num_slots = round(SECONDS * FPS)  # of the recording, which is played in a loop
    slots = np.round(Store(store).query().time_ns % (SECONDS * 10**9) / 1e9 * FPS).astype(int)
    assert error_of_feet_m(store, tmp_path / "feet", slots % num_slots) < NEAR_M
    assert_feet_are_exported(store)
    page = tmp_path / "page.html"
    assert commands.run("export", site, page) == 0
    assert_feet_are_drawn(page, "halpe26")


def whole_poses(store: Path) -> int:
    """Return how many poses are stored so far, of slots with enough views."""
    try:
        return int(in_whole_slots(store).sum())
    except InputError:  # it is being made
        return 0
