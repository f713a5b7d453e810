"""Network cameras that bring half of the frames they announce: set up, checked, and run."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.camera.mjpeg import network_camera
from tests.cli.commands import run
from tests.live.processes import COMPILE_S
from tests.ports import free_port
from tests.rigs import looking
from tests.waiting import eventually

from e3pose.model.camera import Rig
from e3pose.recording.calibration import save_rig
from e3pose.settings.site_file import load_site
from e3pose.site.follow import Follower, viewer_link
from e3pose.wire.network import open_network

pytestmark = pytest.mark.nightly

TRUE_FPS = 12.5
EYES = """
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17

class Eyes:
    skeleton = COCO17

    def detect(self, image):
        return Poses2D.empty(17)
"""


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Two network cameras that announce 25 frames per second, and what `init` needs besides."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "eyes.py").write_text(EYES)
    K = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    rig = looking((4, 0), (0, 4))
    small = (replace(camera, image_size=(64, 48), K=K) for camera in rig.cameras)
    save_rig(Rig(tuple(small)), tmp_path / "calib.toml")
    with ExitStack() as stack:
        urls = [stack.enter_context(network_camera(TRUE_FPS)) for _ in range(2)]
        words = [f"c{index}={url}" for index, url in enumerate(urls)]
        yield [*words, "--detector", "eyes.py:Eyes", "--calibration", "calib.toml"]


@contextmanager
def running(site: Path) -> Iterator[Follower]:
    """Run a site by `e3pose up`, and follow it."""
    log = site / "up.log"
    follower = Follower("room")
    with log.open("wb") as output:
        up = subprocess.Popen(
            [sys.executable, "-m", "e3pose", "up", str(site)],
            stdout=output, stderr=subprocess.STDOUT,
        )  # fmt: skip
    transport = open_network(viewer_link(load_site(site), None))
    follower.listen(transport)
    try:
        yield follower
    finally:
        transport.close()
        up.send_signal(signal.SIGINT)
        up.wait(60)


def test_site_of_cameras_slower_than_they_announce(
    sources: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    room = Path("room").resolve()
    assert run("init", room, *sources) == 0
    said = capsys.readouterr()
    assert "64 x 48 at 12.5 frames per second (25 announced)" in said.out
    assert "camera c0: its source announces 25 frames per second and brings 12.5" in said.err
    made = load_site(room)
    assert made.fps == TRUE_FPS, "the rate that is, not the rate announced"

    text = (room / "site.toml").read_text().replace("fps = 12.5 ", "fps = 25 ", 1)
    text = text.replace(str(made.link.endpoint), f"tcp/127.0.0.1:{free_port()}")
    (room / "site.toml").write_text(text)
    assert run("check", room) == 1
    said = capsys.readouterr()
    found = " ".join(said.out.split())
    assert "its source brings 12.5 frames per second (25 announced), the site has fps = 25" in found
    assert "fps = 12.5 in the site file, or raise the camera's frame rate" in found
    assert "Not ready: 2 problems" in said.err

    with running(room) as follower:

        def told() -> bool:
            status = follower.status
            return status is not None and all(
                camera.why.startswith("its source brings 12") and (camera.delivered or 1) < 0.7
                for camera in status.cameras
            )

        assert eventually(told, COMPILE_S), follower.status
        status = follower.status
        assert status is not None
        assert all(abs((c.source_fps or 0) - TRUE_FPS) < 1.5 for c in status.cameras)
        blind = status.blind["views-missing"] + status.blind.get("views-late", 0)
        assert 0.25 < blind / status.slots < 0.75  # both film at the same moments
        assert 0.25 < status.blind_share < 0.75
        assert all(camera.duty > 0.9 for camera in status.cameras)  # they do not rest in these
        assert eventually(
            lambda: (
                follower.status is not None
                and any(
                    "c0: its source brings 12" in event and "set fps = 12" in event
                    for event in follower.status.events
                )
            )
        )
        assert run("check", room) == 0  # warnings, of the running site
        assert "slots blind" in " ".join(capsys.readouterr().out.split())
