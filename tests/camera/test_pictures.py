"""Pictures of a camera: for who asks, small, few, and of real images only."""

from __future__ import annotations

import threading

import cv2
import numpy as np
import pytest
from tests.manual_clock import ManualClock
from tests.memory_transport import Hub
from tests.waiting import eventually

from e3pose.camera.base import LiveFrame
from e3pose.camera.live import CameraNode, NodeSettings, _Seen
from e3pose.camera.pictures import PERIOD_NS, WIDTH, Pictures
from e3pose.model.pose import Poses2D
from e3pose.runtime.clock import WallClock
from e3pose.wire.codec import MAX_BYTES, decode
from e3pose.wire.site_messages import Picture

IMAGE = np.zeros((480, 640, 3), dtype=np.uint8)
IMAGE[:, 320:] = (200, 40, 20)  # red on the right


def asked(pictures: Pictures) -> Picture | None:
    answer = pictures.answer("", b"")
    return None if answer is None else decode(answer, Picture, "cam1")


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(10**18)


def test_image_is_held_only_while_somebody_asks(clock: ManualClock) -> None:
    pictures = Pictures("cam1", clock)
    pictures.offer(IMAGE, 1)
    assert asked(pictures) is None  # nobody had asked when it came
    pictures.offer(IMAGE, 2)
    found = asked(pictures)
    assert found is not None and (found.slot, found.image_size) == (2, (640, 480))
    clock.advance(3.0)
    pictures.offer(IMAGE, 3)
    assert asked(pictures) is None


def test_picture_is_small_and_shows_what_the_camera_sees(clock: ManualClock) -> None:
    pictures = Pictures("cam1", clock)
    asked(pictures)
    pictures.offer(IMAGE, 2)
    found = asked(pictures)
    assert found is not None and len(found.jpeg) < 20_000 < MAX_BYTES
    image = np.asarray(cv2.imdecode(np.frombuffer(found.jpeg, np.uint8), cv2.IMREAD_COLOR))
    assert image.shape == (240, WIDTH, 3)
    assert image[120, 80].max() < 10 and image[120, 240, ::-1].astype(int) == pytest.approx(
        [200, 40, 20], abs=9
    )


def test_at_most_five_a_second_are_made_and_their_energy_is_counted(clock: ManualClock) -> None:
    pictures = Pictures("cam1", clock)
    pictures.watts = 10.0
    asked(pictures)
    counts = []
    for slot in range(25):
        pictures.offer(IMAGE, slot)
        found = asked(pictures)
        assert found is not None
        counts.append(found.count)
        clock.advance(PERIOD_NS / 5e9)
    assert counts[-1] == 5
    assert found is not None and found.energy_j == 0  # the clock stands still meanwhile


def test_what_a_simulated_source_shows_is_no_image(clock: ManualClock) -> None:
    pictures = Pictures("cam1", clock)
    asked(pictures)
    pictures.offer(Poses2D(np.zeros((0, 17, 2)), np.zeros((0, 17))), 1)
    assert asked(pictures) is None


class Blind:
    """A detector that finds nobody."""

    def detect(self, image: object) -> Poses2D:
        return Poses2D.empty(17)


class Still:
    """A source that never has a frame."""

    fps = 25.0

    def open(self) -> None:
        pass

    def read(self) -> LiveFrame | None:
        threading.Event().wait(0.02)
        return None

    def close(self) -> None:
        pass


@pytest.mark.parametrize("allowed", [True, False])
def test_camera_answers_only_where_it_is_allowed_to(allowed: bool) -> None:
    hub, clock = Hub(), WallClock()
    settings = NodeSettings("lab", "cam1", tuple(map(str, range(17))))
    pictures = Pictures("cam1", clock) if allowed else None
    node = CameraNode(settings, Still(), Blind(), hub.join(), clock, pictures=pictures)
    operator = hub.join()

    def seen() -> bool:
        node._frames.put(_Seen(LiveFrame(0, (640, 480), lambda: IMAGE), 5, 0))
        return operator.ask("e3pose/lab/camera/cam1/picture", b"", 1.0) is not None

    with node:
        if allowed:
            assert eventually(seen)
        else:
            assert not any(seen() for _ in range(3))
