"""Read the frames of a video file with their times.

Times come from the file's own timestamps and edit list, as players show it, so a variable frame
rate, dropped frames and lossless cuts are seen as they are. Time 0 is the begin of the file, even
where its first frames cannot be decoded. Pictures are turned as the file's display matrix says and
deinterlaced where it says that they are interlaced. Frames that cannot be decoded, and those that
the decoder guesses until the next key frame, are left out and counted. FFmpeg works on a thread of
its own and has a time for each packet, and pictures have a bound before they are decoded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError, reason_of
from e3pose.base.jpeg import check_picture
from e3pose.base.threads import Found, OtherThread
from e3pose.camera.decoding import ON_DEMAND, Coded, Intact, OnDemand, decoded
from e3pose.camera.orientation import Orientation, display_orientation
from e3pose.recording.videos import chapters_of, frame_numbers

# Containers of moving pictures only: FFmpeg would also "play" a text file or follow a play list.
CONTAINERS = (
    "mov,mp4,matroska,webm,avi,mpegts,mpeg,mpegvideo,m4v,h264,hevc,ivf,obu,flv,asf,ogg,mjpeg,"
    "mxf,nut"
)
# Containers whose packets have times of presentation.
TIMED = ("mp4", "matroska", "mpegts")
MAX_PIXELS = 8192 * 8192  # of one frame: 200 MB in RGB
MAX_PICTURE_BYTES = 300_000_000
DECODER = {"max_pixels": str(MAX_PIXELS)}  # FFmpeg refuses larger pictures before it decodes them
PACKET_S = 60.0  # for FFmpeg to open a file, to find a packet, or to decode it
MAX_PACKETS_TO_FIRST_FRAME = 2000
FALLBACK_RATE = 25.0  # frames per second where the file does not say
RATES = (0.001, 1000.0)  # frames per second that a recording may have
MAX_GAP_S = 86_400.0  # between two frames: more is a damaged timestamp, and a recording of nothing
END_TOLERANCE = 2.5  # frames by which a file may fall short of the length it announces
# By so much sound begins before the picture where an encoder needs a run-up: no late picture.
SOUND_RUN_UP_S = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One decoded frame.

    Attributes:
        index: how many frames the reader gave before.
        time_s: seconds since the begin of the file.
    """

    index: int
    time_s: float
    _picture: Any = field(repr=False)
    _orientation: Orientation = field(repr=False)

    @property
    def image(self) -> NDArray[np.uint8]:
        """`(height, width, 3)` RGB, converted and turned upright at every call."""
        return self._orientation.apply(self._picture.to_ndarray(format="rgb24"))

    @property
    def size(self) -> tuple[int, int]:
        """`(width, height)` in pixels, as shown."""
        return self._orientation.size(self._picture.width, self._picture.height)

    def shrunk(self, size: tuple[int, int]) -> NDArray[np.uint8]:
        """Return the image in another size, by FFmpeg: a third of the time of doing it later.

        Args:
            size: `(width, height)` in pixels, as shown.
        """
        width, height = self._orientation.size(*size)
        scaled = {"width": width, "height": height, "interpolation": "AREA"}
        return self._orientation.apply(self._picture.to_ndarray(format="rgb24", **scaled))


@dataclass(eq=False)
class VideoSource:
    """A video file that can be read any number of times; made by `open_video`.

    Attributes:
        path: the file.
        image_size: `(width, height)` in pixels, as shown.
        turned: whether the file asks for a quarter turn: `image_size` is the stored size swapped.
        rate: nominal frames per second.
        num_frames: how many frames the file announces; an estimate, for a progress bar.
        on_demand: whether its pictures can be decoded as they are needed.
        late_s: when its first frame that can be decoded is shown, in seconds.
        lost_frames: frames the last reading could not decode.
        damage: what was wrong in the last reading, in words; empty if nothing was.
    """

    path: Path
    image_size: tuple[int, int]
    turned: bool
    rate: float
    num_frames: int
    on_demand: bool = False
    late_s: float = 0.0
    lost_frames: int = 0
    damage: str = ""
    _zero_s: float | None = None
    _length_s: float | None = None
    _orientation: Orientation = field(default_factory=Orientation)
    _interlaced: bool = False

    def __iter__(self) -> Iterator[Frame]:
        return self.frames()

    @property
    def length_s(self) -> float:
        """Seconds that it lasts, by its header."""
        by_count = self.num_frames / self.rate
        return by_count if self._length_s is None else self._length_s + 1 / self.rate

    def frames(self, start_s: float = 0.0) -> Iterator[Frame]:
        """Yield the frames from `start_s` on, in rising time.

        Jumps to the key frame before `start_s` where the file allows it. What is damaged is left
        out; `lost_frames` and `damage` tell of it when the iterator is exhausted.
        """
        self.lost_frames, self.damage = 0, ""
        pictures = self._pictures(start_s)
        last_s, index = -np.inf, 0
        for picture in pictures:
            time_s = self._time_s(picture, index)
            if time_s <= last_s:  # a time that does not rise cannot be trusted
                self.lost_frames += 1
                continue
            if time_s - max(last_s, 0.0) > MAX_GAP_S:
                raise InputError(
                    f"{self.path}: found a frame at {time_s:.0f} s, {time_s - last_s:.0f} s after "
                    f"the one before, expected at most {MAX_GAP_S:.0f} s between two"
                )
            last_s = time_s
            if time_s >= start_s - 1e-9:
                self._check_size(picture, time_s)
                yield Frame(index, time_s, picture, self._orientation)
                index += 1
            elif self._zero_s is None:
                index += 1  # without timestamps the count is the clock
        self.damage = self._describe(last_s)

    def coded(self, start_s: float = 0.0) -> Iterator[tuple[float, Coded]]:
        """Yield time and picture of each frame from `start_s` on, of a film that is `on_demand`."""
        with _Film(self.path, self._stored_size) as film:
            stream, zero_s = film.stream, self._zero_s or 0.0
            stream.thread_type = "SLICE"  # threads for whole pictures decode some that nobody needs
            if start_s > 0:
                film.seek(zero_s + start_s)
            pictures = OnDemand(film.undecoded(), stream.codec_context)
            while (at := pictures.next()) is not None:
                time_s = float(at * stream.time_base) - zero_s
                if time_s >= start_s - 1e-9:
                    yield time_s, Coded(pictures, at, self._stored_size, self._orientation)

    def sound(self, rate: int, seconds: float) -> NDArray[np.float64] | None:
        """Return `(num_samples,)` of its sound from the first frame on; None without any.

        Args:
            rate: samples per second.
            seconds: of sound at most; where the file has none, samples are 0.
        """
        import av

        samples, last = np.zeros(round(seconds * rate)), 0
        with _Film(self.path) as film:
            if not film.container.streams.audio:
                return None
            resampler = av.AudioResampler(format="flt", layout="mono", rate=rate)
            for _, decoded in film.packets(film.container.streams.audio[0]):
                for heard in decoded or ():  # a damaged packet leaves a gap
                    for part in resampler.resample(heard):
                        begin = round((float(part.time or 0.0) - (self._zero_s or 0.0)) * rate)
                        if begin >= len(samples):
                            return samples
                        chunk = part.to_ndarray().reshape(-1)[max(0, -begin) :]
                        begin = max(begin, 0)
                        chunk = chunk[: len(samples) - begin]
                        samples[begin : begin + len(chunk)] = chunk
                        last = max(last, begin + len(chunk))
        return samples[:last]

    def _pictures(self, start_s: float) -> Iterator[Any]:
        if start_s > 0 and self._zero_s is not None:
            with _Film(self.path, self._stored_size) as film:
                pictures = self._shown(film, self._zero_s + start_s)
                first = next(pictures, None)
                if first is not None and self._time_s(first, 0) <= start_s + 1e-9:
                    yield first
                    yield from pictures
                    return
            self.lost_frames = 0  # the jump went too far, or nowhere
        with _Film(self.path, self._stored_size) as film:
            yield from self._shown(film)

    def _shown(self, film: _Film, seek_s: float | None = None) -> Iterator[Any]:
        pictures = _decode(film, self, seek_s=seek_s)
        return _deinterlaced(film.stream, pictures) if self._interlaced else pictures

    @property
    def _stored_size(self) -> tuple[int, int]:
        return self._orientation.size(*self.image_size)

    def _time_s(self, picture: Any, index: int) -> float:
        if self._zero_s is None or picture.time is None:
            return index / self.rate
        return float(picture.time) - self._zero_s

    def _check_size(self, picture: Any, time_s: float) -> None:
        size = self._orientation.size(picture.width, picture.height)
        if size != self.image_size:
            raise InputError(
                f"{self.path}: image size changes to {size} at {time_s:.3f} s, "
                f"expected {self.image_size} throughout"
            )

    def _describe(self, last_s: float) -> str:
        parts = ["interlaced, so it was deinterlaced"] if self._interlaced else []
        if not self.turned and self._orientation != Orientation():  # no size tells of it
            parts.append("turned as its header asks players (--as-stored ignores it)")
        if self.late_s * self.rate > END_TOLERANCE:
            parts.append(f"its picture begins {self.late_s:.2f} s late")
        if self.lost_frames:
            parts.append(f"{self.lost_frames} damaged frames left out")
        if self._length_s is not None and np.isfinite(last_s):
            missing = (self._length_s - last_s) * self.rate
            if missing > END_TOLERANCE:
                parts.append(
                    f"ends after {last_s:.2f} s, its header announces {self._length_s:.2f} s"
                )
        return "; ".join(parts)


def open_video(
    path: Path, image_size: tuple[int, int] | None = None, as_stored: bool = False
) -> Video:
    """Open a video file and decode its first frame, to know its size and that it can be read.

    Args:
        path: the file; A.MP4+B.MP4 for chapters of one film, of which those after the first are
            in its folder unless they say another.
        image_size: `(width, height)` that it should have, which chooses among several tracks; the
            largest otherwise.
        as_stored: leave pictures as they are stored, whatever turn the file asks players for.

    Raises:
        InputError: naming the file and what is wrong: missing, empty, not a video, without a video
            track, of a rate that cannot be, without a frame that can be decoded, too large, turned
            by an odd angle, or a chapter unlike the first.
    """
    first, *others = chapters_of(path)
    film = _open_file(first, image_size, as_stored)
    if not others:
        return film
    return Chapters((film, *(_open_file(other, film.image_size, as_stored) for other in others)))


def _open_file(path: Path, image_size: tuple[int, int] | None, as_stored: bool) -> VideoSource:
    if not path.is_file():
        raise InputError(
            f"{path}: found {'a folder' if path.is_dir() else 'no file'}, expected a video"
        )
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty, expected a video")
    with _Film(path, image_size) as film:
        stream, counter = film.stream, VideoSource(path, (0, 0), False, 0.0, 0)
        first = next(_decode(film, counter, MAX_PACKETS_TO_FIRST_FRAME), None)
        if first is None:
            raise InputError(f"{path}: no frame of it can be decoded, expected a video")
        orientation = display_orientation({} if as_stored else first.side_data, str(path))
        rate = _rate(stream, path)
        first_s = None if first.time is None else float(first.time)
        zero_s = None if first_s is None else _zero_s(film.container, stream, first_s)
        length_s = _length_s(film.container, stream, rate, zero_s)
        timed = any(name in film.container.format.name for name in TIMED) and zero_s is not None
        counted = [int(stream.frames)] if stream.frames else []
        counted += [] if length_s is None else [round(length_s * rate) + 1]
        return VideoSource(
            path,
            orientation.size(first.width, first.height),
            orientation.transpose,
            rate,
            max(min(counted, default=1), 1),
            timed and stream.codec_context.name in ON_DEMAND and not first.interlaced_frame,
            0.0 if first_s is None or zero_s is None else first_s - zero_s,
            _zero_s=zero_s,
            _length_s=length_s,
            _orientation=orientation,
            _interlaced=bool(first.interlaced_frame),
        )


@dataclass(eq=False)
class Chapters:
    """A film in several files, as cameras write that begin a new file every few minutes.

    A chapter begins where the one before ends by its header.

    Attributes:
        files: the chapters, in their order.
        lost_frames: of the last reading.
        damage: of the last reading.
    """

    files: tuple[VideoSource, ...]
    lost_frames: int = 0
    damage: str = ""

    def __post_init__(self) -> None:
        first = self.files[0]
        for video in self.files[1:]:
            if video.image_size != first.image_size or abs(video.rate / first.rate - 1) > 1e-3:
                raise InputError(
                    f"{video.path}: found {video.image_size} at {video.rate:g} frames per second, "
                    f"expected {first.image_size} at {first.rate:g} as chapter {first.path.name}"
                )
        self.path = Path("+".join([str(first.path), *(self._name(v) for v in self.files[1:])]))
        self.image_size, self.turned, self.rate = first.image_size, first.turned, first.rate
        self.num_frames = sum(video.num_frames for video in self.files)

    def _name(self, video: VideoSource) -> str:
        same = video.path.resolve().parent == self.files[0].path.resolve().parent
        return video.path.name if same else str(video.path.resolve())

    def __iter__(self) -> Iterator[Frame]:
        return self.frames()

    def frames(self, start_s: float = 0.0) -> Iterator[Frame]:
        """Yield the frames of all chapters, see `VideoSource.frames`."""
        self.lost_frames, self.damage, damages = 0, "", []
        begin_s, index = 0.0, 0
        for video in self.files:
            if begin_s + video.length_s > start_s:
                for frame in video.frames(max(0.0, start_s - begin_s)):
                    yield replace(frame, index=index, time_s=frame.time_s + begin_s)
                    index += 1
                self.lost_frames += video.lost_frames
                damages += [f"{video.path.name} {video.damage}"] if video.damage else []
            begin_s += video.length_s
        self.damage = "; ".join(damages)

    def sound(self, rate: int, seconds: float) -> NDArray[np.float64] | None:
        """Return the sound of all chapters, see `VideoSource.sound`."""
        heard, begin_s = np.zeros(0), 0.0
        for video in self.files:
            part = video.sound(rate, seconds - begin_s) if begin_s < seconds else np.zeros(0)
            if part is None:
                return None
            begin = round(begin_s * rate)
            heard = np.pad(heard, (0, max(0, begin + len(part) - len(heard))))
            heard[begin : begin + len(part)] = part
            begin_s += video.length_s
        return heard


Video = VideoSource | Chapters


class _Film:
    """A file, opened by FFmpeg, and its video stream; every failure is one line."""

    container: Any
    stream: Any

    def __init__(self, path: Path, image_size: tuple[int, int] | None = None) -> None:
        self.path, self.image_size = path, image_size
        self._thread = OtherThread()

    def __enter__(self) -> _Film:
        import av

        reason = ""
        # An absolute path cannot be taken for a protocol such as `concat:`.
        place = str(self.path.absolute())
        options = {"format_whitelist": CONTAINERS, "protocol_whitelist": "file", **DECODER}
        try:
            self.container = self._call(lambda: av.open(place, options=options))
        except (av.error.FFmpegError, ValueError) as error:
            reason = reason_of(error)
            self._thread.end()
        if reason:  # FFmpeg's "input/output error" is the file's fault: it is no cause of this one
            raise InputError(
                f"{self.path}: cannot be read as a video ({reason}), "
                "expected a complete file such as MP4, MKV, AVI or TS"
            )
        try:
            self.stream = _video_stream(self.container, self.path, self.image_size)
        except BaseException:
            self.__exit__()
            raise
        self.stream.thread_type = "AUTO"
        self.stream.codec_context.options = DECODER
        return self

    def __exit__(self, *_: object) -> None:
        if not self._thread.at_work:  # else nobody may close what it reads
            self.container.close()
        self._thread.end()

    def seek(self, seconds: float) -> bool:
        """Go to the key frame before a time; return whether that was possible."""
        import av

        at, stream = seconds / self.stream.time_base, self.stream
        try:
            self._call(lambda: self.container.seek(int(at), stream=stream, backward=True))
        except (av.error.FFmpegError, OverflowError):
            return False
        return True

    def packets(self, stream: Any) -> Iterator[tuple[Any, list[Any] | None]]:
        """Yield the packets of a stream and their pictures; None for a damaged one."""
        import av

        packets = self.container.demux(stream)

        def step() -> tuple[Any, list[Any] | None] | None:
            try:
                packet = next(packets, None)
            except av.error.FFmpegError:  # nothing can be read beyond
                packet = None
            return None if packet is None else (packet, decoded(packet))

        while (found := self._call(step)) is not None:
            yield found

    def undecoded(self) -> Iterator[Any]:
        """Yield the packets of its pictures, for somebody who watches the time."""
        import av

        with suppress(av.error.FFmpegError):  # nothing can be read beyond
            yield from self.container.demux(self.stream)

    def _call(self, function: Callable[[], Found]) -> Found:
        """Have FFmpeg do something; it looks at no clock while it decodes."""
        try:
            return self._thread.call(function, PACKET_S)
        except TimeoutError:
            raise InputError(
                f"{self.path}: FFmpeg works on one packet for more than {PACKET_S:g} s, "
                "expected a video that can be decoded"
            ) from None


def _video_stream(container: Any, path: Path, image_size: tuple[int, int] | None) -> Any:
    """Return the stream of that size, stored upright or turned; without one the largest."""
    streams = [
        stream
        for stream in container.streams.video
        if "attached_pic" not in str(stream.disposition).lower()  # the cover of a song
    ]
    if not streams:
        kinds = ", ".join(sorted({stream.type for stream in container.streams})) or "nothing"
        raise InputError(f"{path}: holds {kinds} but no video track, expected a video")
    streams = [stream for stream in streams if stream.codec_context is not None]
    if not streams:
        raise InputError(f"{path}: its video track is in a format without a decoder")
    sizes = [(stream.codec_context.width, stream.codec_context.height) for stream in streams]
    wanted = () if image_size is None else (image_size, image_size[::-1])
    best = max(range(len(streams)), key=lambda i: (sizes[i] in wanted, sizes[i][0] * sizes[i][1]))
    width, height = sizes[best]
    if width * height > MAX_PIXELS:
        raise InputError(
            f"{path}: image size {width} x {height}, expected at most {MAX_PIXELS} pixels"
        )
    return streams[best]


def _decode(
    film: _Film,
    counter: VideoSource,
    max_packets: int | None = None,
    seek_s: float | None = None,
) -> Iterator[Any]:
    """Yield intact pictures, and count the others."""
    if seek_s is not None and not film.seek(seek_s):
        return
    intact = Intact()
    for packet, pictures in islice(film.packets(film.stream), max_packets):
        before, shown = intact.lost, intact.of(packet, pictures)
        counter.lost_frames += intact.lost - before
        yield from shown


def _deinterlaced(stream: Any, pictures: Iterator[Any]) -> Iterator[Any]:
    """Yield pictures with both fields at the time of the first, by FFmpeg's bwdif."""
    import av

    graph = av.filter.Graph()
    begin = graph.add_buffer(template=stream)
    graph.link_nodes(begin, graph.add("bwdif", "send_frame"), graph.add("buffersink")).configure()
    for picture in chain(pictures, (None,)):
        graph.push(picture)
        while True:
            try:
                yield graph.pull()
            except (av.error.BlockingIOError, av.error.EOFError):
                break


def _rate(stream: Any, path: Path) -> float:
    """Return the nominal frames per second of a file, or a usual rate where it states none."""
    rate = float(stream.average_rate or stream.guessed_rate or 0) or FALLBACK_RATE
    low, high = RATES
    if not low <= rate <= high:
        raise InputError(f"{path}: found {rate:g} frames per second, expected {low:g} to {high:g}")
    return rate


def _zero_s(container: Any, stream: Any, first_s: float) -> float:
    """Return the presentation time at which a file begins, of which `first_s` is shown first."""
    begins_s = [first_s]
    if stream.start_time is not None:
        begins_s.append(float(stream.start_time * stream.time_base))
    begin_s = min(begins_s)
    if container.start_time is None:
        return begin_s
    file_s = float(container.start_time) / 1e6
    return file_s if file_s < begin_s - SOUND_RUN_UP_S else begin_s


def _length_s(container: Any, stream: Any, rate: float, zero_s: float | None) -> float | None:
    """Return the time from the begin to the last frame that the header announces, if it does."""
    begin_s = 0.0
    if stream.start_time is not None and zero_s is not None:
        begin_s = float(stream.start_time * stream.time_base) - zero_s
    lengths = []
    if stream.duration:
        lengths.append(begin_s + float(stream.duration * stream.time_base))
    elif container.duration and len(container.streams) == 1:
        lengths.append(float(container.duration) / 1e6)
    if stream.frames and "mp4" not in container.format.name:  # whose edit list may hide some
        lengths.append(begin_s + stream.frames / rate)
    return max(lengths) - 1 / rate if lengths else None


KINDS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


@dataclass(frozen=True, slots=True)
class ImageFrame:
    """One image.

    Attributes:
        index: how many the reader gave before.
        time_s: seconds since the lowest number of all cameras.
        path: the file.
        image_size: `(width, height)` that it must have.
    """

    index: int
    time_s: float
    path: Path
    image_size: tuple[int, int]

    @property
    def image(self) -> NDArray[np.uint8]:
        """`(height, width, 3)` RGB, read at every call."""
        image = read_picture(self.path)
        size = image.shape[1], image.shape[0]
        if size != self.image_size:
            raise InputError(
                f"{self.path}: image size: found {size[0]}x{size[1]}, expected "
                f"{self.image_size[0]}x{self.image_size[1]} as the first image"
            )
        return image


@dataclass(frozen=True, slots=True)
class ImageFolder:
    """A folder of images whose names end in their number.

    Attributes:
        path: the folder.
        rate: images per second.
        image_size: `(width, height)` of the first.
        files: number to file, in rising order.
        first: the number at time 0.
        turned: False: images are read as they are stored.
        damage: empty: what cannot be read stops the reading.
    """

    path: Path
    rate: float
    image_size: tuple[int, int]
    files: Mapping[int, Path]
    first: int
    turned: bool = field(default=False, init=False)
    damage: str = field(default="", init=False)

    @property
    def num_frames(self) -> int:
        """The number of images if no number were missing."""
        return max(self.files) - self.first + 1

    def frames(self, start_s: float = 0.0) -> Iterator[ImageFrame]:
        """Yield the images from `start_s` on, in rising time; a number that lacks is a gap."""
        for index, (number, path) in enumerate(self.files.items()):
            time_s = (number - self.first) / self.rate
            if time_s >= start_s - 1e-9:
                yield ImageFrame(index, time_s, path, self.image_size)


Source = VideoSource | Chapters | ImageFolder


def open_sources(
    paths: Mapping[str, Path],
    fps: float | None,
    sizes: Mapping[str, tuple[int, int]] | None = None,
    as_stored: bool = False,
) -> dict[str, Source]:
    """Open the video file or the folder of images of every camera.

    Args:
        paths: camera id to file or folder.
        fps: images per second of the folders.
        sizes: camera id to the image size that it should have, where that is known.
        as_stored: see `open_video`.

    Raises:
        InputError: naming what is wrong; without `fps` where there is a folder.
    """
    folders = {name: _numbered(path) for name, path in paths.items() if path.is_dir()}
    if folders and fps is None:
        raise InputError("--fps", "missing", "the frame rate of the image folders, such as 25")
    first = min((min(files) for files in folders.values()), default=0)
    opened: dict[str, Source] = {}
    for name, path in paths.items():
        if name not in folders:
            opened[name] = open_video(path, (sizes or {}).get(name), as_stored)
            continue
        image = read_picture(next(iter(folders[name].values())))
        size = image.shape[1], image.shape[0]
        opened[name] = ImageFolder(path, fps or 0.0, size, folders[name], first)
    return opened


def _numbered(folder: Path) -> dict[int, Path]:
    """Return the images of a folder by the last number in their names, in rising order."""
    found: dict[int, Path] = {}
    images = [path for path in sorted(folder.iterdir()) if path.suffix.lower() in KINDS]
    for number, path in zip(frame_numbers([p.name for p in images]), images, strict=True):
        if number in found:
            raise InputError(f"{path}: number {number} appears twice, as {found[number].name} too")
        found[number] = path
    if not found:
        raise InputError(
            f"{folder}: found no image ({', '.join(KINDS)}), expected one per frame, or a video"
        )
    return dict(sorted(found.items()))


def read_picture(path: Path, grey: bool = False) -> NDArray[np.uint8]:
    """Return a picture file, turned as its EXIF tag says: `(height, width, 3)` RGB, or grey.

    Raises:
        InputError: when it is no picture, or one that would take too much to decode.
    """
    return decode_picture(read_bytes(path, MAX_PICTURE_BYTES), path, grey)


def decode_picture(
    data: bytes, where: object, grey: bool = False, turned: bool = True, most: int = MAX_PIXELS
) -> NDArray[np.uint8]:
    """Return a picture, `(height, width, 3)` RGB, or `(height, width)` with `grey`.

    Args:
        data: of the file.
        where: it is, for errors.
        grey: whether without colours.
        turned: as its EXIF tag says.
        most: pixels.

    Raises:
        InputError: when it is no picture; before it is decoded, for one that takes too much.
    """
    import cv2

    try:
        check_picture(data, most)
    except InputError as error:
        raise error.at(where) from None
    flags = cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR
    flags |= 0 if turned else cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image: Any = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    except cv2.error:
        image = None
    if image is None:
        raise InputError(f"{where}: cannot be read as an image")
    if image.shape[0] * image.shape[1] > most:
        raise InputError(f"{where}: found {image.shape[1]}x{image.shape[0]} pixels, too many")
    return np.asarray(image if grey else cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
