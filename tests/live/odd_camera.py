"""A camera that says far too much, most of it nonsense: `odd_camera.py CAMERA ENDPOINT KEYS`."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from threading import Event

from e3pose.wire.access import Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import certificates_in
from e3pose.wire.network import open_network

camera_id, endpoint, keys = sys.argv[1:]
link = Link("camera", "lab", read_endpoint(endpoint), certificates_in(Path(keys), "camera"))
transport, over = open_network(link), Event()
signal.signal(signal.SIGTERM, lambda *_: over.set())
transport.be_present(f"e3pose/lab/camera/{camera_id}/alive")
messages = (b"garbage", b"\x92\x01\x91\xa4view", b"x" * 200_000, b"")
while not over.wait(0.001):  # or the session may not get to learn that anybody subscribes
    for message in messages:
        for what in ("view", "heartbeat", "hello"):
            transport.publish(f"e3pose/lab/camera/{camera_id}/{what}", message)
transport.close()
