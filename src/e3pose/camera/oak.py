"""OAK cameras through depthai 3: frames, or the poses of a network that runs on the camera.

Written from the interfaces of depthai 3.12 and tested with stand-ins; none was run on a device.
"""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from functools import partial
from typing import Any
from urllib.parse import parse_qsl

import numpy as np
from numpy.typing import NDArray

from e3pose.base.clock import Clock
from e3pose.base.errors import InputError
from e3pose.camera.base import LiveFrame, LiveSource, SourceSettings
from e3pose.detectors.base import poses_in_image
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17, Skeleton

INSTALL = "`pip install 'depthai>=3.12,<4'`, on Linux with Luxonis' udev rule for USB"
READ = datetime.timedelta(seconds=1)
USUAL_SIZE, USUAL_FPS = (1280, 720), 30.0


@dataclass(slots=True, eq=False)
class OakSource:
    """The colour camera of an OAK.

    Attributes:
        device: its id, address or name; empty for the only one.
        clock: of the camera program.
        fps: to ask for.
        size: `(width, height)` to ask for, pixels.
    """

    device: str
    clock: Clock
    fps: float = USUAL_FPS
    size: tuple[int, int] = USUAL_SIZE
    _pipeline: Any = None
    _queue: Any = None

    def open(self) -> None:
        """See `LiveSource.open`."""
        try:
            import depthai
        except ImportError as error:
            raise InputError("source depthai", str(error), INSTALL) from None
        try:
            device = depthai.Device(self.device) if self.device else depthai.Device()
            self._pipeline = depthai.Pipeline(device)
            camera = self._pipeline.create(depthai.node.Camera).build()
            self._queue = self._output(depthai, camera).createOutputQueue(maxSize=1, blocking=False)
            self._pipeline.start()
        except RuntimeError as error:
            self.close()
            there = ", ".join(each.deviceId for each in depthai.Device.getAllAvailableDevices())
            expected = f"a free OAK; there is: {there or 'none'}"
            raise InputError(f"source depthai:{self.device}", str(error)[:200], expected) from None

    def _output(self, depthai: Any, camera: Any) -> Any:
        kind = depthai.ImgFrame.Type.RGB888i
        return camera.requestOutput(self.size, type=kind, fps=self.fps)

    def read(self) -> LiveFrame | None:
        """See `LiveSource.read`."""
        message = self._message(self._queue)
        if message is None:
            return None
        size = message.getWidth(), message.getHeight()
        return LiveFrame(self._captured_ns(message), size, partial(_image, message))

    def _message(self, queue: Any) -> Any:
        """Return the next message of a queue, waiting at most a second; None without one."""
        if self._pipeline is None:
            return None
        try:
            return queue.get(READ)
        except RuntimeError as error:  # of a device that was unplugged, or a queue that closed
            self.close()
            raise InputError(f"source depthai:{self.device}: {str(error)[:200]}") from None

    def _captured_ns(self, message: Any) -> int:
        import depthai

        age: datetime.timedelta = depthai.Clock.now() - message.getTimestamp()
        return self.clock.now_ns() - round(1e9 * max(age.total_seconds(), 0.0))

    def close(self) -> None:
        """See `LiveSource.close`."""
        pipeline, self._pipeline, self._queue = self._pipeline, None, None
        if pipeline is not None:
            pipeline.stop()
            pipeline.getDefaultDevice().close()


@dataclass(eq=False)
class OakPoses(OakSource):
    """An OAK that detects: a keypoint network of Luxonis' zoo, or an archive of one's own.

    Attributes:
        model: name in the zoo, or path of an archive; its keypoints are COCO-17.
    """

    model: str = ""
    skeleton: Skeleton = COCO17
    detector: str = "depthai"
    _images: Any = None

    def _output(self, depthai: Any, camera: Any) -> Any:
        # Stretched, so that shares of the network's input are shares of the image.
        stretch = depthai.ImgResizeMode.STRETCH
        network = self._pipeline.create(depthai.node.DetectionNetwork)
        network.build(camera, self.model, fps=self.fps, resizeMode=stretch)
        self._images = network.passthrough.createOutputQueue(maxSize=1, blocking=False)
        return network.out

    def read(self) -> LiveFrame | None:
        """See `LiveSource.read`."""
        found, shown = self._message(self._queue), self._message(self._images)
        if found is None or shown is None:
            return None
        size = shown.getWidth(), shown.getHeight()
        poses, image = partial(self._poses, found, size), partial(_image, shown)
        return LiveFrame(self._captured_ns(found), size, image, poses=poses)

    def _poses(self, found: Any, size: tuple[int, int]) -> Poses2D:
        people = [each.getKeypoints() for each in found.detections]
        joints = len(self.skeleton)
        if wrong := {len(each) for each in people} - {joints}:
            raise InputError(self.model, f"{wrong.pop()} keypoints", f"{joints}, as of COCO-17")
        rows = [
            [(p.imageCoordinates.x, p.imageCoordinates.y, p.confidence) for p in each]
            for each in people
        ]
        triples = np.array(rows, dtype=float).reshape(-1, joints, 3)
        return poses_in_image(triples[..., :2] * size - 0.5, triples[..., 2], size)


def _image(message: Any) -> NDArray[np.uint8]:
    """Return the picture of a message, `(height, width, 3)` RGB."""
    import depthai

    if message.getType() == depthai.ImgFrame.Type.RGB888i:
        return np.asarray(message.getFrame(), np.uint8)
    return np.ascontiguousarray(message.getCvFrame()[..., ::-1])


def make_oak(asked: SourceSettings) -> LiveSource:
    """Return the OAK of `depthai:ID`, or with its own network of `depthai:ID?model=NAME`."""
    device, _, query = asked.name.partition("?")
    options = dict(parse_qsl(query))
    model = options.pop("model", "")
    if options or (query and not model):
        expected = "depthai:ID, or depthai:ID?model=NAME"
        raise InputError("source", repr(f"depthai:{asked.name}"[:80]), expected)
    rest = asked.clock, asked.fps or USUAL_FPS, asked.size or USUAL_SIZE
    return OakPoses(device, *rest, model=model) if model else OakSource(device, *rest)
