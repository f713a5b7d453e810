"""Write a video that stays readable if the program is killed.

Matroska, because a file that was cut off is still one. MPEG-4 part 2, because its encoder is the
fastest of FFmpeg's own, which need no GPL: half the processor time of VP9 at the same quality, for
twice the bytes.
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.private import make_file

CODEC = "mpeg4"
QSCALE = 4  # of 1 to 31: 40 dB of the frames themselves
TICKS = 1000  # a second; Matroska's
KEY_FRAME_S = 1.0  # so that what a kill cuts off is a second


class VideoFile:
    """A video that is being written, with the times at which its frames were taken.

    Attributes:
        path: the file.
        image_size: `(width, height)` of its frames; an odd last row or column is cut off.
    """

    def __init__(self, path: Path, image_size: tuple[int, int], fps: float) -> None:
        """Begin a file.

        Args:
            path: does not exist yet; ends in `.mkv`.
            image_size: `(width, height)` of the frames to come, in pixels.
            fps: frames per second, about.

        Raises:
            OSError: when it cannot be written.
        """
        import av

        self.path, self.image_size = path, image_size
        make_file(path)  # for its owner alone
        options = {"flush_packets": "1", "cluster_time_limit": str(round(1000 * KEY_FRAME_S))}
        self._container: Any = av.open(str(path), "w", format="matroska", options=options)
        rate = Fraction(fps).limit_denominator(1001)
        self._stream: Any = self._container.add_stream(CODEC, rate=rate)
        self._stream.width, self._stream.height = (side - side % 2 for side in image_size)
        self._stream.pix_fmt = "yuv420p"
        context = self._stream.codec_context
        context.time_base = Fraction(1, TICKS)
        context.thread_count = 1  # the network has the others
        context.gop_size = max(1, round(fps * KEY_FRAME_S))
        context.qmin = context.qmax = QSCALE
        self._last = -1

    def add(self, image: NDArray[np.uint8], time_s: float) -> None:
        """Append a frame; one that is not later than the last is left out.

        Args:
            image: `(height, width, 3)` RGB.
            time_s: when it was taken, seconds after the first.

        Raises:
            OSError: when it cannot be written.
        """
        import av

        tick = round(time_s * TICKS)
        if tick <= self._last:
            return
        self._last = tick
        width, height = self._stream.width, self._stream.height
        frame = av.VideoFrame.from_ndarray(
            np.ascontiguousarray(image[:height, :width]), format="rgb24"
        )
        frame.pts, frame.time_base = tick, Fraction(1, TICKS)
        self._container.mux(self._stream.encode(frame))

    def close(self) -> None:
        """Finish the file.

        Raises:
            OSError: when it cannot be written.
        """
        container, self._container = self._container, None
        if container is None:
            return
        try:
            container.mux(self._stream.encode(None))
        finally:
            container.close()
