"""A network camera on loopback: single images over HTTP, at a rate of one's own.

A stream of this kind states no rate: whoever opens it takes 25 frames per second for nominal.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np


def jpeg(level: int) -> bytes:
    found, data = cv2.imencode(".jpg", np.full((48, 64, 3), level, dtype=np.uint8))
    assert found
    return bytes(data)


@contextmanager
def network_camera(fps: float, shown: Sequence[bytes] = ()) -> Iterator[str]:
    """Serve a camera that films so many frames per second; yield its URL.

    Args:
        fps: of it.
        shown: its images, again and again, which a test may change; else some of 64 x 48.
    """
    images, stop = shown or [jpeg(level) for level in (100, 140, 180)], threading.Event()

    class Camera(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            number = round(time.monotonic() * fps)  # all cameras film at the same moments
            try:
                while not stop.wait(max(number / fps - time.monotonic(), 0)):
                    image = images[number % len(images)]
                    head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(image)}"
                    self.wfile.write(head.encode() + b"\r\n\r\n" + image + b"\r\n")
                    number += 1
            except OSError:  # nobody watches any more
                return

        def log_message(self, format: str, *args: object) -> None:
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Camera)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/stream.mjpg"
    finally:
        stop.set()
        server.shutdown()
        server.server_close()
        thread.join()
