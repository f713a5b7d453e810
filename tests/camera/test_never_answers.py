"""Work that never yields: FFmpeg, a source or a network that does not come back is given up."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from tests.camera.mjpeg import network_camera

from e3pose.base.clock import WallClock
from e3pose.base.errors import InputError
from e3pose.camera import decoding, live, live_source, probe, source
from e3pose.camera.live_source import StreamSource
from e3pose.camera.source import MAX_PIXELS, Frame, open_video
from hostile_videos import film

Patch = pytest.MonkeyPatch
Never = Callable[..., Any]


@pytest.fixture
def never(monkeypatch: Patch) -> Iterator[Never]:
    """Return what does not come back before the end of the test, and bound what waits for it."""
    end = threading.Event()
    monkeypatch.setattr(source, "PACKET_S", 0.3)
    monkeypatch.setattr(probe, "MORE_S", 0.3)
    yield lambda *_args, **_more: end.wait(60.0)
    end.set()


def test_film_that_decodes_for_ever_is_refused_by_name(
    never: Never, tmp_path: Path, monkeypatch: Patch
) -> None:
    path, seen, decode = film(tmp_path / "a.mkv", 12), list[Frame](), decoding.decode_bounded
    video, packets = open_video(path), iter(range(20))
    monkeypatch.setattr(
        decoding, "decode_bounded", lambda packet: decode(packet) if next(packets) < 6 else never()
    )
    with pytest.raises(InputError, match=r"a\.mkv: FFmpeg works on one packet for more than 0\.3"):
        seen.extend(frame for frame in video)
    monkeypatch.setattr(decoding, "decode_bounded", decode)
    assert len(list(video)) == 12, "whoever waited goes on"
    monkeypatch.setattr(av, "open", never)
    with pytest.raises(InputError, match=r"a\.mkv: FFmpeg works"):
        open_video(path)
    with pytest.raises(InputError, match=r"a\.mkv: FFmpeg works"):
        video.sound(8000, 1.0)


def test_picture_that_is_too_large_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    """A film announces the size of its first pictures alone."""
    small, large = np.zeros((48, 64), np.uint8), np.zeros((8200, 8200), np.uint8)
    assert large.size > MAX_PIXELS
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mjpeg", rate=20)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuvj420p"
        container.start_encoding()
        for number, image in enumerate((small, small, large, small, small)):
            packet = av.Packet(cv2.imencode(".jpg", image)[1].tobytes())
            packet.stream, packet.pts, packet.dts = stream, 50 * number, 50 * number
            packet.time_base, packet.is_keyframe = stream.time_base, True
            container.mux(packet)
    video = open_video(path)
    assert len(list(video)) == 4 and video.lost_frames == 1


def test_stream_is_bounded_as_a_film_is(never: Never, monkeypatch: Patch) -> None:
    with network_camera(20.0) as url:
        opened = StreamSource(url, WallClock())
        monkeypatch.setattr(live_source, "MAX_PIXELS", 64 * 48 - 1)
        with pytest.raises(InputError, match="pictures of more than 3071 pixels"):
            opened.open()
        monkeypatch.undo()
        monkeypatch.setattr(decoding, "decode_bounded", lambda packet: [])
        opened.open()
        assert opened.read() is None, "packets without a picture keep nobody"
        opened.close()
        monkeypatch.setattr(decoding, "decode_bounded", never)
        monkeypatch.setattr(probe, "MORE_S", 0.3)
        with pytest.raises(InputError, match="no answer of http"):
            probe.probe(url, timeout_s=0.3)


def test_a_program_that_was_stopped_for_long_is_not_stuck(monkeypatch: Patch) -> None:
    now_s = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    calls = live.Calls()
    with calls.of("source"):
        for passed_s, stuck in ((0.2, ""), (3600.0, ""), *((1.0, ""),) * 29, (1.0, "source")):
            now_s[0] += passed_s
            assert calls.stuck() == stuck
    with calls.of("source"):  # the next one begins anew
        for _ in range(29):
            now_s[0] += 1.0
            assert calls.stuck() == ""
