"""Read the frames of a video file with their times.

Times come from the file's own timestamps, so a variable frame rate and dropped frames are seen as
they are. Pictures are turned as the file's display matrix says. Frames that cannot be decoded, and
those that the decoder guesses until the next key frame, are left out and counted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError
from e3pose.base.jpeg import check_picture
from e3pose.camera.orientation import Orientation, display_orientation
from e3pose.recording.detections.openpose import frame_number

# Containers of moving pictures only: FFmpeg would also "play" a text file or follow a play list.
CONTAINERS = (
    "mov,mp4,matroska,webm,avi,mpegts,mpeg,mpegvideo,m4v,h264,hevc,ivf,obu,flv,asf,ogg,mjpeg,"
    "mxf,nut"
)
MAX_PIXELS = 8192 * 8192  # of one frame: 200 MB in RGB
MAX_PICTURE_BYTES = 300_000_000
MAX_PACKETS_TO_FIRST_FRAME = 2000
FALLBACK_RATE = 25.0  # frames per second where the file does not say
RATES = (0.001, 1000.0)  # frames per second that a recording may have
MAX_GAP_S = 86_400.0  # between two frames: more is a damaged timestamp, and a recording of nothing
END_TOLERANCE = 2.5  # frames by which a file may fall short of the length it announces


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One decoded frame.

    Attributes:
        index: how many frames the reader gave before.
        time_s: seconds since the first frame of the file.
    """

    index: int
    time_s: float
    _picture: Any = field(repr=False)
    _orientation: Orientation = field(repr=False)

    @property
    def image(self) -> NDArray[np.uint8]:
        """`(height, width, 3)` RGB, converted and turned upright at every call."""
        return self._orientation.apply(self._picture.to_ndarray(format="rgb24"))


@dataclass(eq=False)
class VideoSource:
    """A video file that can be read any number of times; made by `open_video`.

    Attributes:
        path: the file.
        image_size: `(width, height)` in pixels, as shown.
        turned: whether the file asks for a quarter turn: `image_size` is the stored size swapped.
        rate: nominal frames per second.
        num_frames: how many frames the file announces; an estimate, for a progress bar.
        lost_frames: frames the last reading could not decode.
        damage: what was wrong in the last reading, in words; empty if nothing was.
    """

    path: Path
    image_size: tuple[int, int]
    turned: bool
    rate: float
    num_frames: int
    lost_frames: int = 0
    damage: str = ""
    _first_s: float | None = None
    _length_s: float | None = None
    _orientation: Orientation = field(default_factory=Orientation)

    def __iter__(self) -> Iterator[Frame]:
        return self.frames()

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
            elif self._first_s is None:
                index += 1  # without timestamps the count is the clock
        self.damage = self._describe(last_s)

    def sound(self, rate: int, seconds: float) -> NDArray[np.float64] | None:
        """Return `(num_samples,)` of its sound from the first frame on; None without any.

        Args:
            rate: samples per second.
            seconds: of sound at most; where the file has none, samples are 0.
        """
        import av

        samples, last = np.zeros(round(seconds * rate)), 0
        with _container(self.path) as (container, _):
            if not container.streams.audio:
                return None
            resampler = av.AudioResampler(format="flt", layout="mono", rate=rate)
            for packet in container.demux(container.streams.audio[0]):
                try:
                    decoded = packet.decode()
                except av.error.FFmpegError:  # a damaged packet leaves a gap
                    continue
                for heard in decoded:
                    for part in resampler.resample(heard):
                        begin = round((float(part.time or 0.0) - (self._first_s or 0.0)) * rate)
                        if begin >= len(samples):
                            return samples
                        chunk = part.to_ndarray().reshape(-1)[max(0, -begin) :]
                        begin = max(begin, 0)
                        chunk = chunk[: len(samples) - begin]
                        samples[begin : begin + len(chunk)] = chunk
                        last = max(last, begin + len(chunk))
        return samples[:last]

    def _pictures(self, start_s: float) -> Iterator[Any]:
        if start_s > 0 and self._first_s is not None:
            with _container(self.path) as (container, stream):
                pictures = _decode(container, stream, self, seek_s=self._first_s + start_s)
                first = next(pictures, None)
                if first is not None and self._time_s(first, 0) <= start_s + 1e-9:
                    yield first
                    yield from pictures
                    return
            self.lost_frames = 0  # the jump went too far, or nowhere
        with _container(self.path) as (container, stream):
            yield from _decode(container, stream, self)

    def _time_s(self, picture: Any, index: int) -> float:
        if self._first_s is None or picture.time is None:
            return index / self.rate
        return float(picture.time) - self._first_s

    def _check_size(self, picture: Any, time_s: float) -> None:
        size = self._orientation.size(picture.width, picture.height)
        if size != self.image_size:
            raise InputError(
                f"{self.path}: image size changes to {size} at {time_s:.3f} s, "
                f"expected {self.image_size} throughout"
            )

    def _describe(self, last_s: float) -> str:
        parts = []
        if self.lost_frames:
            parts.append(f"{self.lost_frames} damaged frames left out")
        if self._length_s is not None and np.isfinite(last_s):
            missing = (self._length_s - last_s) * self.rate
            if missing > END_TOLERANCE:
                parts.append(
                    f"ends after {last_s:.2f} s, its header announces {self._length_s:.2f} s"
                )
        return "; ".join(parts)


def open_video(path: Path) -> VideoSource:
    """Open a video file and decode its first frame, to know its size and that it can be read.

    Raises:
        InputError: naming the file and what is wrong: missing, empty, not a video, without a video
            track, of a rate that cannot be, without a frame that can be decoded, too large, or
            turned by an odd angle.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(
            f"{path}: found {'a folder' if path.is_dir() else 'no file'}, expected a video"
        )
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty, expected a video")
    with _container(path) as (container, stream):
        counter = VideoSource(path, (0, 0), False, 0.0, 0)
        first = next(_decode(container, stream, counter, MAX_PACKETS_TO_FIRST_FRAME), None)
        if first is None:
            raise InputError(f"{path}: no frame of it can be decoded, expected a video")
        orientation = display_orientation(first.side_data, str(path))
        rate = _rate(stream, path)
        length_s = _length_s(container, stream, rate)
        counted = int(stream.frames) or round((length_s or 0.0) * rate)
        return VideoSource(
            path,
            orientation.size(first.width, first.height),
            orientation.transpose,
            rate,
            max(counted, 1),
            _first_s=None if first.time is None else float(first.time),
            _length_s=length_s,
            _orientation=orientation,
        )


class _container:
    """Open a file as FFmpeg container and first video stream; every failure is one line."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> tuple[Any, Any]:
        import av

        try:
            # An absolute path cannot be taken for a protocol such as `concat:`.
            self.container = av.open(
                str(self.path.absolute()),
                options={"format_whitelist": CONTAINERS, "protocol_whitelist": "file"},
            )
        except (av.error.FFmpegError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(
                f"{self.path}: cannot be read as a video ({reason}), "
                "expected a complete file such as MP4, MKV, AVI or TS"
            ) from None
        try:
            stream = _video_stream(self.container, self.path)
        except BaseException:
            self.container.close()
            raise
        stream.thread_type = "AUTO"
        return self.container, stream

    def __exit__(self, *_: object) -> None:
        self.container.close()


def _video_stream(container: Any, path: Path) -> Any:
    for stream in container.streams.video:
        if "attached_pic" in str(stream.disposition).lower():
            continue  # the cover of a song
        if stream.codec_context is None:
            raise InputError(f"{path}: its video track is in a format without a decoder")
        width, height = stream.codec_context.width, stream.codec_context.height
        if width * height > MAX_PIXELS:
            raise InputError(
                f"{path}: image size {width} x {height}, expected at most {MAX_PIXELS} pixels"
            )
        return stream
    kinds = ", ".join(sorted({stream.type for stream in container.streams})) or "nothing"
    raise InputError(f"{path}: holds {kinds} but no video track, expected a video")


def _decode(
    container: Any,
    stream: Any,
    counter: VideoSource,
    max_packets: int | None = None,
    seek_s: float | None = None,
) -> Iterator[Any]:
    """Yield intact pictures; count the damaged, and those guessed until the next key frame."""
    import av

    if seek_s is not None:
        try:
            container.seek(int(seek_s / stream.time_base), stream=stream, backward=True)
        except (av.error.FFmpegError, OverflowError):
            return
    packets = container.demux(stream)
    intact = False  # what comes before the first key frame is guessed
    seen = 0
    while True:
        try:
            packet = next(packets)
        except (StopIteration, av.error.FFmpegError):  # the end, or nothing readable beyond
            return
        seen += 1
        if max_packets is not None and seen > max_packets:
            return
        try:
            pictures = packet.decode()
        except av.error.FFmpegError:
            intact = False
            counter.lost_frames += 1
            continue
        for picture in pictures:
            intact = not picture.is_corrupt and (intact or picture.key_frame)
            if intact:
                yield picture
            else:
                counter.lost_frames += 1


def _rate(stream: Any, path: Path) -> float:
    """Return the nominal frames per second of a file, or a usual rate where it states none."""
    rate = float(stream.average_rate or stream.guessed_rate or 0) or FALLBACK_RATE
    low, high = RATES
    if not low <= rate <= high:
        raise InputError(f"{path}: found {rate:g} frames per second, expected {low:g} to {high:g}")
    return rate


def _length_s(container: Any, stream: Any, rate: float) -> float | None:
    """Return the time from the first to the last frame that the header announces, if it does."""
    lengths = []
    if stream.duration:
        lengths.append(float(stream.duration * stream.time_base))
    elif container.duration and len(container.streams) == 1:
        lengths.append(float(container.duration) / 1e6)
    if stream.frames:
        lengths.append(stream.frames / rate)
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
        """How many images there would be if no number were missing."""
        return max(self.files) - self.first + 1

    def frames(self, start_s: float = 0.0) -> Iterator[ImageFrame]:
        """Yield the images from `start_s` on, in rising time; a number that lacks is a gap."""
        for index, (number, path) in enumerate(self.files.items()):
            time_s = (number - self.first) / self.rate
            if time_s >= start_s - 1e-9:
                yield ImageFrame(index, time_s, path, self.image_size)


Source = VideoSource | ImageFolder


def open_sources(paths: Mapping[str, Path], fps: float | None) -> dict[str, Source]:
    """Open the video file or the folder of images of every camera.

    Args:
        paths: camera id to file or folder.
        fps: images per second of the folders.

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
            opened[name] = open_video(path)
            continue
        image = read_picture(next(iter(folders[name].values())))
        size = image.shape[1], image.shape[0]
        opened[name] = ImageFolder(path, fps or 0.0, size, folders[name], first)
    return opened


def _numbered(folder: Path) -> dict[int, Path]:
    """Return the images of a folder by the last number in their names, in rising order."""
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in KINDS:
            continue
        number = frame_number(path.name)
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
