"""Check the cameras of a running edge for displacement a few times per second."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from e3pose.edge.knocks import MOVED_DEG, Knock, Sight, Watch, look, moved, turned_deg
from e3pose.geometry.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.model.slot_record import SlotRecord

LOOK_S = 0.2  # views of a camera in between are left out
ASK_S = 1.0
ASKED = 3  # times in a row that the answer must be the same camera, before it is told


class KnockWatch:
    """Keeps what `knocks` remembers; `saw` on one thread, `knock` on any."""

    def __init__(self, rig: Rig) -> None:
        """Begin with nothing seen.

        Args:
            rig: the calibration that the edge works with.
        """
        self.rig = rig
        self.knock: Knock | None = None
        self._watch = Watch.begin(len(rig))
        self._looked_s = dict.fromkeys(range(len(rig)), -np.inf)
        self._sights: dict[int, list[Sight]] = {}  # since it was asked last
        self._ask_s = -np.inf
        self._answers: list[Knock | None] = [None] * ASKED

    def saw(self, record: SlotRecord, views: Mapping[int, Poses2D]) -> None:
        """Take in a slot.

        Args:
            record: its people.
            views: by camera, what the detectors found.
        """
        now_s = record.time_s
        for index, view in views.items():
            if now_s - self._looked_s[index] >= LOOK_S:
                self._looked_s[index] = now_s
                sight = Sight(now_s, view, record.poses, record.covariance_m2)
                self._sights.setdefault(index, []).append(sight)
        if now_s - self._ask_s >= ASK_S:
            self._ask_s = now_s
            self._watch, self._sights = look(self._watch, self.rig, self._sights), {}
            self._answers = [*self._answers[1:], self._ask()]

    def _ask(self) -> Knock | None:
        degrees, least = turned_deg(self._watch)
        found, before = moved(degrees, least), self.knock
        if before is None or degrees[before.camera] < MOVED_DEG:
            return found
        # Nothing says that it is back, and others seem turned because of it.
        same = found is not None and found.camera == before.camera
        return found if same else before

    def events(self) -> list[tuple[str, str, str | None]]:
        """Return what to tell, since the last call: kind, line and camera."""
        before, answers = self.knock, self._answers
        cameras = {None if answer is None else answer.camera for answer in answers}
        if len(cameras) > 1:
            return []
        self.knock = answers[-1]
        if (before and before.camera) == (self.knock and self.knock.camera):
            return []
        told: list[tuple[str, str, str | None]] = []
        if before is not None:
            name = self.rig.camera_ids[before.camera]
            told.append(("camera-in-place", f"{name} stands as calibrated again", name))
        if self.knock is not None:
            name = self.rig.camera_ids[self.knock.camera]
            told.append(("camera-moved", f"{name} {moved_words(self.knock.degrees, name)}", name))
        return told


def moved_words(degrees: float, camera_id: str) -> str:
    """Return what to say of a camera that was knocked, and the command that mends it."""
    return (
        f"has moved: turned by {degrees:.1f} degrees or more; "
        f"`e3pose calibrate extrinsics SITE --only {camera_id}` re-solves it"
    )
