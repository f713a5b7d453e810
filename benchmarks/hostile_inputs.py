"""Hostile videos and tables, one by one: what each is, what verbs say, how long and how large.

    python benchmarks/hostile_inputs.py           # try all and print a table
    python benchmarks/hostile_inputs.py videos    # or one kind of them: videos, tables

An input holds if every verb that is given it either uses it or ends with code 2 and one line, in
bounded time and memory. `make attack` tries them all too.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import shutil
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from e3pose.camera.live_source import make_source
from e3pose.cli import main as e3pose
from e3pose.errors import InputError
from e3pose.model import noises
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import save_recording
from e3pose.runtime.clock import WallClock
from e3pose.simulate.settings import SceneSettings
from e3pose.simulate.simulation import simulate
from e3pose.site.example import write_recorded

SHIPPED_NOISE = Path(noises.__file__).with_name("openpose-thin.toml")
LIMIT_S = 60.0  # for a verb, on a machine that does other things too; init measures for seconds
LIMIT_MB = 600.0  # more than before: a frame of the largest size takes 200 MB in RGB
WIDTH, HEIGHT = 64, 48
Make = Callable[[Path], object]


@dataclass(frozen=True)
class Trial:
    """What one verb made of one input.

    Attributes:
        name: of the input.
        verb: what was given it.
        code: exit code; 0 where it was used.
        said: the line on standard error, or what was made of the input.
        took_s: seconds.
        grown_mb: memory beyond that before, at most.
    """

    name: str
    verb: str
    code: int
    said: str
    took_s: float
    grown_mb: float

    @property
    def held(self) -> bool:
        """Whether it ended as it must."""
        lines = [s for s in self.said.splitlines() if not s.startswith("e3pose: warning: ")]
        ended = self.code == 0 or (self.code == 2 and len(lines) == 1)
        return ended and self.took_s < LIMIT_S and self.grown_mb < LIMIT_MB


class Nobody:
    """A detector that finds nobody, at once."""

    skeleton = COCO17

    def detect(self, image: np.ndarray[Any, Any]) -> Poses2D:
        """Return no people."""
        return Poses2D(np.zeros((0, 17, 2)), np.zeros((0, 17)))


# Videos.


def film(
    path: Path,
    count: int = 10,
    times_ms: list[int] | None = None,
    codec: str = "mpeg4",
    turned: int | None = None,
    still: bool = False,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    drop: Callable[[Any], bool] = lambda packet: False,
    at_ms: Callable[[int], int] | None = None,
    **options: str,
) -> Path:
    """Write a video of noise.

    Args:
        path: the file.
        count: frames.
        times_ms: of the frames; every 50 ms by default.
        codec: of FFmpeg.
        turned: degrees that its display matrix says.
        still: whether all frames are the same, so that few are key frames.
        size: of its images.
        drop: packets to leave out.
        at_ms: changes the times of packets.
        options: of the container.
    """
    rng = np.random.default_rng(0)
    with av.open(str(path), "w", options=options) as container:
        stream = container.add_stream(codec, rate=20)
        stream.width, stream.height = size
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.codec_context.time_base = stream.time_base = Fraction(1, 1000)
        if turned is not None:
            stream.set_display_rotation(turned)
        container.start_encoding()
        frames: list[Any] = [None] if not count else []
        for i in range(count):
            if not (still and i):
                image = rng.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts = 50 * i if times_ms is None else times_ms[i]
            frame.time_base = Fraction(1, 1000)
            frames.append(frame)
        for frame in [*frames, None]:
            for packet in stream.encode(frame) if count else []:
                if at_ms is not None:
                    packet.pts = packet.dts = at_ms(packet.pts)
                if not drop(packet):
                    container.mux(packet)
    return path


def cut(part: float, **options: Any) -> Make:
    """Return what writes the first part of a video."""

    def make(path: Path) -> None:
        data = film(path, 40, **options).read_bytes()
        path.write_bytes(data[: int(len(data) * part)])

    return make


def patched(find: bytes, at: int, put: bytes, **options: Any) -> Make:
    """Return what overwrites bytes of a video, `at` behind the first place of `find`."""

    def make(path: Path) -> None:
        data = bytearray(film(path, **options).read_bytes())
        begin = data.index(find) + at
        data[begin : begin + len(put)] = put
        path.write_bytes(data)

    return make


def patched_everywhere(find: bytes, put: bytes, **options: Any) -> Make:
    """Return what replaces bytes of a video."""

    def make(path: Path) -> None:
        data = film(path, **options).read_bytes()
        assert find in data
        path.write_bytes(data.replace(find, put))

    return make


def jpeg_of(size: int) -> Make:
    """Return what writes a film of JPEGs whose own headers state another size than the file's."""
    own = struct.pack(">HH", HEIGHT, WIDTH)

    def make(path: Path) -> None:
        data = bytearray(film(path, codec="mjpeg").read_bytes())
        at = data.find(b"\xff\xc0")
        while at >= 0:
            assert data[at + 5 : at + 9] == own
            data[at + 5 : at + 9] = struct.pack(">HH", size, size)
            at = data.find(b"\xff\xc0", at + 9)
        path.write_bytes(data)

    return make


VIDEOS: dict[str, tuple[str, Make]] = {
    "half of a file": ("a.avi", cut(0.5)),
    "half of a file, its index first": ("a.mp4", cut(0.5, movflags="faststart")),
    "half of a file, its index lost": ("a.mp4", cut(0.5)),
    "200 bytes": ("a.mkv", lambda p: p.write_bytes(film(p).read_bytes()[:200])),
    "no byte": ("a.mp4", lambda p: p.write_bytes(b"")),
    "zeros": ("a.mp4", lambda p: p.write_bytes(bytes(10**6))),
    "no frame": ("a.mkv", lambda p: film(p, 0)),
    "no frame, MP4": ("a.mp4", lambda p: film(p, 0)),
    "one frame": ("a.mkv", lambda p: film(p, 1)),
    "header of 65535 x 65535": (
        "a.avi", patched(b"strf", 12, struct.pack("<ii", 65535, 65535), codec="mjpeg"),
    ),
    "header of -64 x -48": (
        "a.avi", patched(b"strf", 12, struct.pack("<ii", -64, -48), codec="mjpeg"),
    ),
    "JPEGs of 60000 x 60000": ("a.avi", jpeg_of(60000)),
    "JPEGs of 20000 x 20000": ("a.avi", jpeg_of(20000)),
    "size that changes": ("a.avi", jpeg_of(32)),
    "codec that is none": ("a.mp4", patched_everywhere(b"mp4v", b"XxXx")),
    "codec of another kind": ("a.avi", patched_everywhere(b"FMP4", b"H264")),
    "sound called video": ("a.avi", patched(b"vids", 0, b"auds")),
    "10^9 frames per second": ("a.avi", patched(b"vids", 20, struct.pack("<II", 1, 10**9))),
    "one frame in 136 years": ("a.avi", patched(b"vids", 20, struct.pack("<II", 2**32 - 1, 1))),
    "rate 0": ("a.avi", patched(b"vids", 20, struct.pack("<II", 0, 0))),
    "2^32 frames announced": ("a.avi", patched(b"vids", 32, struct.pack("<I", 2**32 - 1))),
    "variable rate": ("a.mkv", lambda p: film(p, 6, [0, 1, 500, 501, 7000, 9000])),
    "a gap of 11 days": ("a.mkv", lambda p: film(p, 4, [0, 50, 10**9, 10**9 + 50])),
    "a gap of 31 years": ("a.mkv", lambda p: film(p, 4, [0, 50, 10**12, 10**12 + 50])),
    "all at one time": ("a.mkv", lambda p: film(p, at_ms=lambda time_ms: 0)),
    "negative timestamps": (
        "a.mkv", lambda p: film(p, 10, [50 * i - 300 for i in range(10)], avoid_negative_ts="0"),
    ),
    "negative timestamps, MP4": (
        "a.mp4", lambda p: film(p, 10, [50 * i - 300 for i in range(10)], avoid_negative_ts="0"),
    ),
    "turned by 90 degrees": ("a.mp4", lambda p: film(p, turned=90)),
    "turned by 37 degrees": ("a.mp4", lambda p: film(p, turned=37)),
    "no key frame": (
        "a.mkv", lambda p: film(p, 30, still=True, drop=lambda packet: packet.is_keyframe),
    ),
    "2 x 2 pixels": ("a.mkv", lambda p: film(p, size=(2, 2))),
}  # fmt: skip


def try_video(path: Path, name: str, init: bool) -> Iterator[Trial]:
    """Give a video to those who read videos; `init` takes seconds with those that are good."""
    here = f"{Path(__file__).resolve()}:Nobody"
    dest = path.parent / "dest"
    yield tried(name, "detect", ["detect", str(path), str(dest), "--model", here])
    site = path.parent / "site"
    if init:
        sources = [f"cam0={path}", f"cam1={path}"]
        yield tried(name, "init", ["init", str(site), *sources, "--detector", here, "--fps", "5"])
    yield measured(name, "camera", lambda: played(path))


def played(path: Path) -> str:
    """Play a video as a camera does, for some frames."""
    clock = WallClock()
    source = make_source(str(path), "cam", clock, None)
    with contextlib.closing(source):
        source.open()
        shown = 0
        begun_s = time.monotonic()
        while shown < 5 and time.monotonic() - begun_s < 2.0:
            frame = source.read()
            if frame is not None:
                frame.image()
                shown += 1
    return f"{shown} frames at {source.fps:g} per second"


# Tables.

MARK = "\ufeff"
TABLES: dict[str, Callable[[bytes], bytes]] = {
    "as it is": lambda good: good,
    "empty": lambda good: b"",
    "byte order mark": lambda good: MARK.encode() + good,
    "byte order mark, twice": lambda good: 2 * MARK.encode() + good,
    "UTF-16": lambda good: good.decode().encode("utf-16"),
    "not UTF-8": lambda good: good + b'x = "\xff\xfe"\n',
    "NUL bytes": lambda good: good.replace(b"\n", b"\0\n", 1),
    "NUL in text": lambda good: b'x = "a\\u0000b"\n' + good,
    "100 MB": lambda good: good + b"#" * 100_000_000,
    "1 MB of keys": lambda good: b"".join(b"k%d=1\n" % i for i in range(80_000)) + good,
    "10000 lists, each in the last": lambda good: b"x = " + deep(b"[", b"]") + b"\n" + good,
    "10000 tables, each in the last": lambda good: b"x = " + deep(b"{a=", b"}") + b"\n" + good,
    "a key of 10000 parts": lambda good: b".".join([b"a"] * 10_000) + b" = 1\n" + good,
    "a heading of 10000 parts": lambda good: good + b"\n[" + b".".join([b"a"] * 10_000) + b"]\n",
    "1000 headings of 90 parts": lambda good: good + headings(1000, 90),
    "key twice": lambda good: first_line(good) + b"\n" + good,
    "table twice": lambda good: good + b"\n[zz]\n[zz]\n",
    "numbers: nan": lambda good: numbers(good, b"nan"),
    "numbers: inf": lambda good: numbers(good, b"inf"),
    "numbers: -1e308": lambda good: numbers(good, b"-1e308"),
    "numbers: 1e-308": lambda good: numbers(good, b"1e-308"),
    "numbers: 2^63": lambda good: numbers(good, b"9223372036854775808"),
    "numbers: 10^300": lambda good: numbers(good, b"1" + b"0" * 300),
    "numbers: 10^5000": lambda good: numbers(good, b"1" + b"0" * 5000),
    "numbers: true": lambda good: numbers(good, b"true"),
    "numbers: text": lambda good: numbers(good, b'"7"'),
    "numbers: a date": lambda good: numbers(good, b"2026-11-23T10:00:00Z"),
    "numbers: lists": lambda good: numbers(good, b"[[]]"),
    "numbers: a table": lambda good: numbers(good, b"{a = 1}"),
    "texts: a number": lambda good: texts(good, b"5"),
    "texts: empty": lambda good: texts(good, b'""'),
    "texts: 1 MB": lambda good: texts(good, b'"' + b"x" * 1000 + b'"'),
    "texts: control codes": lambda good: texts(good, b'"\\u001b[2J"'),
    "texts: ../..": lambda good: texts(good, b'"../../../etc/passwd"'),
    "texts: a table": lambda good: texts(good, b"{a = 1}"),
}  # fmt: skip


def deep(opened: bytes, closed: bytes) -> bytes:
    """Return a number in ten thousand lists or tables."""
    return opened * 10_000 + b"1" + closed * 10_000


def headings(count: int, parts: int) -> bytes:
    """Return headings of tables with so many parts each."""
    return b"".join(b"\n[" + b".".join([b"a%d" % i] * parts) + b"]\n" for i in range(count))


def first_line(good: bytes) -> bytes:
    """Return the first line that gives a key."""
    return next(line for line in good.splitlines() if b"=" in line)


def numbers(good: bytes, put: bytes) -> bytes:
    """Return a table whose last number is another value."""
    return _replaced(good, put, rb"^(\s*|.* = )-?\d[\d.e+-]*(,?)$")


def texts(good: bytes, put: bytes) -> bytes:
    """Return a table whose last text is another value."""
    return _replaced(good, put, rb"^(.* = )\".*\"()$")


def _replaced(good: bytes, put: bytes, value: bytes) -> bytes:
    last = list(re.finditer(value, good, re.MULTILINE))[-1]
    return good[: last.start()] + last[1] + put + last[2] + good[last.end() :]


def make_tables(folder: Path) -> dict[str, tuple[Path, list[str]]]:
    """Return a file of each kind, and the verb that reads it."""
    recording = simulate(SceneSettings(people=1, seconds=0.6, cameras=3, fps=10), seed=0)
    save_recording(recording, folder / "rec")
    write_recorded(folder / "site", recording, "lab")
    (folder / "noise.toml").write_bytes(SHIPPED_NOISE.read_bytes())
    rec, site = folder / "rec", folder / "site"
    replay = ["replay", str(rec), "--pipeline", "paper", "--policy", "all"]
    camera = folder / "camera.toml"
    camera.write_text(
        'format = "e3pose-camera"\nversion = 1\nsite = "lab"\ncamera = "cam0"\n'
        f'endpoint = "tcp/127.0.0.1:1"\nsource = "recorded:{folder / "none"}"\npace = 1.0\n'
    )
    return {
        "site.toml": (site / "site.toml", ["check", str(site), "--timeout", "0"]),
        "rig.toml": (rec / "calibration.toml", ["info", str(rec)]),
        "recording.toml": (rec / "recording.toml", ["info", str(rec)]),
        "noise.toml": (folder / "noise.toml", [*replay, "--noise", str(folder / "noise.toml")]),
        "camera.toml": (camera, ["camera", str(camera)]),
    }


def try_table(name: str, path: Path, words: list[str], good: bytes) -> Trial:
    """Give a table that is broken in one way to the verb that reads it."""
    path.write_bytes(TABLES[name](good))
    try:
        return tried(f"{path.name}: {name}", words[0], words)
    finally:
        path.write_bytes(good)


# Both.


def tried(name: str, verb: str, words: list[str]) -> Trial:
    """Run a verb in this process."""

    def run() -> str:
        stderr = io.StringIO()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(stderr):
            try:
                e3pose(words)
            except SystemExit as ended:
                if ended.code:
                    raise Ended(int(ended.code), stderr.getvalue()) from None
        return "used"

    return measured(name, verb, run)


class Ended(Exception):
    """A verb ended with a code and words."""


def measured(name: str, verb: str, run: Callable[[], str]) -> Trial:
    """Run something; return what came of it."""
    Path("/proc/self/clear_refs").write_text("5")  # the peak of memory from here on
    before_mb = peak_mb()
    begun_s = time.monotonic()
    code = 0
    try:
        said = run()
    except Ended as ended:
        code, said = ended.args
    except InputError as error:
        code, said = 2, str(error)
    except Exception as error:  # what this looks for
        code, said = -1, f"{type(error).__name__}: {error}"
    took_s = time.monotonic() - begun_s
    return Trial(name, verb, code, said, took_s, peak_mb() - before_mb)


def peak_mb() -> float:
    """Return the most memory that this process had since the peak was reset."""
    status = Path("/proc/self/status").read_text()
    (line,) = (line for line in status.splitlines() if line.startswith("VmHWM"))
    return float(line.split()[1]) / 1024


def try_all(kind: str = "", init: bool = True) -> Iterator[Trial]:
    """Try everything, or all of one kind, with `e3pose init` or without."""
    with tempfile.TemporaryDirectory(prefix="e3pose-hostile-") as name:
        folder = Path(name)
        if kind in ("", "videos"):
            for video, (file, make) in VIDEOS.items():
                place = folder / "video"
                place.mkdir()
                make(place / file)
                yield from try_video(place / file, video, init)
                shutil.rmtree(place)
        if kind in ("", "tables"):
            for path, words in make_tables(folder).values():
                good = path.read_bytes()
                for table in TABLES:
                    yield try_table(table, path, words, good)


def main() -> None:
    """Print the table; end with 1 if something did not hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", nargs="?", default="", choices=["", "videos", "tables"])
    failed = 0
    for trial in try_all(parser.parse_args().kind):
        failed += not trial.held
        said = " ".join(trial.said.split())[-150:]
        print(
            f"{'held' if trial.held else 'FAILED':6} | {trial.name:40} | {trial.verb:7} | "
            f"{trial.code:2} | {trial.took_s:5.1f} s | {trial.grown_mb:5.0f} MB | {said}",
            flush=True,
        )
    print(f"{failed} failed")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
