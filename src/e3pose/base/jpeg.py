"""The size that a picture states, read before anybody decodes it."""

from __future__ import annotations

import re

from e3pose.base.errors import InputError

MAX_PIXELS = 4_000_000  # of a picture; a camera sends 960 pixels of width at most
# Passes over a progressive JPEG: encoders make ten or a few more, and each takes a decoder as long
# as a whole picture.
MOST_SCANS = 24
MOST_SEGMENTS = 1000  # files of cameras have some dozens
_MARKER = re.compile(rb"\xff+([^\xff\x00\xd0-\xd7])")  # other bytes after 0xff are of the pixels
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # markers of headers that have a size
SCAN = b"\xff\xda"  # the marker of a pass
_BARE, _END, _SCAN = {0x01, 0xD8}, 0xD9, SCAN[1]  # markers without a length; the end; of a pass
_PNG = b"\x89PNG\r\n\x1a\n"


def jpeg_size(data: bytes, most_pixels: int = MAX_PIXELS) -> tuple[int, int]:
    """Return the `(width, height)` that a JPEG states, pixels.

    Raises:
        InputError: when it is no JPEG, states more than `most_pixels`, or more passes than
            `MOST_SCANS`: they let 30 kB take a decoder 11 s.
    """
    at, size, scans = 2, None, 0
    for _ in range(MOST_SEGMENTS if data[:2] == b"\xff\xd8" else 0):
        if (marker := _MARKER.search(data, at)) is None or marker[1][0] == _END:
            break
        kind, at = marker[1][0], marker.end()
        if kind in _FRAMES:
            height, width = (int.from_bytes(data[i : i + 2], "big") for i in (at + 3, at + 5))
            size = check_size(width, height, most_pixels)
        scans += kind == _SCAN
        if scans > MOST_SCANS:
            raise InputError(f"picture: found more than {MOST_SCANS} scans, expected fewer")
        if kind not in _BARE:
            at += max(int.from_bytes(data[at : at + 2], "big"), 2)
    else:
        size = None
    if size is None:
        raise InputError(f"picture: found {len(data)} bytes that are no JPEG")
    return size


def check_picture(data: bytes, most_pixels: int) -> None:
    """Raise `InputError` for a JPEG or PNG that would take too much to decode."""
    if data[:2] == b"\xff\xd8":
        jpeg_size(data, most_pixels)
    elif data.startswith(_PNG):
        width, height = (int.from_bytes(data[i : i + 4], "big") for i in (16, 20))
        check_size(width, height, most_pixels)


def check_size(width: int, height: int, most_pixels: int) -> tuple[int, int]:
    """Return a size, pixels; raise `InputError` for none, or a larger one."""
    if not 0 < width * height <= most_pixels:
        expected = f"1 to {most_pixels / 1e6:.0f} million"
        raise InputError(f"picture: found {width} x {height} pixels, expected {expected}")
    return width, height
