"""Raspberry Pi, OAK and GStreamer by stand-ins: what is asked of them, and what becomes of it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from tests.camera import stand_ins
from tests.cases import each_case

from e3pose.base.clock import WallClock
from e3pose.base.errors import InputError
from e3pose.camera import picamera
from e3pose.camera.live_source import make_source
from e3pose.camera.picamera import MAP_PX, SENSOR_PX, SensorSource, people_of
from e3pose.model.expected import ExpectedView


def outputs(people: list[tuple[float, int, int]]) -> list[np.ndarray]:
    """Return what the network gives of people: their tag, and where all their joints are."""
    tags, places, scores = (np.zeros((30, 17)) for _ in range(3))
    for row, (tag, x, y) in enumerate(people):
        # Each joint's list has its own order, best first.
        rows = (row + np.arange(17)) % len(people)
        tags[rows, np.arange(17)] = tag + 0.1 * np.arange(17) / 17
        places[rows, np.arange(17)] = y * MAP_PX[0] + x
        scores[rows, np.arange(17)] = 0.8 - 0.1 * row
    return [tags, places, scores]


@pytest.fixture
def board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> stand_ins.Board:
    monkeypatch.setattr(picamera, "MODEL", tmp_path / "network.rpk")
    monkeypatch.setattr(SensorSource, "model", tmp_path / "network.rpk")
    (tmp_path / "network.rpk").touch()
    return stand_ins.raspberry_pi(monkeypatch)


def sensor(tmp_path: Path) -> SensorSource:
    made = make_source("imx500:0", "cam0", WallClock())
    assert isinstance(made, SensorSource)
    made.model = tmp_path / "network.rpk"
    made.open()
    return made


def test_keypoints_are_grouped_by_their_tags() -> None:
    found = [(0.0, 20, 30), (5.0, 90, 100), (9.0, 21, 31)]
    keypoints, scores = people_of(*outputs(found))
    assert keypoints.shape == (3, 17, 2) and (scores > 0).all()
    places = sorted((keypoints[:, 0] * MAP_PX - 0.5).round().astype(int).tolist())
    assert places == [[20, 30], [21, 31], [90, 100]]
    for person in keypoints:  # nobody has a joint of somebody else
        assert np.ptp(person, axis=0).max() == 0


def test_somebody_whose_head_is_hidden_is_not_joined_to_another_head() -> None:
    tags, places, scores = outputs([(0.0, 20, 30)])
    tags[0, 5:] += 8.0  # the joints from the shoulders on are somebody else's
    keypoints, sure = people_of(tags, places, scores)
    assert [int(count) for count in (sure > 0).sum(axis=1)] == [5, 12]
    assert np.isnan(keypoints[0, 5:]).all()


def test_keypoints_that_are_unsure_or_alone_are_nobody() -> None:
    tags, places, scores = outputs([(0.0, 20, 30)])
    scores[:, 3:] = 0.2
    assert len(people_of(tags, places, scores)[0]) == 1
    scores[:, 2:] = 0.2
    assert len(people_of(tags, places, scores)[0]) == 0


def test_poses_are_pixels_of_the_image(tmp_path: Path, board: stand_ins.Board) -> None:
    board.outputs = outputs([(0.0, 96, 72)])  # the middle of the network's map
    made = sensor(tmp_path)
    frames = [frame for frame in (made.read() for _ in range(8)) if frame is not None]
    assert len(frames) == 8 - picamera.SETTLING, "those of the region before are left out"
    assert frames[0].poses is not None
    poses = frames[0].poses()
    # Half a cell of the map right of and below the middle, from pixel centres.
    assert poses.keypoints_px[0, 0] == pytest.approx((320 + 640 / 384 - 0.5, 240 + 480 / 288 - 0.5))
    board.crop = (1014, 760, 2028, 1520)  # the middle half of the sensor: the image shows it twice
    zoomed = made.read()
    assert zoomed is not None and zoomed.poses is not None
    middle = np.array((320, 240)) - 0.5
    apart = (zoomed.poses().keypoints_px[0, 0] - middle) / (poses.keypoints_px[0, 0] - middle)
    assert apart == pytest.approx((2, 2))


def test_poses_stay_where_the_region_goes(tmp_path: Path, board: stand_ins.Board) -> None:
    made = sensor(tmp_path)
    points = np.full((1, 17, 2), np.nan)
    points[0, :2] = [(160, 120), (224, 216)]
    made.expect(ExpectedView(points, np.ones(1)))
    left, top, width, height = board.regions[-1]
    assert width / SENSOR_PX[0] == pytest.approx(height / SENSOR_PX[1], abs=1e-3)
    assert left <= 160 / 640 * 4056 and left + width >= 224 / 640 * 4056
    assert top <= 120 / 480 * 3040 and top + height >= 216 / 480 * 3040
    # A keypoint at a place of the image, as the network sees it in that region.
    x = ((200 + 0.5) / 640 * 4056 - left) / width * MAP_PX[0]
    y = ((150 + 0.5) / 480 * 3040 - top) / height * MAP_PX[1]
    board.outputs = outputs([(0.0, int(x), int(y))])
    frame = next(frame for frame in iter(made.read, 0) if frame is not None)
    assert frame.poses is not None
    cell_px = width / MAP_PX[0] / 4056 * 640
    assert frame.poses().keypoints_px[0, 0] == pytest.approx((200, 150), abs=cell_px)
    count = len(board.regions)
    for changed in (points + 8, points[:, :1] + 40):
        made.expect(ExpectedView(changed, np.ones(1)))
        assert len(board.regions) == count, "the region shows everybody, large enough"
    made.expect(ExpectedView(points + 200, np.ones(1)))
    assert len(board.regions) == count + 1 and board.regions[-1][0] > left
    for nobody in (None, ExpectedView(np.zeros((0, 17, 2)), np.zeros(0))):
        made.expect(ExpectedView(points, np.ones(1)))
        made.expect(nobody)
        assert board.regions[-1] == (0, 0, *SENSOR_PX)


def test_regions_lie_on_the_sensor_and_stay(tmp_path: Path, board: stand_ins.Board) -> None:
    made, rng, nan = sensor(tmp_path), np.random.default_rng(0), np.nan
    for place in ((610, 240), (320, 450), (20, 240), (0, 0), (639, 479), (nan, nan)):
        for reach_px in (80, 600):
            body = rng.uniform(-reach_px, reach_px, (1, 17, 2)) + place
            count = len(board.regions)
            for _ in range(100):  # somebody who moves a little
                made.expect(ExpectedView(body + rng.normal(0, 1, 2), np.ones(1)))
                left, top, width, height = board.regions[-1]
                assert left >= 0 and top >= 0 and width > 0 and height > 0
                assert left + width <= SENSOR_PX[0] and top + height <= SENSOR_PX[1]
            assert len(board.regions) <= count + 3, place


def test_frames_go_back_to_libcamera(board: stand_ins.Board) -> None:
    made = make_source("picamera2:0?sync=client", "cam0", WallClock(), 25.0, size=(320, 240))
    made.open()
    kept = made.read()
    for _ in range(20):
        frame = made.read()
    assert kept is not None and frame is not None and kept.image() is kept.image()
    del kept, frame
    made.close()
    assert board.held == 0
    (asked,) = board.asked
    assert asked["main"]["size"] == (320, 240)
    assert asked["controls"] == {"FrameRate": 25.0, "SyncMode": 2}


def test_an_oak_detects_with_its_own_network(monkeypatch: pytest.MonkeyPatch) -> None:
    found = stand_ins.oak(monkeypatch)
    found.people = [stand_ins.person(0.5, 0.25)]
    made = make_source("depthai:14442C10?model=someone/pose", "cam0", WallClock(), 12.0)
    made.open()
    assert found.asked == [("someone/pose", {"fps": 12.0, "resizeMode": "stretch"})]
    frame = made.read()
    assert frame is not None and frame.poses is not None
    assert frame.poses().keypoints_px[0, 5] == pytest.approx((31.5, 11.5))
    assert frame.image()[0, 0].tolist() == [1, 2, 3]  # red, green, blue, also where it is NV12
    assert 0.02 < (made.clock.now_ns() - frame.captured_ns) / 1e9 < 0.5  # type: ignore[attr-defined]
    found.people = [stand_ins.person(0.5, 0.25, joints=33)]
    wide = made.read()
    assert wide is not None and wide.poses is not None
    with pytest.raises(InputError, match="found 33 keypoints, expected 17"):
        wide.poses()
    found.unplugged = True
    with pytest.raises(InputError, match="Communication exception"):
        made.read()


def test_a_pipeline_has_our_sink_and_rows_without_padding(monkeypatch: pytest.MonkeyPatch) -> None:
    made = stand_ins.gstreamer(monkeypatch)
    for text in ("v4l2src", "v4l2src ! appsink", "v4l2src ! videoconvert ! appsink drop=1"):
        source = make_source(f"gstreamer:{text}", "cam0", WallClock())
        source.open()
        frame = source.read()
        assert frame is not None and source.fps == 30
        assert frame.image()[2].ravel().tolist() == list(range(63))
        source.close()
    assert len({*made}) == 1 and made[0].startswith("v4l2src ! videoconvert ! video/x-raw,")
    source = make_source("gstreamer:nothing", "cam0", WallClock())
    with pytest.raises(InputError, match='no element "nothing"'):
        source.open()
    stand_ins.gstreamer(monkeypatch, fails="Could not open resource")
    source = make_source("gstreamer:v4l2src", "cam0", WallClock())
    source.open()
    with pytest.raises(InputError, match="Could not open resource"):
        source.read()


@each_case(
    ("name", "words"),
    [
        ("picamera2:1", "no such camera, expected of: 0 \\(imx500\\)"),
        ("picamera2:front", "expected picamera2:0"),
        ("picamera2:0?sync=both", "sync=server"),
        ("imx500:1", "expected imx500:0"),
        ("depthai:other", "Cannot find any device .* there is: 14442C10"),
        ("depthai:x?net=a", "depthai:ID\\?model=NAME"),
    ],
)
def test_boards_say_what_is_wrong(name: str, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_ins.raspberry_pi(monkeypatch)
    stand_ins.oak(monkeypatch)
    with pytest.raises(InputError, match=words):
        make_source(name, "cam0", WallClock()).open()


@each_case(
    ("name", "module", "words"),
    [
        ("picamera2:0", "picamera2", "sudo apt install python3-picamera2"),
        ("imx500:0", "picamera2.devices", "sudo apt install python3-picamera2"),
        ("depthai:", "depthai", "pip install 'depthai"),
        ("gstreamer:videotestsrc", "gi", "sudo apt install python3-gi"),
    ],
)
def test_what_is_not_installed_is_named_with_its_command(
    name: str, module: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    source = make_source(name, "cam0", WallClock())
    if isinstance(source, SensorSource):
        with pytest.raises(InputError, match="sudo apt install imx500-all"):
            source.open()
        source.model = tmp_path
    with pytest.raises(InputError, match=words):
        source.open()
