"""The size that a JPEG states, read before a browser decodes it."""

from __future__ import annotations

from e3pose.base.errors import InputError

MAX_PIXELS = 4_000_000  # of a picture; a camera sends 960 pixels of width at most
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # markers of headers that have a size
_BARE = {0x01, *range(0xD0, 0xD9)}  # markers without a length


def jpeg_size(data: bytes) -> tuple[int, int]:
    """Return the `(width, height)` that a JPEG states, pixels.

    Raises:
        InputError: when it is no JPEG, or larger than a camera's picture can be.
    """
    at = 2
    while data[:2] == b"\xff\xd8" and at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker in _FRAMES:
            height, width = (int.from_bytes(data[i : i + 2], "big") for i in (at + 5, at + 7))
            if not 0 < width * height <= MAX_PIXELS:
                raise InputError(
                    f"picture: found {width} x {height} pixels, expected 1 to 4 million"
                )
            return width, height
        if marker == 0xFF:
            at += 1
        elif marker in _BARE:
            at += 2
        else:
            at += 2 + max(int.from_bytes(data[at + 2 : at + 4], "big"), 2)
    raise InputError(f"picture: found {len(data)} bytes that are no JPEG")
