"""A live site whose camera was turned: it says so, and the camera alone is placed anew."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.calibrate.people_scenes import knocked, walk
from tests.cli import commands
from tests.waiting import eventually

from e3pose.model.camera import Rig
from e3pose.model.rotations import angles_between
from e3pose.recording import save_recording
from e3pose.recording.calibration import load_rig
from e3pose.settings.site_file import load_site
from e3pose.site.example import Example, write_example
from e3pose.site.follow import Follower, viewer_link
from e3pose.wire.network import open_network

pytestmark = pytest.mark.nightly

COMPILE_S = 240.0  # what a machine that never ran this may take
NOTICE_S = 120.0


def angle(rig: Rig, other: Rig) -> float:
    """Return by how many degrees cam2 is turned between two rigs."""
    return float(np.degrees(angles_between(rig.cameras[2].R[None], other.cameras[2].R[None])[0]))


def test_turned_camera_is_reported_and_placed_anew_while_the_site_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "160")
    calm = walk(701, people=2, seconds=40.0)
    turned = knocked(calm, 2, 3.0, 701, 0.0)
    room = tmp_path / "room"
    save_recording(turned, room / "recording")
    sources = dict.fromkeys(calm.rig.camera_ids, "recorded:recording")
    example = Example(
        "room", sources, calm.fps, calm.skeleton.name, camera={"record": "keypoints"},
        cameras=3,  # of two, cam2 would have the same partner all the time, and needs two
        loop={"policy": "round-robin"},  # others would avoid cam2
    )  # fmt: skip
    site_file = write_example(room, example, calm.rig)
    program = subprocess.Popen(
        [sys.executable, "-m", "e3pose", "up", "room"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    follower = Follower("room")
    transport = open_network(viewer_link(load_site(site_file), None))
    try:
        follower.listen(transport)

        def noticed() -> bool:
            cameras = follower.status.cameras if follower.status else ()
            return any(camera.turned_deg is not None for camera in cameras)

        assert eventually(noticed, COMPILE_S + NOTICE_S), follower.status
        commands.run("top", "room", "--once")
        top = capsys.readouterr().out
        assert "cam2: has moved: turned by" in top, top
        assert "calibrate extrinsics SITE --only cam2" in top
        commands.run("check", "room")
        assert "has moved: turned by" in capsys.readouterr().out
        said, tried = "", 0

        def placed() -> bool:  # it may be noticed before enough is recorded
            nonlocal said, tried
            slot = follower.status.slot if follower.status else 0
            if slot < tried + 2 * calm.fps:
                return False
            tried = slot
            code = commands.run("calibrate", "extrinsics", "room", "--only", "cam2")
            said = "".join(capsys.readouterr())
            return code == 0

        assert eventually(placed, NOTICE_S), said
        assert "cam2: turned by" in said and "the previous file is" in said, said
    finally:
        transport.close()
        program.send_signal(signal.SIGINT)
        output = program.communicate(timeout=60)[0].decode()
    assert "Traceback" not in output
    found = load_rig(room / "rig.toml")
    before = load_rig(room / "rig.before.toml")
    assert angle(before, calm.rig) == pytest.approx(0.0, abs=1e-4)
    assert angle(found, calm.rig) == pytest.approx(3.0, abs=0.4)
