"""Pictures that are decoded on demand are those that decoding everything gives, and never late."""

from __future__ import annotations

import gc
import itertools
import subprocess
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from fractions import Fraction
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from tests.cases import each_case
from tests.memory_transport import Hub

from e3pose.base.clock import SlotTimes, WallClock
from e3pose.camera import decoding
from e3pose.camera.base import LiveFrame, NodeSettings, OnDemandSource
from e3pose.camera.live import CameraNode, _Seen
from e3pose.camera.live_source import StreamSource, make_source
from e3pose.camera.pictures import Pictures
from e3pose.camera.schedule import Schedule
from e3pose.camera.source import VideoSource, open_video
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.wire.codec import decode
from e3pose.wire.site_messages import Picture

SIZE, FPS, COUNT = (64, 48), 25, 120
X264 = "libx264"
FORMS: dict[str, tuple[str, str, dict[str, str]]] = {
    "usual": (X264, ".mp4", {}),  # three B-frames, of which one is referred to
    "short groups": (X264, ".mkv", {"g": "12", "bf": "2"}),
    "open groups": (X264, ".mp4", {"g": "15", "x264-params": "open-gop=1"}),
    "no B-frames": (X264, ".ts", {"g": "25", "bf": "0"}),
    "all refer": (X264, ".mp4", {"g": "30", "refs": "4", "x264-params": "b-pyramid=strict"}),
    "H.265": ("libx265", ".mp4", {"x265-params": "keyint=20:log-level=none"}),
    "single": ("mjpeg", ".mov", {}),
}


def write(path: Path, codec: str, options: dict[str, str]) -> Path:
    """Write a film of noise that moves, so that a picture from wrong references differs."""
    noise = np.random.default_rng(0).integers(0, 256, (SIZE[1], SIZE[0] + COUNT, 3), dtype=np.uint8)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=FPS, options=options)
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        for number in range(COUNT):
            image = np.ascontiguousarray(noise[:, number : number + SIZE[0]])
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = number, Fraction(1, FPS)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def opened(path: Path) -> VideoSource:
    video = open_video(path)
    assert isinstance(video, VideoSource) and video.on_demand
    return video


def whole(video: VideoSource) -> dict[float, Any]:
    return {round(frame.time_s, 6): frame.image for frame in video.frames()}


def needs(seed: int) -> list[bool]:
    """Return which of the pictures are needed: stretches of each length, and single ones."""
    rng, wanted = np.random.default_rng(seed), list[bool]()
    while len(wanted) < COUNT:
        wanted += [False] * int(rng.integers(0, 40)) + [True] * int(rng.integers(1, 6))
    return wanted


@each_case("form", FORMS)
def test_needed_pictures_are_those_of_decoding_all(form: str, tmp_path: Path) -> None:
    codec, end, options = FORMS[form]
    video = opened(write(tmp_path / f"film{end}", codec, options))
    expected = whole(video)
    assert len(expected) == COUNT
    for seed, start_s in itertools.product(range(2), (0.0, 1.7)):
        decoded = shown = 0
        for wanted, (time_s, coded) in zip(needs(seed), video.coded(start_s), strict=False):
            shown, stream = shown + 1, coded.stream
            if wanted:
                assert np.array_equal(coded(), expected[round(time_s, 6)]), (seed, time_s)
            assert stream is not None
            stream.keep_up(0.2 if seed % 2 else 0.0, 1 / FPS)
            decoded = stream.decoded
        assert shown >= COUNT - 1 - start_s * FPS
        if form in ("short groups", "single") and seed % 2:
            assert decoded < 0.7 * shown


def test_pictures_that_are_renewed_bit_by_bit_are_right_or_none(tmp_path: Path) -> None:
    options = {"g": "20", "bf": "0", "x264-params": "intra-refresh=1"}
    video = opened(write(tmp_path / "film.mp4", X264, options))
    expected, missing = whole(video), 0
    for wanted, (time_s, coded) in zip(needs(3), video.coded(), strict=False):
        if wanted and coded.decode():
            assert np.array_equal(coded(), expected[round(time_s, 6)])
        missing += wanted and coded.picture is None
    assert missing <= 20, "after one jump that failed nothing is left out any more"


def test_damaged_pictures_are_none(tmp_path: Path) -> None:
    path = write(tmp_path / "film.ts", X264, {"g": "20", "bf": "0"})
    video = opened(path)
    expected, content = whole(video), bytearray(path.read_bytes())
    for at in range(len(content) // 3, len(content) // 2, 5 * 188):
        content[at + 40 : at + 90] = bytes(50)
    path.write_bytes(content)
    found = {round(time_s, 6): coded() for time_s, coded in video.coded() if coded.decode()}
    wrong = [at for at, image in found.items() if not np.array_equal(image, expected[at])]
    full = [f for f in video.frames() if not np.array_equal(f.image, expected[round(f.time_s, 6)])]
    assert len(wrong) <= len(full) and 40 < len(found) < COUNT


class Machine:
    """Decodes each packet in a time that is known."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, packet_s: float) -> None:
        self.now_s, self._decode = 0.0, decoding.decode_bounded
        self._packet_s = packet_s
        monkeypatch.setattr(decoding, "decode_bounded", self.decode)
        monkeypatch.setattr(decoding, "perf_counter", lambda: self.now_s)

    def decode(self, packet: Any) -> list[Any]:
        self.now_s += self._packet_s
        return self._decode(packet)


@each_case("packet_ms", [1, 4, 12, 30])
def test_no_picture_is_late_and_packets_are_left_out_where_time_allows(
    packet_ms: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Orders come 0.3 s ahead; a picture is there as soon as where all are decoded."""
    video = opened(write(tmp_path / "film.ts", X264, {"g": "25", "bf": "0"}))
    machine = Machine(monkeypatch, packet_ms / 1e3)
    for seed in range(2):
        wanted, late_s, stream = needs(seed), list[float](), None
        for number, (_, coded) in enumerate(video.coded()):
            due_s = number / FPS
            machine.now_s, stream = max(machine.now_s, due_s), coded.stream
            if wanted[number]:
                assert coded.decode()
                late_s.append(machine.now_s - due_s)
            ahead = wanted[number + 1 : number + 1 + round(0.3 * FPS)]
            free = (ahead.index(True) if True in ahead else len(ahead)) / FPS
            assert stream is not None
            stream.keep_up(free, 1 / FPS)
        assert stream is not None
        assert max(late_s[1:]) <= 3 * packet_ms / 1e3, seed
        assert stream.decoded < 0.9 * COUNT or packet_ms >= 12
        machine.now_s = 0.0


@contextmanager
def served(path: Path) -> Iterator[str]:
    """Serve a film as a network camera whose stream begins anew after its end; yield its URL."""

    class Camera(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(path.read_bytes())

        def log_message(self, format: str, *args: object) -> None: ...

    server = ThreadingHTTPServer(("127.0.0.1", 0), Camera)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/film.ts"
    server.shutdown()
    server.server_close()
    thread.join()


# GStreamer's server belongs to the Python of the system: `apt install gir1.2-gst-rtsp-server-1.0
# gstreamer1.0-plugins-good`.
SERVER = """
import sys, gi
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer
Gst.init(None)
server, factory = GstRtspServer.RTSPServer(), GstRtspServer.RTSPMediaFactory()
server.set_address("127.0.0.1")
server.set_service("0")
factory.set_launch(f"( filesrc location={sys.argv[1]} ! matroskademux ! rtph264pay name=pay0 )")
server.get_mount_points().add_factory("/film", factory)
server.attach(None)
print(server.get_bound_port(), flush=True)
GLib.MainLoop().run()
"""


@contextmanager
def served_by_rtsp(path: Path) -> Iterator[str]:
    """Serve a film by RTSP; yield its URL."""
    command = ["/usr/bin/python3", "-c", SERVER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        if not (port := server.stdout.readline().strip()):
            pytest.skip("no gir1.2-gst-rtsp-server-1.0")
        try:
            yield f"rtsp://127.0.0.1:{port}/film"
        finally:
            server.kill()


def offset_of(image: Any, expected: list[Any]) -> int:
    """Return the number of a picture; a stream may begin in the middle of what is sent."""
    return next(n for n, each in enumerate(expected) if np.array_equal(image, each))


@pytest.mark.parametrize(
    ("serve", "name"),
    [
        (served, "film.ts"),
        pytest.param(served_by_rtsp, "film.mkv", marks=pytest.mark.nightly),
    ],
)
def test_network_camera_decodes_what_is_needed(
    serve: Callable[[Path], AbstractContextManager[str]], name: str, tmp_path: Path
) -> None:
    path = write(tmp_path / name, X264, {"g": "12", "bf": "0"})
    expected, first = [frame.image for frame in opened(path).frames()], -1
    with serve(path) as url:
        source, wanted = StreamSource(url, WallClock()), needs(5)
        assert isinstance(source, OnDemandSource)
        source.open()
        for number in range(80):
            source.need(0.3)
            frame = source.read()
            assert frame is not None and frame.decode is not None and frame.image_size == SIZE
            if wanted[number] and (frame.decode() or first >= 0):
                first = offset_of(frame.image(), expected) - number if first < 0 else first
                assert np.array_equal(frame.image(), expected[first + number]), number
        assert first >= 0 and source._pictures is not None
        assert source._pictures.decoded < 0.7 * 80 and source.note == ""
        source.close()


@each_case(
    ("options", "note"),
    [
        ({"bf": "2", "g": "30"}, "decoded, also those of idle slots: it has B-frames"),
        ({"bf": "0", "g": "55"}, "slots: a key frame comes every 2.2 s, not every second"),
    ],
)
def test_network_camera_that_costs_more_than_it_has_to_is_told(
    options: dict[str, str], note: str, tmp_path: Path
) -> None:
    path = write(tmp_path / "film.ts", X264, options)
    expected, shown = [frame.image for frame in opened(path).frames()], list[int]()
    with served(path) as url:
        source = StreamSource(url, WallClock())
        source.open()
        for _ in range(115):
            if len(shown) >= 15 and note in source.note:
                break
            if (frame := source.read()) is not None:
                shown.append(offset_of(frame.image(), expected))
        assert note in source.note and shown == list(range(shown[0], shown[0] + len(shown)))
        source.close()


def test_stream_that_gives_no_picture_on_demand_is_decoded_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "film.ts", X264, {"g": "12", "bf": "0"})
    monkeypatch.setattr("e3pose.camera.live_source.MOST_LOST", 3)
    with served(path) as url, monkeypatch.context() as broken:
        broken.setattr(decoding.OnDemand, "_decode", lambda self, needed: self._waiting.popleft())
        source = StreamSource(url, WallClock())
        source.open()
        frames = [source.read() for _ in range(60)]
        assert sum(frame is not None for frame in frames) > 20 and not frames[0]
        source.close()


def test_film_is_decoded_before_the_moment_at_which_it_may_be_needed(tmp_path: Path) -> None:
    source = make_source(str(write(tmp_path / "film.mp4", X264, {})), "cam1", WallClock())
    assert isinstance(source, OnDemandSource) and "all pictures are decoded" not in source.note
    source.open()
    for in_s, ready in ((None, True), (10.0, False), (0.0, True)):
        if in_s is not None:
            source.need(in_s)
        frame = source.read()
        assert frame is not None and isinstance(frame.image, decoding.Coded)
        assert (frame.image.picture is not None) is ready, in_s
    source.close()
    whole = make_source(str(write(tmp_path / "mpeg4.mp4", "mpeg4", {})), "cam1", WallClock())
    assert isinstance(whole, OnDemandSource) and "all pictures are decoded" in whole.note


def test_time_without_need_ends_with_a_slot_that_is_active_or_not_ordered() -> None:
    times = SlotTimes(0, 100_000_000)
    for active, newest, free_ms in (
        ({}, -1, 0),  # not ordered: maybe now
        ({5: False, 6: False}, 4, 170),  # until 30 ms before slot 7 begins
        ({5: False, 6: True, 7: False}, 4, 70),
        ({5: True, 6: False, 7: False}, 5, 270),  # slot 5 has its frame
        ({5: True, 6: False, 7: False}, 4, 0),
    ):
        schedule = Schedule(1, times, active=active)
        assert schedule.free_s(times.begin_ns(5), newest) == pytest.approx(free_ms / 1e3), active
    assert Schedule().free_s(0, -1) == 0.0


def test_frame_of_an_active_slot_is_decoded_before_the_next_and_a_damaged_one_left_out() -> None:
    said = list[str]()

    class Film:
        fps, note = 10.0, ""

        def __init__(self) -> None:
            self.number = 0

        def open(self) -> None: ...

        def close(self) -> None: ...

        def need(self, in_s: float) -> None:
            said.append("need")

        def read(self) -> LiveFrame:
            return LiveFrame(0, (4, 4), lambda: None)

    node = CameraNode(NodeSettings("lab", "cam0", ()), Film(), None, Hub().join(), WallClock())
    times = SlotTimes(0, 10**8)
    node.schedule = Schedule(1, times, active={1: True, 2: False, 3: True})
    for slot, intact in ((1, False), (2, True), (3, True)):

        def decode(slot: int = slot, intact: bool = intact) -> bool:
            said.append(f"decode {slot}")
            return intact

        node._take(LiveFrame(times.middle_ns(slot), (4, 4), lambda: None, decode=decode))
    assert said == ["decode 1", "decode 3"]
    seen = node._frames.take()
    assert seen is not None and seen.slot == 3 and node._frames.dropped == 0


def test_what_is_held_for_who_asks_for_a_picture_holds_no_decoder_and_no_rgb(
    tmp_path: Path,
) -> None:
    path, clock, converted = write(tmp_path / "film.mp4", X264, {}), WallClock(), list[Any]()

    class Empty:
        skeleton = COCO17

        def detect(self, image: Any) -> Poses2D:
            converted.append(weakref.ref(image))
            return Poses2D.empty(len(COCO17))

    settings, pictures = NodeSettings("lab", "cam0", COCO17.joints), Pictures("cam0", clock)
    source = make_source(str(path), "cam0", clock)
    node = CameraNode(settings, source, Empty(), Hub().join(), clock, pictures=pictures)
    film = opened(path).coded()
    _, coded = next(film)
    stream = weakref.ref(coded.stream)
    assert coded.decode()
    node._look(_Seen(LiveFrame(0, SIZE, coded, decode=coded.decode), 1, 0, 0, 10**8))
    film.close()  # type: ignore[attr-defined]
    gc.collect()
    assert stream() is None and converted[0]() is None
    shown = decode(pictures.answer("", b""), Picture, "cam0")  # type: ignore[arg-type]
    assert shown.image_size == SIZE and shown.jpeg
