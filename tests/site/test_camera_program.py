"""A camera says that it waits for its edge, once, and when that comes and goes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from tests.memory_transport import Hub

from e3pose.base.clock import WallClock
from e3pose.camera.orientation import Turned
from e3pose.detectors.base import Image
from e3pose.detectors.drawn import Drawn
from e3pose.model.pose import Poses2D
from e3pose.settings.camera_file import load_node
from e3pose.site.camera_program import EdgeWatch, make_camera
from e3pose.wire.endpoint import read_endpoint


class Seeing(Drawn):
    """Keeps the `(height, width)` of what it is shown."""

    def __init__(self) -> None:
        super().__init__()
        self.shown: list[tuple[int, ...]] = []

    def detect(self, image: Image) -> Poses2D:
        self.shown.append(image.shape[:2])
        return super().detect(image)


def test_camera_on_its_side_detects_in_turned_images(tmp_path: Path) -> None:
    (tmp_path / "camera.toml").write_text(
        'format = "e3pose-camera"\nversion = 1\nsite = "lab"\ncamera = "cam1"\n'
        'source = "usb:0"\ndetector = "drawn"\nrotation = 90\n'
    )
    node, seeing = load_node(tmp_path / "camera.toml"), Seeing()
    image = np.zeros((240, 320, 3), dtype=np.uint8)
    made = make_camera(node, Hub().join(), WallClock(), print, lambda _: {}, seeing)
    assert made.detector is not None
    made.detector.detect(image)
    straight = replace(node, rotation=0)
    upright = make_camera(straight, Hub().join(), WallClock(), print, lambda _: {}, seeing).detector
    assert upright is not None
    upright.detect(image)
    assert seeing.shown == [(320, 240), (240, 320)]
    named = make_camera(node, Hub().join(), WallClock(), print, lambda _: {})
    assert isinstance(named.detector, Turned)


def test_camera_says_once_that_it_waits_and_when_its_edge_comes_and_goes() -> None:
    messages: list[str] = []
    watch = EdgeWatch(messages.append, read_endpoint("tcp/127.0.0.1:7447"), "cam1", alone_s=5.0)
    for now_s in (100.0, 102.0, 104.9):
        watch.update(False, False, now_s)
    assert not messages
    for now_s in (105.0, 106.0, 300.0):
        watch.update(False, False, now_s)
    assert len(messages) == 1 and "no answer from the edge at tcp/127.0.0.1:7447" in messages[0]
    watch.update(True, True, 301.0)
    watch.update(True, True, 302.0)
    watch.update(False, False, 303.0)
    assert messages[1:] == ["edge connected", "edge disconnected, reconnecting"]
    # Edge that is there at once is reported.
    messages = []
    watch = EdgeWatch(messages.append, read_endpoint("tcp/127.0.0.1:7447"), "cam1")
    watch.update(True, True, 0.0)
    watch.update(True, True, 100.0)
    assert messages == ["edge connected"]


def test_camera_that_the_edge_does_not_admit_says_what_to_do() -> None:
    messages: list[str] = []
    watch = EdgeWatch(messages.append, read_endpoint("tls/127.0.0.1:7447"), "cam1", alone_s=5.0)
    watch.update(True, True, 100.0)
    for now_s in (101.0, 102.0, 106.0, 107.0):
        watch.update(False, True, now_s)
    assert messages[:2] == ["edge connected", "edge disconnected, reconnecting"]
    assert len(messages) == 3
    assert "certificate revoked" in messages[2] and "e3pose keys add cam1" in messages[2]


def test_camera_whose_way_has_an_expired_certificate_says_so_and_looks_now_and_then() -> None:
    messages, looks = list[str](), list[str]()

    def expired() -> str:
        looks.append("")
        return "camera.pem: certificate expired" if len(looks) > 1 else ""

    endpoint = read_endpoint("tls/127.0.0.1:7447")
    watch = EdgeWatch(messages.append, endpoint, "cam1", alone_s=5.0, expired=expired)
    for now_s in range(100, 200):
        watch.update(False, False, float(now_s))
    assert [message[:20] for message in messages] == [
        "no answer from the e",
        "camera.pem: certific",
    ]
    assert len(looks) == 2
