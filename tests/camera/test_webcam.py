"""Webcams: the name decides, what the device gives is said, errors name what to do."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Iterator
from pathlib import Path

import av
import pytest
from tests.camera.stand_ins import Webcams, film
from tests.memory_transport import Hub
from tests.waiting import eventually

from e3pose.base.clock import WallClock
from e3pose.base.errors import InputError
from e3pose.camera import live, webcam
from e3pose.camera.base import LiveFrame, NodeSettings
from e3pose.camera.live import CameraNode
from e3pose.camera.live_source import make_source
from e3pose.camera.webcam import (
    WebcamSource,
    check_name,
    crowded_hubs,
    device_of,
    find_devices,
    lasting,
)

FRONT, BACK = "by-id/usb-Acme_Front_A1-video-index0", "by-id/usb-Acme_Back_B2-video-index0"


@pytest.fixture
def webcams(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Webcams:
    machine = Webcams(tmp_path)
    monkeypatch.setattr(av, "open", machine.open)
    return machine


def source(webcams: Webcams, name: str, fps: float = 30.0) -> WebcamSource:
    return WebcamSource(name, WallClock(), fps, (64, 48), webcams.dev)


def plug_two(webcams: Webcams, front: int, back: int) -> None:
    webcams.plug(front, "Front", FRONT.partition("/")[2], "1-1")
    webcams.plug(back, "Back", BACK.partition("/")[2], "1-2")


def frames(made: WebcamSource, count: int) -> list[LiveFrame]:
    found = [made.read() for _ in range(count)]
    return [frame for frame in found if frame is not None]


def test_the_name_decides_after_a_swap_at_boot_and_where_it_is_missing(
    tmp_path: Path, webcams: Webcams
) -> None:
    webcams.plug(2, "Back", BACK.partition("/")[2], "1-2")
    with pytest.raises(InputError, match=r"Front_A1-video-index0, expected it plugged in"):
        source(webcams, FRONT).open()
    assert not webcams.opened
    webcams.plug(0, "Front", FRONT.partition("/")[2], "1-1")
    source(webcams, FRONT).open()
    again = Webcams(tmp_path / "after the boot", webcams.opened)
    plug_two(again, 2, 0)
    source(again, FRONT).open()
    assert [Path(place).name for place, _ in webcams.opened] == ["video0", "video2"]
    assert device_of(FRONT, again.dev).name == "video2"
    assert device_of("0", again.dev).name == "video0"  # a number is a number


def test_names_of_linux() -> None:
    for name in ("0", "12", FRONT, "by-path/pci-0000:00:14.0-usb-0:2:1.0"):
        check_name(name)
    for name in ("front", "-1", "1000", "by-id/../../etc", "", "by-name/x"):
        with pytest.raises(InputError, match="expected usb:by-id/NAME"):
            make_source(f"usb:{name}", "cam0", WallClock())


def test_webcams_are_listed_by_names_that_stay(webcams: Webcams) -> None:
    assert find_devices(webcams.dev, webcams.sys) == {}
    plug_two(webcams, 2, 0)
    (webcams.sys / "class/video4linux/video7").mkdir()  # without a name: it was just unplugged
    found = find_devices(webcams.dev, webcams.sys)
    assert found == {f"usb:{BACK}": "Back", f"usb:{FRONT}": "Front"}
    assert lasting("usb:2", webcams.dev, webcams.sys) == f"usb:{FRONT}"
    assert lasting("usb:5", webcams.dev, webcams.sys) == "usb:5"
    assert lasting("walk.mp4", webcams.dev, webcams.sys) == "walk.mp4"


def test_two_of_a_model_without_serial_number_are_named_by_their_ports(webcams: Webcams) -> None:
    webcams.plug(0, "Twin", "usb-Twin-video-index0", "1-1")
    webcams.plug(2, "Twin", "usb-Twin-video-index0", "1-2")  # its link replaces the other's
    webcams.plug(4, "Old", "", "1-3")
    (webcams.dev / "v4l/by-path/pci-usb-0:1-3:1.0-video-index0").unlink()
    assert list(find_devices(webcams.dev, webcams.sys)) == [
        "usb:by-path/pci-usb-0:1-1:1.0-video-index0",
        "usb:by-path/pci-usb-0:1-2:1.0-video-index0",
        "usb:4",
    ]


def test_mjpg_is_asked_for_first_and_raw_pictures_where_there_is_none(webcams: Webcams) -> None:
    plug_two(webcams, 0, 2)
    made = source(webcams, FRONT)
    for without, kind in ((False, "mjpeg"), (True, "rawvideo")):
        webcams.without_mjpg = without
        made.open()
        assert made._stream.codec_context.name == kind
        frame = frames(made, 2)[0]
        image = frame.image()
        assert image.shape == (48, 64, 3) and abs(int(image[0, 0, 0]) - 40) < 4
        assert frame.mark is not None and frame.mark() == frame.mark()
        made.close()
    first, _, raw = [options for _, options in webcams.opened]
    assert first["input_format"] == "mjpeg" and "input_format" not in raw
    assert first["video_size"] == "64x48" and first["framerate"] == "30"


def test_what_the_device_gives_is_said_where_it_is_not_what_was_asked(webcams: Webcams) -> None:
    plug_two(webcams, 0, 2)
    made = source(webcams, FRONT)
    made.open()
    assert made.note == "" and made.fps == 30
    made.asked_size, made.asked_fps = (1920, 1080), 60.0
    made.open()
    assert made.note.endswith("gives MJPG 64x48 at 30 frames per second, asked for 1920x1080 at 60")


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (errno.EACCES, r"no permission to read .*/video0, expected membership of the group \w+: "),
        (errno.EBUSY, "in use by another program"),
        (errno.ENOSPC, "no bandwidth left on its USB hub, expected a smaller size or fps"),
        (errno.EIO, "Input/output error"),
    ],
)
def test_errors_of_a_device_say_what_to_do(webcams: Webcams, code: int, words: str) -> None:
    plug_two(webcams, 0, 2)
    webcams.refuses["video0"] = code
    with pytest.raises(InputError, match=words):
        source(webcams, FRONT).open()
    assert len(webcams.opened) == (2 if code == errno.EIO else 1), "another format changes nothing"


def test_a_frame_has_the_time_of_the_kernel(webcams: Webcams) -> None:
    plug_two(webcams, 0, 2)
    made = source(webcams, FRONT)
    made.open()

    class Packet:
        """Of 0.2 s ago, by the kernel's clock."""

        time_base = 1e-6
        pts = round(time.monotonic() * 1e6 - 200_000)

    age_s = (made.clock.now_ns() - made._frame(Packet()).captured_ns) / 1e9
    assert 0.19 < age_s < 0.3
    Packet.pts = 0  # of another clock: the time of its arrival
    assert (made.clock.now_ns() - made._frame(Packet()).captured_ns) / 1e9 < 0.1


def test_a_damaged_picture_is_black_and_the_next_one_is_shown(
    tmp_path: Path, webcams: Webcams
) -> None:
    plug_two(webcams, 0, 2)
    data = bytearray(film(tmp_path / "mjpg.avi").read_bytes())
    at = data.index(b"\xff\xd8")
    end = data.index(b"\xff\xd9", at)
    data[at:end] = bytes(end - at)
    (tmp_path / "mjpg.avi").write_bytes(data)
    made = source(webcams, FRONT)
    made.open()
    first, second, *_ = frames(made, 6)
    assert first.image().max() == 0 and second.image().min() > 0


def test_a_webcam_that_hangs_stops_no_thread(
    webcams: Webcams, monkeypatch: pytest.MonkeyPatch
) -> None:
    plug_two(webcams, 0, 2)
    made = source(webcams, FRONT)
    made.open()

    def never(_stream: object) -> Iterator[object]:
        raise av.error.BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN), "")

    monkeypatch.setattr(made._container, "demux", never)
    begun_s = time.monotonic()
    assert made.read() is None and 0.9 < time.monotonic() - begun_s < 2


def test_a_webcam_is_found_again_when_it_is_plugged_in(
    webcams: Webcams, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "REOPEN_S", 0.02)
    plug_two(webcams, 0, 2)
    webcams.unplugged_after = 4
    messages: list[str] = []
    settings = NodeSettings("lab", "cam0", ())
    made = source(webcams, FRONT)
    hub = Hub()
    node = CameraNode(settings, made, None, hub.join(), WallClock(), report=messages.append)
    link = webcams.dev / "v4l" / FRONT
    with node:
        assert eventually(lambda: any("No such device" in line for line in messages))
        link.unlink()
        assert eventually(lambda: "expected it plugged in" in node.problem)
        webcams.unplugged_after = 10**9
        link.symlink_to(webcams.dev / "video2")  # it comes back under another number
        assert eventually(lambda: node.problem == "")
    assert messages[-1] == "frames from the source again"
    assert Path(webcams.opened[-1][0]).name == "video2"


def test_cameras_of_a_crowded_hub_are_named_before_they_are_opened(webcams: Webcams) -> None:
    for number in range(4):
        webcams.plug(2 * number, f"Cam {number}", f"usb-Cam_{number}-video-index0", f"1-2.{number}")
    webcams.plug(9, "Alone", "usb-Alone-video-index0", "1-3")
    webcams.plug(11, "Fast", "usb-Fast-video-index0", "1-2.9", mbit=5000)

    def crowds(size: tuple[int, int] | None) -> list[tuple[list[str], str]]:
        names = {f"c{n}": (f"usb:by-id/usb-Cam_{n}-video-index0", size, 30.0) for n in range(4)}
        more = {"alone": "Alone", "fast": "Fast"}
        names |= {i: (f"usb:by-id/usb-{n}-video-index0", size, 30.0) for i, n in more.items()}
        names["gone"], names["film"] = ("usb:77", size, 30.0), ("walk.mp4", size, 30.0)
        return list(crowded_hubs(names, webcams.dev, webcams.sys))

    assert crowds((640, 480)) == crowds(None) == []
    ((who, words),) = crowds((1920, 1080))
    assert who == ["c0", "c1", "c2", "c3"]
    # 4 x 3 bit x 1920 x 1080 x 30 Hz against 0.8 x 480 Mbit/s of USB 2.0
    assert "port 1-2: about 746 Mbit/s of MJPG, it carries 384: fps below 51%" in words


@pytest.mark.parametrize(
    ("system", "place"),
    [("avfoundation", "FaceTime HD Camera:none"), ("dshow", "video=FaceTime HD Camera")],
)
def test_macos_and_windows_take_the_names_of_their_systems(
    system: str, place: str, webcams: Webcams, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(webcam, "video_input", lambda: system)
    made = make_source("usb:FaceTime HD Camera", "cam0", WallClock(), None, size=(64, 48))
    made.open()
    assert [where for where, _ in webcams.opened] == [place]
    assert made.read() is not None
    assert lasting("usb:0") == "usb:0" and not list(crowded_hubs({"a": ("usb:0", None, None)}))
    with pytest.raises(InputError, match="expected usb:NAME"):
        make_source('usb:a"b', "cam0", WallClock())
