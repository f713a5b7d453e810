"""Make an edge that is connected and yet useless leave its network and join it again."""

from __future__ import annotations

import faulthandler
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from e3pose.base.clock import Clock
from e3pose.base.errors import InputError, reason_of
from e3pose.base.private import file_mode, make_folder
from e3pose.base.system import open_new
from e3pose.edge.membership import Membership
from e3pose.edge.roster import SILENT_S, CameraState
from e3pose.edge.stall import CameraSigns, StallWatch, watch_for_stall
from e3pose.wire.messages import RESTING
from e3pose.wire.transport import Transport

MAX_FILES = 5  # of stacks; the oldest is replaced
MAX_BYTES = 256 * 1024


class Watchdog:
    """Looks at the cameras of an edge; for one thread.

    Attributes:
        prepare: returns what opens the network again; None lets the edge be.
        folder: where stacks are dumped; None for nowhere.
    """

    def __init__(
        self, membership: Membership, clock: Clock, report: Callable[[str, str], None]
    ) -> None:
        """Start without observations.

        Args:
            membership: of the edge.
            clock: the edge's.
            report: called with the kind and message of an event.
        """
        self.prepare: Callable[[], Callable[[], Transport]] | None = None
        self.folder: Path | None = None
        self._membership, self._clock, self._report = membership, clock, report
        self._watch = StallWatch()

    def look(
        self,
        cameras: Sequence[CameraState],
        views: NDArray[np.int64],
        due: NDArray[np.int64],
        slots: int,
    ) -> bool:
        """Look at the cameras, and rejoin if that is needed; return whether it was done.

        Args:
            cameras: `(num_cameras,)` their states.
            views: `(num_cameras,)` views that arrived, in time or late.
            due: `(num_cameras,)` views that were ordered in time, and are due.
            slots: for which orders were given so far.

        Raises:
            RuntimeError: when the network cannot be left or joined: the program must be restarted.
        """
        now_ns, sending_ns = self._clock.now_ns(), self._membership.sending_ns
        signs = camera_signs(cameras, views, due, now_ns)
        self._watch, why = watch_for_stall(self._watch, signs, slots, sending_ns, now_ns)
        if not why or self.prepare is None:
            return False
        self._report("stalled", f"{why}: rejoining the network; {self._dumped()}")
        try:
            self._membership.rejoin(self.prepare())
        except InputError as error:
            raise RuntimeError(f"cannot rejoin the network: {error}") from error
        self._report("rejoined", "the network was joined again")
        return True

    def _dumped(self) -> str:
        if self.folder is None:
            return "stacks of threads are not kept"
        try:
            return f"stacks of all threads are in {dump_stacks(self.folder, 'edge')}"
        except OSError as error:
            return f"stacks of threads cannot be written to {self.folder} ({reason_of(error)})"


def camera_signs(
    cameras: Sequence[CameraState],
    views: NDArray[np.int64],
    due: NDArray[np.int64],
    now_ns: int,
) -> list[CameraSigns]:
    """Return what an edge knows of its cameras.

    Args:
        cameras: `(num_cameras,)` their states.
        views: `(num_cameras,)` views that arrived, in time or late.
        due: `(num_cameras,)` views that were ordered in time, and are due.
        now_ns: the time.
    """
    signs = []
    for camera, arrived, ordered in zip(cameras, views.tolist(), due.tolist(), strict=True):
        beat, heard_ns = camera.beat, camera.heard_ns
        if beat is None or heard_ns is None:
            signs.append(CameraSigns(camera.present, heard_ns))
            continue
        fresh = camera.present and not beat.ends and now_ns - heard_ns <= SILENT_S * 1e9
        counted, speaks = (beat.session, beat.orders, beat.sent), beat.mode not in RESTING
        present, fresh = camera.present and speaks, fresh and speaks
        signs.append(CameraSigns(present, heard_ns, fresh, *counted, arrived, ordered))
    return signs


def dump_stacks(folder: Path, program: str) -> Path:
    """Write the stacks of all threads to a file of a folder; return the file.

    Args:
        folder: where the program's logs are; made if it does not exist.
        program: begins the file's name.

    Raises:
        OSError: when the file cannot be written.
    """
    make_folder(folder)
    places = [folder / f"{program}-stacks-{number}.txt" for number in range(1, MAX_FILES + 1)]
    path = min(places, key=lambda place: place.stat().st_mtime_ns if place.exists() else 0)
    path.unlink(missing_ok=True)
    handle = open_new(path, file_mode(folder))
    try:
        faulthandler.dump_traceback(handle, all_threads=True)
        os.ftruncate(handle, min(os.fstat(handle).st_size, MAX_BYTES))
    finally:
        os.close(handle)
    return path
