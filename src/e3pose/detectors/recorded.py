"""A detector that looks at no pixels: it plays back what another one saw."""

from __future__ import annotations

from e3pose.detectors.base import Image
from e3pose.errors import InputError
from e3pose.model.pose import Poses2D
from e3pose.recording import Recording


class Recorded:
    """One camera's views of a recording, a slot per call of `detect`.

    It is in no list of detectors, because it needs to know which camera it stands for.

    Args:
        recording: what was seen.
        camera_id: whose views to play.
        slot: the slot that the first call returns.

    Raises:
        InputError: when the rig has no such camera or the recording no such slot.
    """

    def __init__(self, recording: Recording, camera_id: str, slot: int = 0) -> None:
        self.skeleton = recording.skeleton
        self._series = recording.views[recording.rig.index(camera_id)]
        self._camera_id = camera_id
        self._num_slots = recording.num_slots
        self.seek(slot)

    def seek(self, slot: int) -> None:
        """Make the next call of `detect` return `slot`."""
        if not 0 <= slot <= self._num_slots:
            raise InputError(
                f"camera {self._camera_id}: slot {slot} is outside the recording of "
                f"{self._num_slots}"
            )
        self._slot = slot

    def detect(self, image: Image | None = None) -> Poses2D:
        """Return the next slot's view, empty if it was lost; `image` is not looked at.

        Raises:
            InputError: after the last slot.
        """
        if self._slot == self._num_slots:
            raise InputError(
                f"camera {self._camera_id}: the recording has ended after {self._num_slots} slots"
            )
        view = self._series.view(self._slot)
        self._slot += 1
        return Poses2D.empty(len(self.skeleton)) if view is None else view
