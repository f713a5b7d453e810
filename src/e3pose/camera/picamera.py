"""Cameras of Raspberry Pi boards: libcamera through picamera2, and the AI Camera, which detects.

Written from the interfaces of picamera2 0.3.38 and tested with stand-ins; none was run on a board.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.clock import Clock
from e3pose.base.errors import InputError
from e3pose.base.system import since_boot_ns
from e3pose.camera.base import LiveFrame, SourceSettings, taken_ns
from e3pose.detectors.base import poses_in_image
from e3pose.detectors.focus import boxes_of
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17, Skeleton

INSTALL = (
    "`sudo apt install python3-picamera2`, and a virtual environment made with "
    "--system-site-packages"
)
READ_S = 1.0
USUAL_SIZE, USUAL_FPS = (1280, 960), 30.0  # all of a 4:3 sensor
BUFFERS = 6  # a frame that somebody still looks at keeps one
SYNC = {"server": "Server", "client": "Client"}


class _Held:
    """A frame of libcamera, given back when nobody can look at it any more."""

    def __init__(self, request: Any) -> None:
        self.request, self.lock = request, threading.Lock()

    @cached_property
    def _array(self) -> NDArray[np.uint8]:
        array: NDArray[np.uint8] = self.request.make_array("main")
        return array

    def image(self) -> NDArray[np.uint8]:
        """Return it, `(height, width, 3)` RGB."""
        with self.lock:
            return self._array

    def __del__(self) -> None:
        self.request.release()


@dataclass(slots=True, eq=False)
class PicameraSource:
    """A camera of a Raspberry Pi; its image processor resizes.

    Attributes:
        number: of the camera.
        clock: of the camera program.
        fps: to ask for.
        size: `(width, height)` to ask for, pixels.
        sync: `server` or `client`, for cameras that expose together; empty for none.
    """

    number: int
    clock: Clock
    fps: float = USUAL_FPS
    size: tuple[int, int] = USUAL_SIZE
    sync: str = ""
    camera: Any = None

    def open(self) -> None:
        """See `LiveSource.open`."""
        try:
            import picamera2
        except ImportError as error:
            raise InputError("source picamera2", str(error), INSTALL) from None
        there = picamera2.Picamera2.global_camera_info()
        if not any(each["Num"] == self.number for each in there):
            listed = ", ".join(f"{each['Num']} ({each['Model']})" for each in there) or "none"
            raise InputError(f"source picamera2:{self.number}", "no such camera", f"of: {listed}")
        controls: dict[str, Any] = {"FrameRate": self.fps}
        if self.sync:
            from libcamera import controls as known

            controls["SyncMode"] = getattr(known.rpi.SyncModeEnum, SYNC[self.sync])
        try:
            self.camera = picamera2.Picamera2(self.number)
            # Of libcamera's names BGR888 is the one whose bytes are red, green, blue.
            main = {"size": self.size, "format": "BGR888"}
            asked = self.camera.create_video_configuration(
                main=main, controls=controls, buffer_count=BUFFERS
            )
            self.camera.configure(asked)
            self.camera.start()
        except (RuntimeError, IndexError, OSError) as error:
            self.close()
            raise InputError(
                f"source picamera2:{self.number}", str(error)[:200], "a camera that is free"
            ) from None
        self.size = tuple(self.camera.camera_configuration()["main"]["size"])

    def read(self) -> LiveFrame | None:
        """See `LiveSource.read`."""
        found = self.take()
        if found is None:
            return None
        held, captured_ns, _ = found
        return LiveFrame(captured_ns, self.size, held.image)

    def take(self) -> tuple[_Held, int, dict[str, Any]] | None:
        """Return the next frame, its capture time, and its metadata by libcamera."""
        if self.camera is None:
            return None
        try:
            request = self.camera.capture_request(wait=READ_S)
        except TimeoutError:
            return None
        held, said = _Held(request), request.get_metadata()
        if duration_us := said.get("FrameDuration"):
            self.fps = 1e6 / duration_us
        # libcamera counts from the boot of the machine, sleep included.
        age_ns = since_boot_ns() - said.get("SensorTimestamp", 0)
        return held, taken_ns(self.clock.now_ns(), age_ns), said

    def close(self) -> None:
        """See `LiveSource.close`."""
        camera, self.camera = self.camera, None
        if camera is not None:
            camera.close()


# The AI Camera (IMX500): HigherHRNet on the sensor, 288 x 384, about 11 a second.

MODEL = Path("/usr/share/imx500-models/imx500_network_higherhrnet_coco.rpk")
MODELS = "`sudo apt install imx500-all`"
SENSOR_PX = (4056, 3040)  # its regions of interest are in these
MAP_PX = (192, 144)  # of the network's heat maps: where a keypoint is, row after row
SENSOR_FPS, SENSOR_SIZE = 11.0, (640, 480)
# After a change of the region so many frames may still be of the one before.
SETTLING = 3
LOOSE = 2  # definition: times as wide as wanted, at which people have half as many pixels
# Share of the sensor's side: a smaller region has hardly more pixels than the network's input.
LEAST_REGION = 0.25
# Of picamera2's demonstration program, and of Newell et al. 2017.
MIN_SCORE, TAG_REACH = 0.3, 1.0
LEAST_KEYPOINTS = 3
# Whose tags are surest first: head, trunk, arms, legs (Newell et al. 2017).
ORDER = (0, 1, 2, 3, 4, 5, 6, 11, 12, 7, 8, 9, 10, 13, 14, 15, 16)


@dataclass(eq=False)
class SensorSource(PicameraSource):
    """An AI Camera: poses with each frame, in the whole image or where people are expected."""

    fps: float = SENSOR_FPS
    size: tuple[int, int] = SENSOR_SIZE
    model: Path = MODEL
    skeleton: Skeleton = COCO17
    detector: str = "imx500"
    _device: Any = None
    _region: tuple[int, int, int, int] = (0, 0, *SENSOR_PX)  # left, top, width, height
    _settling: int = 0

    def open(self) -> None:
        """See `LiveSource.open`; the network goes to the sensor, which takes a minute once."""
        if not self.model.exists():
            raise InputError("source imx500", f"no {self.model}", MODELS)
        try:
            from picamera2.devices import IMX500
        except ImportError as error:
            raise InputError("source imx500", str(error), INSTALL) from None
        try:
            self._device = IMX500(str(self.model))  # before the camera is opened
        except (RuntimeError, OSError, StopIteration) as error:
            found = str(error)[:200] or "no AI Camera"
            raise InputError("source imx500", found, "an AI Camera that is plugged in") from None
        self.number = self._device.camera_num
        super().open()
        self._set((0, 0, *SENSOR_PX))

    def read(self) -> LiveFrame | None:
        """See `LiveSource.read`; frames without poses are left out."""
        found = self.take()
        if found is None:
            return None
        held, captured_ns, said = found
        outputs = self._device.get_outputs(said)
        if self._settling or outputs is None:
            self._settling = max(self._settling - 1, 0)
            return None
        poses = partial(self._poses, outputs, self._region, said["ScalerCrop"])
        return LiveFrame(captured_ns, self.size, held.image, poses=poses)

    def expect(self, expected: ExpectedView | None) -> None:
        """See `SteeredSource.expect`; the region stays while it shows everybody large enough."""
        wanted = region_of(expected, self.size)
        if expected is not None and self._region[2] / LOOSE < wanted[2] < SENSOR_PX[0]:
            places = np.clip(expected.keypoints_px / self.size, 0, 1) * SENSOR_PX - self._region[:2]
            if not ((places < 0) | (places > self._region[2:])).any():
                return
        if wanted != self._region:
            self._set(wanted)

    def _set(self, region: tuple[int, int, int, int]) -> None:
        self._device.set_inference_roi_abs(region)
        self._region, self._settling = region, SETTLING

    def _poses(
        self,
        outputs: list[NDArray[Any]],
        region: tuple[int, int, int, int],
        crop: tuple[int, int, int, int],
    ) -> Poses2D:
        shapes = {np.shape(each) for each in outputs}
        if len(outputs) != 3 or len(shapes) != 1 or next(iter(shapes))[-1] != len(self.skeleton):
            raise InputError(f"{self.model}", f"outputs {sorted(shapes)}", "3 of (people, 17)")
        share, scores = people_of(*outputs)
        sensor = share * region[2:] + region[:2]
        image = (sensor - crop[:2]) / crop[2:] * self.size
        return poses_in_image(image - 0.5, scores, self.size)


def region_of(expected: ExpectedView | None, size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return the region of the sensor with the people who are expected, in its shape.

    Args:
        expected: who is expected, pixels of the image; None for the whole sensor.
        size: `(width, height)` of the image.

    Returns:
        Left, top, width, height in pixels of the sensor.
    """
    if expected is None or not (found := boxes_of(expected, size))[1].any():
        return (0, 0, *SENSOR_PX)
    boxes = found[0][found[1]] / (*size, *size) * (*SENSOR_PX, *SENSOR_PX)
    low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
    share = np.clip(((high - low) / SENSOR_PX).max(), LEAST_REGION, 1.0)
    width, height = wide = np.ceil(share * np.array(SENSOR_PX)).astype(int)
    left, top = np.clip(((low + high - wide) / 2).astype(int), 0, SENSOR_PX - wide)
    return int(left), int(top), int(width), int(height)


def people_of(
    tags: NDArray[Any], places: NDArray[Any], scores: NDArray[Any]
) -> tuple[Floats, Floats]:
    """Return the people of a HigherHRNet, keypoints grouped by their tags.

    Associative embedding (Newell et al. 2017): the keypoints of a person have similar tags. Each
    kind of joint goes to the people found so far, nearest tags first; what is near to none begins
    another person.

    Args:
        tags: `(num_found, num_joints)`.
        places: likewise, of each in `MAP_PX`, row after row.
        scores: likewise, in [0, 1].

    Returns:
        `(num_persons, num_joints, 2)` shares of the input's width and height, NaN where not found,
        and `(num_persons, num_joints)` scores, 0 there.
    """
    people: list[dict[int, int]] = []  # joint to the row of its keypoint
    for joint in ORDER:
        found = np.flatnonzero(scores[:, joint] > MIN_SCORE).tolist()
        means = [np.mean([tags[row, j] for j, row in person.items()]) for person in people]
        pairs = sorted(
            (abs(tags[row, joint] - mean), row, number)
            for row in found
            for number, mean in enumerate(means)
        )
        free, left = {*range(len(people))}, {*found}
        for apart, row, number in pairs:
            if apart < TAG_REACH and row in left and number in free:
                people[number][joint] = row
                left.discard(row)
                free.discard(number)
        people += [{joint: row} for row in sorted(left)]
    people = [person for person in people if len(person) >= LEAST_KEYPOINTS]
    keypoints = np.full((len(people), scores.shape[1], 2), np.nan)
    sure = np.zeros((len(people), scores.shape[1]))
    for number, person in enumerate(people):
        for joint, row in person.items():
            y, x = divmod(int(places[row, joint]), MAP_PX[0])
            keypoints[number, joint] = (np.array((x, y)) + 0.5) / MAP_PX
            sure[number, joint] = scores[row, joint]
    return keypoints, sure


def make_picamera(asked: SourceSettings) -> PicameraSource:
    """Return the camera of `picamera2:NUMBER`, or `picamera2:NUMBER?sync=server`."""
    number, _, query = asked.name.partition("?")
    options = dict(parse_qsl(query))
    sync = options.pop("sync", "")
    if not (number.isascii() and number.isdigit()) or options or sync not in ("", *SYNC):
        expected = "picamera2:0, or picamera2:0?sync=server and picamera2:0?sync=client"
        raise InputError("source", repr(f"picamera2:{asked.name}"[:80]), expected)
    fps, size = asked.fps or USUAL_FPS, asked.size or USUAL_SIZE
    return PicameraSource(int(number), asked.clock, fps, size, sync)


def make_sensor(asked: SourceSettings) -> SensorSource:
    """Return the AI Camera of `imx500:0`."""
    if asked.name != "0":
        raise InputError("source", repr(f"imx500:{asked.name}"[:80]), "imx500:0, one per board")
    fps, size = min(asked.fps or SENSOR_FPS, SENSOR_FPS), asked.size or SENSOR_SIZE
    return SensorSource(0, asked.clock, fps, size)
