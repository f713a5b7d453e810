"""Write images as a movie."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError

Image = NDArray[np.uint8]

# VP9 plays in every browser, and its encoder is BSD-licensed; that of H.264 in PyAV is GPL.
CODECS: dict[str, dict[str, str]] = {
    "libvpx-vp9": {"deadline": "realtime", "cpu-used": "8", "row-mt": "1", "crf": "30", "b": "0"},
    "mpeg4": {"qscale": "4"},
}
SUFFIXES = (".webm", ".mp4", ".mkv")


def write_movie(path: Path, images: Iterable[Image], fps: float) -> int:
    """Write RGB images as a movie, whole or not at all, and return how many there were.

    Args:
        path: `.webm`, `.mp4` or `.mkv`.
        images: `(height, width, 3)`, all of one size; an odd last row or column is cut off.
        fps: images per second.

    Raises:
        InputError: when there is no image, sizes differ, or the suffix is another.
    """
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: found suffix {path.suffix!r}, expected {', '.join(SUFFIXES)}")
    if not 0 < fps <= 1000:
        raise InputError(f"{path}: fps: found {fps}, expected a rate in (0, 1000]")
    iterator = iter(images)
    first = next(iterator, None)
    if first is None:
        raise InputError(f"{path}: found no image to write, expected at least one")
    height, width = (side - side % 2 for side in first.shape[:2])
    count = 0
    with atomic_file(path) as temporary, _encoder(temporary, width, height, fps) as encode:
        for image in chain([first], iterator):
            if image.shape != first.shape:
                raise InputError(
                    f"{path}: image {count}: found shape {image.shape}, expected {first.shape}"
                )
            encode(np.ascontiguousarray(image[:height, :width]))
            count += 1
    return count


@contextmanager
def _encoder(path: Path, width: int, height: int, fps: float) -> Iterator[Any]:
    import av

    rate = Fraction(fps).limit_denominator(1001)
    codec = next(name for name in CODECS if name in av.codecs_available)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate, options=CODECS[codec])
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        yield lambda image: container.mux(
            stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24"))
        )
        container.mux(stream.encode())
