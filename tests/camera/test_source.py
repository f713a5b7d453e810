from __future__ import annotations

import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.camera.source import Video, open_video
from hostile_videos import VIDEOS, film

WIDTH, HEIGHT = 64, 48
CORNERS = np.array(
    [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0]]
)  # red green / blue yellow


def picture(value: int, size: tuple[int, int] = (WIDTH, HEIGHT)) -> np.ndarray[Any, Any]:
    """An image whose brightness tells its number."""
    return np.full((size[1], size[0], 3), 16 + value, dtype=np.uint8)


def corners() -> np.ndarray[Any, Any]:
    image = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    for i, colour in enumerate(CORNERS):
        y, x = (i // 2) * HEIGHT // 2, (i % 2) * WIDTH // 2
        image[y : y + HEIGHT // 2, x : x + WIDTH // 2] = colour
    return image


def write_video(
    path: Path,
    images: Sequence[np.ndarray[Any, Any]],
    times_ms: Sequence[int] | None = None,
    rotation: int | None = None,
    hflip: bool = False,
    options: dict[str, str] | None = None,
    gop: int = 10,
) -> Path:
    with av.open(str(path), "w", options=options or {}) as container:
        stream = container.add_stream("mpeg4", rate=20)
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt, stream.gop_size, stream.bit_rate = "yuv420p", gop, 2_000_000
        stream.codec_context.time_base = Fraction(1, 1000)
        stream.time_base = Fraction(1, 1000)
        if rotation is not None:
            stream.set_display_rotation(rotation, hflip=hflip)
        for i, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts = 50 * i if times_ms is None else times_ms[i]
            frame.time_base = Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def noisy(count: int) -> list[np.ndarray[Any, Any]]:
    """Images that do not compress away, so that a cut file is cut inside a frame."""
    rng = np.random.default_rng(0)
    return [rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8) for _ in range(count)]


def test_frames_come_in_order_with_their_pictures(tmp_path: Path) -> None:
    video = open_video(write_video(tmp_path / "a.mp4", [picture(8 * i) for i in range(12)]))
    frames = list(video)
    assert video.image_size == (WIDTH, HEIGHT)
    assert video.num_frames == len(frames) == 12
    assert video.rate == pytest.approx(20, rel=0.01)
    assert [f.index for f in frames] == list(range(12))
    np.testing.assert_allclose([f.time_s for f in frames], np.arange(12) / 20, atol=1e-3)
    assert frames[0].image.shape == (HEIGHT, WIDTH, 3) and frames[0].image.dtype == np.uint8
    levels = [float(f.image.mean()) for f in frames]
    np.testing.assert_allclose(levels, 16 + 8.0 * np.arange(12), atol=3)
    assert video.damage == "" and video.lost_frames == 0
    assert len(list(video)) == 12  # it can be read twice
    assert frames[0].image is not frames[0].image  # and is converted only when asked


def test_variable_rate_keeps_the_true_times(tmp_path: Path) -> None:
    times = [1000, 1020, 1100, 1110, 1400, 1433]
    path = write_video(tmp_path / "a.mkv", [picture(9 * i) for i in range(6)], times)
    got = [frame.time_s for frame in open_video(path)]
    np.testing.assert_allclose(got, (np.array(times) - 1000) / 1000, atol=1e-6)


@each_case("rotation", [None, 90, 180, -90])
def test_rotation_agrees_with_opencv(tmp_path: Path, rotation: int | None) -> None:
    path = write_video(tmp_path / "a.mp4", [corners()] * 3, rotation=rotation)
    video = open_video(path)
    image = next(iter(video)).image
    capture = cv2.VideoCapture(str(path))
    ok, expected = capture.read()
    capture.release()
    assert ok and image.shape == expected.shape
    assert np.abs(image.astype(int) - expected[..., ::-1].astype(int)).mean() < 8
    assert [*video] and ("as its header asks" in video.damage) == (rotation == 180)
    turned = rotation in (90, -90)
    assert video.turned == turned
    assert video.image_size == ((HEIGHT, WIDTH) if turned else (WIDTH, HEIGHT))
    stored = open_video(path, as_stored=True)
    assert stored.image_size == (WIDTH, HEIGHT) and not stored.turned
    assert np.abs(next(iter(stored)).image.astype(int) - corners()).mean() < 8


@each_case(
    ("rotation", "hflip", "order"),
    [
        (90, False, [1, 3, 0, 2]),  # a counter-clockwise quarter turn: green goes to the left top
        (0, True, [1, 0, 3, 2]),
    ],
)
def test_corners_land_where_the_display_matrix_puts_them(
    tmp_path: Path, rotation: int, hflip: bool, order: list[int]
) -> None:
    path = write_video(tmp_path / "a.mp4", [corners()] * 2, rotation=rotation, hflip=hflip)
    image = next(iter(open_video(path))).image
    height, width = image.shape[:2]
    quarters = [(height // 4, width // 4), (height // 4, 3 * width // 4)]
    quarters += [(3 * height // 4, x) for _, x in quarters]
    seen = [
        int(np.abs(CORNERS - image[y, x].astype(int)).sum(axis=1).argmin()) for y, x in quarters
    ]
    assert seen == order


def test_start_jumps_to_the_same_frames(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", [picture(4 * i) for i in range(45)], gop=7)
    video = open_video(path)
    every = list(video)
    for first in (1, 6, 7, 13, 44):
        late = list(video.frames(start_s=first / 20))
        assert [f.time_s for f in late] == [f.time_s for f in every[first:]]
        assert float(np.abs(late[0].image.astype(int) - every[first].image).max()) <= 1
    assert list(video.frames(start_s=99.0)) == []


@each_case("name", ["a.mkv", "a.avi", "a.mp4"])
def test_cut_file_yields_what_is_there_and_says_so(tmp_path: Path, name: str) -> None:
    options = {"movflags": "faststart"} if name.endswith("mp4") else None
    path = write_video(tmp_path / name, noisy(40), options=options)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(0.6 * len(whole))])
    video = open_video(path)
    frames = list(video)
    assert 15 <= len(frames) <= 30
    np.testing.assert_allclose(np.diff([f.time_s for f in frames]), 0.05, atol=2e-3)
    assert "header announces" in video.damage


def test_damage_in_the_middle_costs_frames_but_no_time(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.avi", noisy(40))
    whole = bytearray(path.read_bytes())
    middle = len(whole) // 2
    whole[middle : middle + 4000] = bytes(4000)
    path.write_bytes(whole)
    video = open_video(path)
    frames = list(video)
    assert 20 <= len(frames) < 40
    assert frames[-1].time_s == pytest.approx(39 / 20, abs=0.06)
    assert video.lost_frames > 0 and "damaged" in video.damage


def song(path: Path) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=48000)
        samples = np.zeros((1, 4096), dtype=np.float32)
        frame = av.AudioFrame.from_ndarray(samples, format="fltp", layout="mono")
        frame.sample_rate = 48000
        container.mux(stream.encode(frame))
        container.mux(stream.encode())


def header_only(path: Path) -> None:
    write_video(path, noisy(10), options={"movflags": "faststart"})
    data = path.read_bytes()
    path.write_bytes(data[: data.index(b"mdat") + 8])


def no_index(path: Path) -> None:
    data = write_video(path, noisy(10)).read_bytes()
    path.write_bytes(data[: len(data) // 2])


@each_case(
    ("name", "make", "words"),
    [
        ("missing.mp4", lambda path: None, "no file"),
        ("folder.mp4", lambda path: path.mkdir(), "a folder"),
        ("empty.mp4", lambda path: path.write_bytes(b""), "empty"),
        ("text.txt", lambda path: path.write_text("hello\n" * 99), "cannot be read as a video"),
        ("list.m3u8", lambda path: path.write_text("#EXTM3U\na.mp4\n"), "cannot be read"),
        ("noise.mp4", lambda path: path.write_bytes(bytes(range(256)) * 20), "cannot be read"),
        ("song.m4a", song, "audio but no video track"),
        ("header.mp4", header_only, "no frame of it can be decoded"),
        ("cut.mp4", no_index, "cannot be read as a video"),
        ("photo.png", lambda path: cv2.imwrite(str(path), picture(0)), "cannot be read"),
    ],
)
def test_what_is_not_a_video_is_named_in_one_line(
    tmp_path: Path, name: str, make: Any, words: str
) -> None:
    make(tmp_path / name)
    with pytest.raises(InputError, match=words) as caught:
        open_video(tmp_path / name)
    assert name in str(caught.value) and "\n" not in str(caught.value)


def test_frames_before_the_first_key_frame_are_left_out(tmp_path: Path) -> None:
    without = film(tmp_path / "none.mkv", 30, still=True, drop=lambda packet: packet.is_keyframe)
    with pytest.raises(InputError, match=r"none\.mkv: no frame of it can be decoded"):
        open_video(without)
    first = film(tmp_path / "first.mkv", 30, still=True, drop=lambda packet: packet.pts == 0)
    video = open_video(first)
    frames = list(video)
    assert 0 < len(frames) < 29 and video.lost_frames == 29 - len(frames)


def repacked(
    source: Path, path: Path, from_s: float = 0.0, drop: int = 0, begin_s: float = 0.0
) -> Path:
    """Pack a video anew without encoding, as lossless cutters do: what is before is not shown."""
    with av.open(str(source)) as old, av.open(str(path), "w") as new:
        stream = old.streams.video[0]
        assert stream.time_base is not None
        shift = round((from_s - begin_s) / stream.time_base)
        copied = new.add_stream_from_template(stream)
        for number, packet in enumerate(old.demux(stream)):
            if packet.dts is None or packet.pts is None or number < drop:
                continue
            packet.pts, packet.dts, packet.stream = packet.pts - shift, packet.dts - shift, copied
            new.mux(packet)
    return path


def numbered(number: int) -> np.ndarray[Any, Any]:
    return picture(5 * number)


def numbers(video: Video, start_s: float = 0.0) -> list[int]:
    """The numbers of its frames, told by brightness."""
    return [round((float(f.image.mean()) - 16) / 5) for f in video.frames(start_s)]


def film_of_numbers(path: Path, codec: str = "libx264", key_every: int = 250) -> Path:
    """A film of 44 frames, 20 per second, whose brightness tells their number."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=20, options={"crf": "4"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.gop_size, stream.max_b_frames, stream.bit_rate = key_every, 2, 8_000_000
        for number in range(44):
            frame = av.VideoFrame.from_ndarray(numbered(number), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


@each_case(
    ("codec", "key_every", "end"),
    [("libx264", 250, ".mp4"), ("libx264", 12, ".mp4"), ("mpeg4", 250, ".mov")],
)
def test_lossless_cut_shows_what_players_show(
    tmp_path: Path, codec: str, key_every: int, end: str
) -> None:
    whole = film_of_numbers(tmp_path / f"whole{end}", codec, key_every)
    video = open_video(repacked(whole, tmp_path / f"cut{end}", from_s=1.3))
    assert numbers(video) == list(range(26, 44)) and video.damage == ""
    np.testing.assert_allclose([f.time_s for f in video], np.arange(18) / 20, atol=1e-6)
    assert video.num_frames == 18
    for first in (0, 1, 10, 17):
        late = list(video.frames(first / 20))
        assert [f.time_s for f in late] == pytest.approx(np.arange(first, 18) / 20)


def test_time_begins_where_the_file_begins(tmp_path: Path) -> None:
    whole = film_of_numbers(tmp_path / "whole.ts", key_every=20)
    video = open_video(repacked(whole, tmp_path / "joined.ts", drop=5, begin_s=7.0))
    with av.open(str(video.path)) as container:
        packets = [p.pts * p.time_base for p in container.demux(video=0) if p.pts is not None]
    assert numbers(video) == list(range(20, 44))
    late_s = float(packets[-1] - min(packets)) - 23 / 20
    damage, first_s = video.damage, next(iter(video)).time_s
    assert f"its picture begins {first_s:.2f} s late" in damage
    assert late_s > 0.5 and first_s == pytest.approx(late_s, abs=0.06)


def test_picture_after_the_sound_is_late_but_an_encoders_run_up_is_none(tmp_path: Path) -> None:
    for late_ms, first_s in ((60, 0.0), (500, 0.5)):
        path = tmp_path / f"{late_ms}.mkv"
        with av.open(str(path), "w") as container:
            sound = container.add_stream("aac", rate=48000)
            stream = container.add_stream("mpeg4", rate=20)
            stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
            stream.codec_context.time_base = Fraction(1, 1000)
            for i in range(20):
                heard = av.AudioFrame.from_ndarray(
                    np.zeros((1, 4096), dtype=np.float32), format="fltp", layout="mono"
                )
                heard.sample_rate = 48000
                container.mux(sound.encode(heard))
                frame = av.VideoFrame.from_ndarray(picture(i), format="rgb24")
                frame.pts, frame.time_base = late_ms + 50 * i, Fraction(1, 1000)
                container.mux(stream.encode(frame))
            container.mux([*sound.encode(), *stream.encode()])
        video = open_video(path)
        assert next(iter(video)).time_s == pytest.approx(first_s, abs=0.03)


def test_track_of_the_cameras_size_is_taken_else_the_largest(tmp_path: Path) -> None:
    path = tmp_path / "two.mp4"
    with av.open(str(path), "w") as container:
        for width, height in ((32, 24), (WIDTH, HEIGHT)):
            stream = container.add_stream("mpeg4", rate=20)
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for stream in container.streams.video:
            size = stream.codec_context.width, stream.codec_context.height
            for i in range(4):
                image = picture(i, size)
                container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
            container.mux(stream.encode())
    assert open_video(path).image_size == (WIDTH, HEIGHT)
    assert open_video(path, (32, 24)).image_size == (32, 24)
    assert open_video(path, (24, 32)).image_size == (32, 24)
    assert next(iter(open_video(path, (32, 24)))).image.shape == (24, 32, 3)


def test_chapters_are_one_film(tmp_path: Path) -> None:
    images = [numbered(i) for i in range(30)]
    for number in (1, 2, 3):
        write_video(tmp_path / f"GX0{number}.MP4", images[10 * number - 10 : 10 * number])
    film = open_video(tmp_path / "GX01.MP4+GX02.MP4+GX03.MP4")
    assert numbers(film) == list(range(30)) and film.num_frames == 30
    np.testing.assert_allclose([f.time_s for f in film], np.arange(30) / 20, atol=2e-3)
    assert [f.index for f in film] == list(range(30))
    assert numbers(film, 0.75) == list(range(15, 30))
    write_video(tmp_path / "GX04.MP4", [picture(1, (32, 24))] * 3)
    with pytest.raises(InputError, match=r"GX04\.MP4: found \(32, 24\).*as chapter GX01\.MP4"):
        open_video(tmp_path / "GX01.MP4+GX04.MP4")
    with pytest.raises(InputError, match=r"GX05\.MP4: found no file"):
        open_video(tmp_path / "GX01.MP4+GX05.MP4")


def test_interlaced_film_is_deinterlaced(tmp_path: Path) -> None:
    path, height = tmp_path / "woven.mp4", 96
    with av.open(str(path), "w") as container:
        stream = container.add_stream(
            "libx264", rate=25, options={"crf": "4", "flags": "+ildct+ilme"}
        )
        stream.width, stream.height, stream.pix_fmt = WIDTH, height, "yuv420p"
        for i in range(12):  # a bar moves by 3 pixels per field
            image = np.zeros((height, WIDTH, 3), dtype=np.uint8)
            for field in (0, 1):
                left = 3 * (2 * i + field) % 40
                image[field::2, left : left + 12] = 235
            frame = av.VideoFrame.from_ndarray(image, format="rgb24").reformat(format="yuv420p")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    video = open_video(path)
    frames = list(video)
    assert len(frames) == 12 and "deinterlaced" in video.damage
    np.testing.assert_allclose([f.time_s for f in frames], np.arange(12) / 25, atol=1e-6)
    combed = [float(np.abs(np.diff(f.image[..., 1].astype(int), axis=0)).mean()) for f in frames]
    assert max(combed) < 8  # woven: about 30


def by_ffmpeg(path: Path) -> dict[int, np.ndarray[Any, Any]]:
    """Pictures that FFmpeg decodes, by milliseconds from the begin of the file."""
    found: dict[int, np.ndarray[Any, Any]] = {}
    with av.open(str(path)) as container:
        begin_s = (container.start_time or 0) / av.time_base
        for packet in container.demux(container.streams.video[0]):
            try:
                pictures = packet.decode()
            except av.FFmpegError:
                continue
            for picture in pictures:
                if isinstance(picture, av.VideoFrame) and picture.time is not None:
                    shown = picture.to_ndarray(format="rgb24")
                    found.setdefault(round(1000 * (picture.time - begin_s)), shown)
    return found


# What FFmpeg plays and we do not: sizes and times that no film of people has, and what it guesses.
NOT_PLAYED = {
    "header of 65535 x 65535", "10^9 frames per second", "one frame in 136 years",
    "a gap of 11 days", "a gap of 31 years", "turned by 37 degrees", "no key frame",
    "size that changes",
}  # fmt: skip
# What takes seconds to decode.
LARGE = {"JPEGs of 60000 x 60000", "JPEGs of 20000 x 20000", "JPEGs of 20 000 scans"}


@each_case("kind", [kind for kind in VIDEOS if kind not in LARGE])
def test_hostile_films_show_what_ffmpeg_decodes_at_its_times(tmp_path: Path, kind: str) -> None:
    name, make = VIDEOS[kind]
    make(tmp_path / name)
    try:
        wanted = by_ffmpeg(tmp_path / name)
    except (av.FFmpegError, ValueError, IndexError):  # no film
        wanted = {}
    try:
        video = open_video(tmp_path / name, as_stored=True)
        frames = {round(1000 * frame.time_s): frame.image for frame in video}
    except InputError:
        assert not wanted or kind in NOT_PLAYED
        return
    assert frames and len(wanted) - len(frames) <= video.lost_frames, (len(wanted), len(frames))
    for time_ms, image in frames.items():
        near = min(wanted, key=lambda ms: abs(ms - time_ms))
        assert abs(near - time_ms) <= 1 and np.array_equal(wanted[near], image), (time_ms, near)


def test_gap_that_cannot_be_is_named(tmp_path: Path) -> None:
    path = film(tmp_path / "gap.mkv", 4, [0, 50, 10**9, 10**9 + 50])
    with pytest.raises(InputError, match=r"gap\.mkv: found a frame at 1000000 s, .* at most 86400"):
        list(open_video(path))
    hours = film(tmp_path / "hours.mkv", 3, [0, 50, 20 * 3_600_000])
    assert [frame.time_s for frame in open_video(hours)] == pytest.approx([0, 0.05, 72_000])


@pytest.mark.parametrize(("scale", "rate"), [(1, 10**9), (2**32 - 1, 1)])
def test_frame_rate_that_cannot_be_is_named(tmp_path: Path, scale: int, rate: int) -> None:
    path = write_video(tmp_path / "rate.avi", [picture(0)] * 10)
    data = bytearray(path.read_bytes())
    at = data.index(b"vids") + 20
    data[at : at + 8] = struct.pack("<II", scale, rate)
    path.write_bytes(data)
    with pytest.raises(
        InputError, match=r"rate\.avi: found .* per second, expected 0\.001 to 1000"
    ):
        open_video(path)


def test_source_without_timestamps_counts(tmp_path: Path) -> None:
    path = tmp_path / "a.h264"
    with av.open(str(path), "w", format="h264") as container:
        stream = container.add_stream("h264", rate=25)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for i in range(10):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture(i), format="rgb24")))
        container.mux(stream.encode())
    video: Video = open_video(path)
    times = [frame.time_s for frame in video]
    np.testing.assert_allclose(times, np.arange(10) / video.rate, atol=1e-6)
