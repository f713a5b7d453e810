"""The frames of a GStreamer pipeline, through PyGObject."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.clock import Clock
from e3pose.base.errors import InputError
from e3pose.base.masking import masked
from e3pose.camera.base import LiveFrame, SourceSettings
from e3pose.camera.source import FALLBACK_RATE

INSTALL = (
    "`sudo apt install python3-gi gir1.2-gst-plugins-base-1.0 gstreamer1.0-plugins-good`, and a "
    "virtual environment made with --system-site-packages"
)
# The newest picture alone, as soon as it is there.
SINK = (
    "videoconvert ! video/x-raw,format=RGB ! appsink name=e3pose max-buffers=1 drop=true sync=false"
)
READ_NS = 1_000_000_000
WRITES = re.compile(r"!\s*(videoconvert\s*!\s*)?appsink[^!]*$")


@dataclass(slots=True, eq=False)
class PipelineSource:
    """A pipeline whose last element has pictures; an `appsink` at its end is replaced by ours."""

    pipeline: str
    clock: Clock
    fps: float = FALLBACK_RATE
    _running: Any = None
    _sink: Any = None

    def open(self) -> None:
        """See `LiveSource.open`."""
        try:
            import gi

            gi.require_version("Gst", "1.0")
            from gi.repository import GLib, Gst
        except (ImportError, ValueError) as error:
            raise InputError("source gstreamer", str(error), INSTALL) from None
        Gst.init(None)
        try:
            self._running = Gst.parse_launch(f"{WRITES.sub('', self.pipeline).strip()} ! {SINK}")
        except GLib.Error as error:
            raise self._error(error.message) from None
        self._sink = self._running.get_by_name("e3pose")
        began = self._running.set_state(Gst.State.PLAYING)
        if began == Gst.StateChangeReturn.FAILURE:
            why = self._why() or "does not start"
            self.close()
            raise self._error(why)

    def read(self) -> LiveFrame | None:
        """See `LiveSource.read`."""
        if self._running is None:
            return None
        sample = self._sink.emit("try-pull-sample", READ_NS)
        captured_ns = self.clock.now_ns()
        if sample is None:
            if why := self._why():
                self.close()
                raise self._error(why)
            return None
        shape = sample.get_caps().get_structure(0)
        width, height = shape.get_value("width"), shape.get_value("height")
        known, above, below = shape.get_fraction("framerate")
        self.fps = above / below if known and above and below else self.fps
        return LiveFrame(captured_ns, (width, height), lambda: _image(sample, width, height))

    def close(self) -> None:
        """See `LiveSource.close`."""
        running, self._running, self._sink = self._running, None, None
        if running is not None:
            from gi.repository import Gst

            running.set_state(Gst.State.NULL)

    def _why(self) -> str:
        """Return why the pipeline stopped; empty while it runs."""
        from gi.repository import Gst

        kinds = Gst.MessageType.ERROR | Gst.MessageType.EOS
        message = self._running.get_bus().pop_filtered(kinds)
        if message is None:
            return ""
        ended = message.type == Gst.MessageType.EOS
        return "ended" if ended else str(message.parse_error()[0].message)

    def _error(self, why: str) -> InputError:
        return InputError(f"source gstreamer:{masked(self.pipeline)[:80]}: {masked(why)[:200]}")


def _image(sample: Any, width: int, height: int) -> NDArray[np.uint8]:
    """Return the picture of a sample, `(height, width, 3)` RGB; its rows end at whole words."""
    from gi.repository import Gst

    buffer = sample.get_buffer()
    _, held = buffer.map(Gst.MapFlags.READ)
    try:
        rows = np.frombuffer(bytes(held.data), np.uint8)
    finally:
        buffer.unmap(held)
    stride = -(-3 * width // 4) * 4
    return rows[: stride * height].reshape(height, stride)[:, : 3 * width].reshape(height, width, 3)


def make_pipeline(asked: SourceSettings) -> PipelineSource:
    """Return the source of a pipeline."""
    return PipelineSource(asked.name, asked.clock)
