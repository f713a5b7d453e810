"""Pictures of a camera: for who asks, small, few, and of real images only."""

from __future__ import annotations

import threading

import cv2
import numpy as np
import pytest
from tests.manual_clock import ManualClock
from tests.memory_transport import Hub
from tests.waiting import eventually

from e3pose.base.clock import WallClock
from e3pose.camera.base import LiveFrame
from e3pose.camera.live import CameraNode, NodeSettings, _Seen
from e3pose.camera.pictures import LARGE_WIDTH, PERIOD_NS, WIDTH, Pictures
from e3pose.model.pose import Poses2D
from e3pose.wire.codec import MAX_BYTES, decode, encode
from e3pose.wire.site_messages import Picture, PictureQuestion

IMAGE = np.zeros((480, 640, 3), dtype=np.uint8)
IMAGE[:, 320:] = (200, 40, 20)  # red on the right

SIZE = (640, 480)


def asked(pictures: Pictures, have_ns: int = 0, large: bool = False) -> Picture:
    answer = pictures.answer("", encode(PictureQuestion(have_ns, large)))
    assert answer is not None
    return decode(answer, Picture, "cam1")


def offer(pictures: Pictures, slot: int, image: object = IMAGE) -> None:
    pictures.offer(lambda: image, slot, 1000 + slot, SIZE)


def decoded(found: Picture) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(found.jpeg, np.uint8), cv2.IMREAD_COLOR)
    return np.asarray(image)[..., ::-1].astype(int)


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(10**18)


def test_last_image_is_shown_however_long_the_camera_sleeps(clock: ManualClock) -> None:
    pictures = Pictures("cam1", clock)
    none = asked(pictures)
    assert not none.jpeg and "no detection yet" in none.why
    offer(pictures, 1)
    offer(pictures, 2)
    clock.advance(600.0)
    found = asked(pictures)
    assert (found.slot, found.image_size, found.captured_edge_ns) == (2, SIZE, 1002)
    assert found.jpeg and not found.why and not found.drawn
    small = pictures.answer("", b"")  # a question without a message
    assert small is not None and decode(small, Picture, "cam1").jpeg == found.jpeg
    assert pictures.answer("", b"garbage") is None


def test_picture_that_the_operator_has_is_neither_made_nor_sent_again(clock: ManualClock) -> None:
    pictures = Pictures("cam1", clock)
    offer(pictures, 1)
    first = asked(pictures)
    clock.advance(10.0)
    again = asked(pictures, have_ns=first.captured_edge_ns)
    assert (again.jpeg, again.why, again.count) == (b"", "", 1)
    assert asked(pictures).jpeg == first.jpeg  # somebody else has none
    offer(pictures, 2)
    newer = asked(pictures, have_ns=first.captured_edge_ns)
    assert newer.jpeg and newer.slot == 2 and newer.count == 2


def test_picture_is_small_and_shows_what_the_camera_sees(clock: ManualClock) -> None:
    pictures = Pictures("cam1", clock)
    offer(pictures, 2, np.repeat(np.repeat(IMAGE, 3, axis=0), 3, axis=1))
    for large, width in ((False, WIDTH), (True, LARGE_WIDTH)):
        found = asked(pictures, large=large)
        assert len(found.jpeg) < 20_000 < MAX_BYTES and found.image_size == (1920, 1440)
        image, middle = decoded(found), width * 3 // 8
        assert image.shape == (width * 3 // 4, width, 3)
        assert image[middle, width // 4].max() < 10
        assert image[middle, width * 3 // 4] == pytest.approx([200, 40, 20], abs=9)


def test_at_most_five_a_second_are_made_and_their_energy_is_counted(clock: ManualClock) -> None:
    pictures = Pictures("cam1", clock)
    pictures.watts = 10.0
    counts = []
    for slot in range(25):
        offer(pictures, slot)
        found = asked(pictures)
        counts.append(found.count)
        clock.advance(PERIOD_NS / 5e9)
    assert counts[-1] == 5
    assert found.energy_j == 0  # the clock stands still meanwhile


def test_source_of_keypoints_is_drawn_and_any_other_shows_nothing(clock: ManualClock) -> None:
    pictures = Pictures("cam1", clock, limbs=((0, 1), (1, 2)))
    keypoints_px = np.array([[[100.0, 100], [500, 100], [500, 400]]])
    offer(pictures, 1, Poses2D(keypoints_px, np.array([[0.9, 0.9, 0.0]])))
    found = asked(pictures)
    image = decoded(found)
    assert found.drawn and found.image_size == SIZE and image.shape == (240, 320, 3)
    assert image[50, 150].max() < 160 < image[120, 20].min()  # the first limb, and the ground
    assert image[125, 250].min() > 200  # the third joint is missing
    offer(pictures, 2, "no image")
    clock.advance(1.0)
    assert "no images" in asked(pictures).why


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
        node._frames.put(_Seen(LiveFrame(0, (640, 480), lambda: IMAGE), 5, 0, 0, 10**8))
        answer = operator.ask("e3pose/lab/camera/cam1/picture", b"", 1.0)
        return answer is not None and decode(answer, Picture, "cam1").slot == 5

    with node:
        if allowed:
            assert eventually(seen)
        else:
            assert not any(seen() for _ in range(3))
