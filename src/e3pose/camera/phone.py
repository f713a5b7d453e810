"""A phone as a source of frames: it opens a page of ours by https, and sends what its camera sees.

The phone keeps its page open and tries again each second, so that whoever reads the source next
(the set-up, a recording, the running site) gets its frames: nothing listens while nobody reads.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.base.clock import Clock
from e3pose.base.errors import InputError, reason_of
from e3pose.base.jpeg import jpeg_size
from e3pose.camera.base import LiveFrame
from e3pose.camera.frame_rate import FrameRate
from e3pose.camera.phone_file import load_phone, save_phone
from e3pose.camera.phone_server import PhoneServer
from e3pose.camera.source import FALLBACK_RATE

READ_S = 1.0
BIND_S = 3.0  # for the program that read it before to let go of its port
OLDEST_S = 2.0  # of a frame on its way: an earlier time is an error of the phone's clock


@dataclass(slots=True, eq=False)
class PhoneSource:
    """The frames of one phone, the newest alone.

    Attributes:
        path: of its file.
        clock: of the camera; frames have the time at which the phone took them, in this clock.
    """

    path: Path
    clock: Clock
    _server: PhoneServer | None = None
    _newest: LiveFrame | None = None
    _size: tuple[int, int] | None = None
    _last_ns: int = 0
    _nominal: float = FALLBACK_RATE
    _rate: FrameRate = field(default_factory=FrameRate)
    _came: threading.Condition = field(default_factory=threading.Condition)

    @property
    def fps(self) -> float:
        """See `LiveSource.fps`."""
        return self._nominal

    @property
    def port(self) -> int:
        """At which the phone's page is."""
        return load_phone(self.path).port

    def open(self) -> None:
        """See `LiveSource.open`."""
        phone, end_s = load_phone(self.path), time.monotonic() + BIND_S
        while self._server is None:
            try:
                self._server = PhoneServer(self, phone.listen, phone.port, self.path.parent)
            except OSError as error:
                if time.monotonic() > end_s:
                    why = reason_of(error).lower()
                    raise InputError(
                        f"source {self.path.name}: port {phone.port}: {why}; does another program "
                        "read this phone?"
                    ) from None
                time.sleep(0.1)

    def read(self) -> LiveFrame | None:
        """See `LiveSource.read`."""
        with self._came:
            self._came.wait_for(lambda: self._newest is not None, READ_S)
            newest, self._newest = self._newest, None
            return newest

    def close(self) -> None:
        """See `LiveSource.close`."""
        server, self._server, self._size = self._server, None, None
        if server is not None:
            server.close()

    # What follows is called on the server's threads.

    def join(self, code: str) -> str:
        """Return the secret of a phone that shows the code; raise `InputError` for another one."""
        with self._came:
            phone, secret = load_phone(self.path).taken(code, time.time())
            save_phone(self.path, phone)
            return secret

    def sends(self, secret: str) -> bool:
        """Return whether a secret is that of its phone."""
        return load_phone(self.path).sends(secret)

    def take(self, jpeg: bytes, taken_ns: int | None, nominal: float | None) -> float:
        """Take a frame.

        Args:
            jpeg: of it.
            taken_ns: when the phone took it, by the camera's clock as the phone knows it.
            nominal: frames per second that the phone's camera announces.

        Returns:
            Frames per second that came, measured.

        Raises:
            InputError: for what is no JPEG, or of another size than the first, in words for the
                phone.
        """
        try:
            size = jpeg_size(jpeg)
        except InputError as error:
            raise InputError(f"The {error}") from None
        with self._came:
            if self._size not in (None, size):
                raise InputError("The phone was turned: hold it as it was when it began")
            self._size = size
            now_ns = self.clock.now_ns()
            known = taken_ns is not None and 0 <= now_ns - taken_ns < OLDEST_S * 1e9
            captured_ns = taken_ns if taken_ns is not None and known else now_ns
            captured_ns = self._last_ns = max(captured_ns, self._last_ns + 1)
            if nominal is not None and 1 <= nominal <= 240:
                self._nominal = nominal
            self._rate.add(captured_ns)
            self._newest = LiveFrame(captured_ns, size, lambda: _decoded(jpeg, size))
            self._came.notify()
            return self._rate.hz(self._nominal)


def _decoded(jpeg: bytes, size: tuple[int, int]) -> Any:
    """Return a JPEG as RGB, `(height, width, 3)`; all black where it cannot be decoded."""
    import cv2

    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), flags)
    if image is None or image.shape[:2] != size[::-1]:
        return np.zeros((size[1], size[0], 3), np.uint8)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
