"""Write arriving keypoints as recordings of some minutes each, within bounded disk space."""

from __future__ import annotations

import shutil
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path

from e3pose.base.bounded import bytes_of
from e3pose.base.errors import InputError, reason_of
from e3pose.base.private import make_folder
from e3pose.base.quantities import plural
from e3pose.camera.session_videos import attach_videos, note_session
from e3pose.edge.gather import Arrival
from e3pose.edge.processor_times import ProcessorTimes
from e3pose.model.camera import Rig
from e3pose.model.skeleton import Skeleton
from e3pose.recording.videos import MAX_BYTES, PART_S, VIDEOS, part_of
from e3pose.recording.writer import PARTIAL, RecordingWriter, finish_interrupted

WRITE_S = 0.5
QUEUE_SLOTS = 2000
RETRY_S = 10.0  # after a disk that was full


@dataclass(frozen=True, slots=True)
class RecorderSettings:
    """Cameras to record, and the limits of the recordings.

    Attributes:
        folder: where recordings are written.
        site: its name, for the description.
        cameras: `(num_cameras,)` whether the views of each are kept.
        filmed: names of the cameras whose videos become part of the recordings.
        fps: slots per second of the scene.
        pace: seconds of the scene that pass in a second.
        skeleton: of the keypoints.
        detector: whose noise the keypoints have.
        part_s: length of one recording.
        max_bytes: of all recordings in the folder; the oldest are deleted first.
        rotations: by camera, degrees clockwise by which its images are turned for its detector.
    """

    folder: Path
    site: str
    cameras: Sequence[bool]
    fps: float
    pace: float
    skeleton: Skeleton
    detector: str
    part_s: float = PART_S
    max_bytes: int = MAX_BYTES
    filmed: Sequence[str] = ()
    rotations: Mapping[str, int] = field(default_factory=dict)

    @property
    def videos(self) -> Path:
        """The folder in which cameras on this machine leave their videos."""
        return self.folder / VIDEOS


class Recorder:
    """Writes on its own thread; `keep` returns at once."""

    def __init__(
        self, settings: RecorderSettings, rig: Rig, report: Callable[[str, str], None]
    ) -> None:
        """Finish the recording of an earlier run, and start the thread.

        Args:
            settings: what to record.
            rig: the cameras.
            report: called with the kind of an event and a line, from the recorder's thread.

        Raises:
            InputError: when the folder cannot be made.
        """
        self.settings, self.rig, self._report = settings, rig, report
        try:
            make_folder(settings.folder)
            self._recover()
        except OSError as error:
            raise InputError(f"record: {settings.folder}: {reason_of(error)}") from None
        self.dropped, self.processor = 0, ProcessorTimes(settings.fps * settings.pace)
        self._slots: deque[tuple[int, int, Mapping[int, Arrival]]] = deque()
        self._unflushed: deque[tuple[int, int, Mapping[int, Arrival]]] = deque()
        self._stop = threading.Event()
        self._writer: RecordingWriter | None = None
        self._first = (0, 0)  # slot and time of the recording's first
        self._problem = ""
        self._retry = 0
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    def keep(self, slot: int, time_ns: int, arrivals: Mapping[int, Arrival]) -> None:
        """Queue the views of a slot.

        Args:
            slot: which.
            time_ns: its middle, since 1970.
            arrivals: by camera.
        """
        if len(self._slots) >= QUEUE_SLOTS:
            self.dropped += 1
            return
        self._slots.append((slot, time_ns, arrivals))

    @property
    def waiting(self) -> int:
        """Number of slots queued and not yet written."""
        return len(self._slots)

    def close(self) -> None:
        """Write the queued slots and finish the recording."""
        self._stop.set()
        self._thread.join(timeout=10.0)

    def _work(self) -> None:
        stopping = False
        while not stopping:
            stopping = self._stop.wait(WRITE_S)
            try:
                if self._retry > 0 and not stopping:
                    self._retry -= 1
                    continue
                if self._problem:
                    self._recover()
                self._write()
                if self._problem:
                    lost, self.dropped = self.dropped, 0
                    more = f", {plural(lost, 'slot')} not recorded" if lost else ""
                    self._report("record-recovered", f"recording again{more}")
                self._problem = ""
            except (OSError, InputError) as error:
                self._fail(error)
        try:
            self._finish()
        except (OSError, InputError) as error:
            self._fail(error)

    def _recover(self) -> None:
        """Finish recordings that a full disk interrupted."""
        for part in finish_interrupted(self.settings.folder):
            self._attach(part)

    def _write(self) -> None:
        while self._slots:
            slot, time_ns, arrivals = self._slots[0]
            settings, writer = self.settings, self._writer
            part, first = (
                part_of(each, settings.fps, settings.part_s) for each in (slot, self._first[0])
            )
            if writer is not None and part != first:
                self._finish()
                writer = None
            if writer is None:
                self._first = slot, time_ns
                writer = self._writer = self._begin(time_ns)
            for index, arrival in arrivals.items():
                if settings.cameras[index]:
                    time_s = (arrival.captured_ns - self._first[1]) / 1e9 * settings.pace
                    writer.add(
                        self.rig.camera_ids[index], slot - self._first[0], time_s, arrival.poses
                    )
            self._unflushed.append(self._slots.popleft())
        if self._writer is not None:
            self._writer.flush()
        self._unflushed.clear()
        self._trim()

    def _begin(self, time_ns: int) -> RecordingWriter:
        settings = self.settings
        when = datetime.fromtimestamp(time_ns / 1e9, timezone.utc)
        name = when.strftime("%Y%m%dT%H%M%SZ")
        dest, number = settings.folder / name, 1
        while dest.exists() or dest.with_name(dest.name + PARTIAL).exists():
            dest, number = settings.folder / f"{name}-{number}", number + 1
        writer = RecordingWriter(
            dest, self.rig, settings.fps, settings.skeleton, settings.detector,
            f"Recorded live at the site {settings.site} from {when:%Y-%m-%d %H:%M:%S} UTC. "
            "Views of cameras that were not selected are missing.",
        )  # fmt: skip
        note_session(writer.folder, time_ns, settings.pace, settings.rotations)
        return writer

    def _finish(self) -> None:
        """Finish the current recording, if there is one."""
        writer, self._writer = self._writer, None
        took = self.processor.found()
        if writer is not None:
            writer.processor = took
        part = None if writer is None else writer.finish()
        self._unflushed.clear()
        if part is not None:
            self._attach(part)

    def _attach(self, part: Path) -> None:
        """Attach the cameras' videos to a recording; failure leaves it without videos."""
        if not self.settings.filmed:
            return
        try:
            attach_videos(part, self.settings.videos, self.settings.filmed)
        except (OSError, InputError) as error:
            self._report("record-trouble", f"no videos in {part.name}: {error}")

    def _trim(self) -> None:
        """Delete the oldest recordings beyond the space limit."""
        parts = recordings_in(self.settings.folder)
        sizes = {part: bytes_of(part) for part in parts}
        left = sum(sizes.values()) + bytes_of(self.settings.videos)
        left += self._writer.num_bytes if self._writer else 0
        for part in parts:
            if left <= self.settings.max_bytes:
                return
            shutil.rmtree(part, ignore_errors=True)
            left -= sizes[part]
        if left > self.settings.max_bytes and self._writer is not None:
            self._finish()  # it alone is larger: start another, so that it can be deleted

    def _fail(self, error: Exception) -> None:
        reason = reason_of(error)
        if not self._problem:
            self._report("record-trouble", f"not recording: {reason.lower()}")
        self._problem = reason
        self._retry = round(RETRY_S / WRITE_S)
        writer, self._writer = self._writer, None
        if writer is not None:
            with suppress(OSError, InputError):  # otherwise once there is room
                writer.finish()
        # What the disk may not have taken is written again, into the next recording.
        self._slots.extendleft(reversed(self._unflushed))
        self._unflushed.clear()


def recordings_in(folder: Path) -> list[Path]:
    """Return the finished recordings of a folder, oldest first."""
    return sorted(
        part
        for part in folder.iterdir()
        if (part / "recording.toml").is_file() and not part.name.endswith(PARTIAL)
    )
