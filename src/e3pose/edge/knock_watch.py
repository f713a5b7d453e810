"""Check the cameras of a running edge for displacement a few times per second."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from e3pose.edge.knocks import MOVED_DEG, Knock, Observation, Votes, moved, observe, turned_deg
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.model.slot_record import SlotRecord

LOOK_S = 0.2  # views of a camera in between are left out
ASK_S = 1.0
ASKED = 3  # checks in a row that must find the same camera before it is reported


class KnockWatch:
    """Runs `knocks` on a live edge; `observe` is called on one thread, `knock` on any."""

    def __init__(self, rig: Rig) -> None:
        """Start without observations.

        Args:
            rig: the calibration of the edge.
        """
        self.rig = rig
        self.knock: Knock | None = None
        self._watch = Votes.begin(len(rig))
        self._observed_s = dict.fromkeys(range(len(rig)), -np.inf)
        self._observations: dict[int, list[Observation]] = {}  # since the last check
        self._ask_s = -np.inf
        self._answers: list[Knock | None] = [None] * ASKED

    def observe(self, record: SlotRecord, views: Mapping[int, Poses2D]) -> None:
        """Add a slot.

        Args:
            record: its people.
            views: by camera, its detections.
        """
        now_s = record.time_s
        for index, view in views.items():
            if now_s - self._observed_s[index] >= LOOK_S:
                self._observed_s[index] = now_s
                observation = Observation(now_s, view, record.poses, record.covariance_m2)
                self._observations.setdefault(index, []).append(observation)
        if now_s - self._ask_s >= ASK_S:
            self._ask_s = now_s
            self._watch, self._observations = observe(self._watch, self.rig, self._observations), {}
            self._answers = [*self._answers[1:], self._ask()]

    def _ask(self) -> Knock | None:
        degrees, least = turned_deg(self._watch)
        found, before = moved(degrees, least), self.knock
        if before is None or degrees[before.camera] < MOVED_DEG:
            return found
        # There is no evidence that it is back, and it makes others seem turned.
        same = found is not None and found.camera == before.camera
        return found if same else before

    def events(self) -> list[tuple[str, str, str | None]]:
        """Return the events since the last call: kind, message and camera."""
        before, answers = self.knock, self._answers
        cameras = {None if answer is None else answer.camera for answer in answers}
        if len(cameras) > 1:
            return []
        self.knock = answers[-1]
        if (before and before.camera) == (self.knock and self.knock.camera):
            return []
        events: list[tuple[str, str, str | None]] = []
        if before is not None:
            name = self.rig.camera_ids[before.camera]
            events.append(("camera-in-place", f"{name} stands as calibrated again", name))
        if self.knock is not None:
            name = self.rig.camera_ids[self.knock.camera]
            events.append(("camera-moved", f"{name} {moved_words(self.knock.degrees, name)}", name))
        return events


def moved_words(degrees: float, camera_id: str) -> str:
    """Return the message about a knocked camera, with the command that recalibrates it."""
    return (
        f"has moved: turned by {degrees:.1f} degrees or more; "
        f"`e3pose calibrate extrinsics SITE --only {camera_id}` recalibrates it"
    )
