"""What cameras send to their edge, byte by byte: no image, unless somebody asks for one."""

from __future__ import annotations

import socket
import subprocess
import threading
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from tests.camera.mjpeg import jpeg, network_camera
from tests.live.processes import COMPILE_S, e3pose
from tests.live.test_planted_secrets import EYES
from tests.ports import free_port
from tests.rigs import looking
from tests.waiting import eventually

from e3pose.model.camera import Rig
from e3pose.recording.calibration import save_rig
from e3pose.settings.site_file import load_site
from e3pose.site.follow import Follower, viewer_link
from e3pose.wire.codec import encode
from e3pose.wire.network import open_network
from e3pose.wire.site_messages import PictureQuestion
from e3pose.wire.topics import of_camera

SITE = """
format = "e3pose-site"
version = 1
name = "lab"
calibration = "calib.toml"
skeleton = "coco17"
fps = 12.5
[link]
endpoint = "tcp/127.0.0.1:{port}"
[loop]
cameras = 2
predictor = "zero-velocity"
"""
JPEG = b"\xff\xd8\xff"


class Tap:
    """Carries connections to a port, and keeps what clients send."""

    def __init__(self, port: int) -> None:
        self.taken, self._port = bytearray(), port
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port, self._open = self._listening.getsockname()[1], [self._listening]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._listening.accept()
                self._open.append(client)
                try:
                    edge = socket.create_connection(("127.0.0.1", self._port))
                except OSError:  # it does not listen yet
                    client.close()
                    continue
                self._open.append(edge)
                for ends in ((client, edge, True), (edge, client, False)):
                    threading.Thread(target=self._carry, args=ends, daemon=True).start()

    def _carry(self, source: socket.socket, to: socket.socket, kept: bool) -> None:
        with suppress(OSError):
            while part := source.recv(65536):
                if kept:
                    self.taken += part
                to.sendall(part)
            to.shutdown(socket.SHUT_WR)

    def close(self) -> None:
        for each in self._open:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()


def test_cameras_send_no_image_unless_somebody_asks(tmp_path: Path) -> None:
    (tmp_path / "eyes.py").write_text(EYES)
    K = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    eyes = (replace(each, image_size=(64, 48), K=K) for each in looking((4, 0), (0, 4)).cameras)
    rig = Rig(tuple(eyes))
    save_rig(rig, tmp_path / "calib.toml")
    port = free_port()
    (tmp_path / "site.toml").write_text(SITE.format(port=port))
    site, follower = load_site(tmp_path), Follower("lab")
    with ExitStack() as stack:
        tap = Tap(port)
        stack.callback(tap.close)

        def start(*words: str) -> None:
            log = stack.enter_context((tmp_path / "log").open("ab"))
            program = subprocess.Popen(e3pose(*words), cwd=tmp_path, stdout=log, stderr=log)
            stack.callback(program.wait)
            stack.callback(program.kill)

        start("edge", "site.toml")
        transport = open_network(viewer_link(site, None, operates=True))
        stack.callback(transport.close)
        follower.listen(transport)
        url = stack.enter_context(network_camera(12.5))
        for camera_id in rig.camera_ids:
            start("camera", "--site", "lab", "--name", camera_id, "--source", url, "--endpoint",
                  f"tcp/127.0.0.1:{tap.port}", "--detector", "eyes.py:Eyes", "--meter", "model",
                  "--pictures")  # fmt: skip
        log = tmp_path / "log"
        flows = eventually(lambda: follower.status and follower.status.slot > 40, COMPILE_S)
        assert flows, log.read_text()[-2000:]
        sent = bytes(tap.taken)
        assert rig.camera_ids[0].encode() in sent, "the tap hears them"
        assert JPEG not in sent
        assert not any(jpeg(level)[-100:] in sent for level in (100, 140, 180))
        assert len(sent) < 40 * 2 * 64 * 48, "less than the images have pixels"
        topic = of_camera("lab", rig.camera_ids[0], "picture")
        asked = encode(PictureQuestion())
        assert eventually(lambda: transport.ask(topic, asked, 3.0))
        assert JPEG in tap.taken, "a picture that was asked for goes through the tap"
