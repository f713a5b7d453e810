"""Keep the modelled charge of a battery without a gauge over restarts."""

from __future__ import annotations

import datetime
import json
import math
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from e3pose.base.atomic import write_file
from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError

FORMAT = "e3pose-battery"
VERSION = 1
MAX_BYTES = 4096
NEAR_WH = 1e-9  # a battery of another capacity is another battery


def load_charge(path: Path, camera_id: str, capacity_wh: float) -> float | None:
    """Return the joules saved in a file; None without one, or for another battery.

    Args:
        path: of the file.
        camera_id: whose battery it is.
        capacity_wh: of the battery that is there now.

    Raises:
        InputError: when the file is damaged, or of another camera.
    """
    if not path.exists():
        return None
    try:
        found: Any = json.loads(read_bytes(path, MAX_BYTES))
        if (found["format"], found["version"]) != (FORMAT, VERSION):
            raise ValueError
        camera, held_wh, left_j = found["camera"], float(found["battery_wh"]), found["left_j"]
        left_j = float(left_j)
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError):
        raise InputError(f"{path}: expected format {FORMAT!r}, version {VERSION}") from None
    if camera != camera_id:
        raise InputError(f"{path}: found camera {str(camera)[:40]!r}, expected {camera_id}")
    if not (math.isfinite(left_j) and 0 <= left_j <= held_wh * 3600 * (1 + NEAR_WH)):
        raise InputError(f"{path}: left_j: found {left_j:g}, expected 0 to {held_wh * 3600:g}")
    return left_j if abs(held_wh - capacity_wh) <= NEAR_WH * capacity_wh else None


def save_charge(path: Path, camera_id: str, capacity_wh: float, left_j: float) -> None:
    """Write the file, whole or not at all; raise `InputError` where that cannot be."""
    table = {
        "format": FORMAT,
        "version": VERSION,
        "camera": camera_id,
        "battery_wh": capacity_wh,
        "left_j": round(left_j, 1),
        "made": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
    }
    write_file(path, json.dumps(table, indent=1) + "\n", private=True)


class ChargeFile:
    """The charge of a battery without a gauge, which never increases.

    A battery that was charged or changed is one that nobody here can see: whoever did it deletes
    the file, also while the camera runs.
    """

    def __init__(
        self, path: Path | None, camera_id: str, capacity_wh: float, report: Callable[[str], None]
    ) -> None:
        """Start with the saved charge, or full.

        Args:
            path: of the file; None to remember nothing.
            camera_id: whose battery it is.
            capacity_wh: what it holds.
            report: called with messages for operators.
        """
        self.full_j = capacity_wh * 3600
        self._path, self._camera_id, self._capacity_wh = path, camera_id, capacity_wh
        self._report, self._written, self._failed = report, False, False
        self._lock = threading.Lock()  # never held while something is written
        try:
            left_j = None if path is None else load_charge(path, camera_id, capacity_wh)
        except InputError as error:
            report(f"{error}: assuming a full battery")
            left_j = None
        self.left_j = self.full_j if left_j is None else left_j

    def spend(self, spent_j: float) -> float:
        """Subtract the energy drawn; return the remaining joules."""
        with self._lock:
            self.left_j = max(self.left_j - spent_j, 0.0)
            return self.left_j

    def keep(self) -> None:
        """Save the charge, or start with a full battery if the file was deleted."""
        if self._path is None:
            return
        if self._written and not self._path.exists():
            self._report(f"{self._path} was deleted: assuming a full battery")
            with self._lock:
                self.left_j = self.full_j
        try:
            save_charge(self._path, self._camera_id, self._capacity_wh, self.left_j)
            self._written, self._failed = True, False
        except (InputError, OSError) as error:
            self._written = False
            if not self._failed:
                self._report(f"cannot save the battery charge: {error}")
            self._failed = True
