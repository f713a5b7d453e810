"""Detect again in the videos of a recording, with semantic feedback."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

from e3pose.base.errors import InputError
from e3pose.camera.look_times import LookTimes, taken
from e3pose.camera.orientation import turned
from e3pose.camera.provenance import Provenance, load_provenance
from e3pose.camera.slots import SlotReader
from e3pose.detectors import make_detector
from e3pose.detectors.focus import check_feedback, detect_expected
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.recording import ProcessorTime, Recording


class PixelViews:
    """Looks at the videos of a recording with a detector; slots must not fall.

    Attributes:
        detections_s: of each detection, its slot, camera, whether it was in a part of the image,
            and seconds.
    """

    def __init__(
        self,
        recording: Recording,
        detector: Any,
        folder: Path | None = None,
        provenance: Provenance = Provenance(),  # noqa: B008 - frozen
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Open the videos.

        Args:
            recording: with a video for every camera.
            detector: finds the people.
            folder: of the recording, for videos that stand in it.
            provenance: which time in each video is the recording's zero, and how its images are
                turned.
            clock: seconds, for the time of detections only.

        Raises:
            InputError: when a video is missing, or the detector finds other joints.
        """
        check_pixels(recording)
        if detector.skeleton != recording.skeleton:
            raise InputError(
                "detector",
                f"one of {detector.skeleton.name}",
                f"one of {recording.skeleton.name}, as the recording",
            )
        self._clock = clock
        self._detectors = [
            turned(detector, provenance.rotations.get(name, 0)) for name in recording.rig.camera_ids
        ]
        self._readers = [
            SlotReader(recording, camera, folder, provenance)
            for camera in range(len(recording.rig))
        ]
        self.detections_s: list[tuple[int, int, bool, float]] = []
        self._recording = recording
        self._times = {name: LookTimes() for name in recording.rig.camera_ids}

    def __call__(self, slot: int, camera: int, expected: ExpectedView | None) -> Poses2D | None:
        """Return the view of a camera in a slot; None where its video has no frame."""
        image = self._readers[camera].image(slot)
        if image is None:
            return None
        begun_s = self._clock()
        with self._times[self._recording.rig.camera_ids[camera]].look():
            poses = detect_expected(self._detectors[camera], image, expected)
        self.detections_s.append((slot, camera, expected is not None, self._clock() - begun_s))
        return poses

    def processor(self) -> dict[str, ProcessorTime]:
        """Return the processor time of these looks and of the recording's frames, by camera."""
        before, now = self._recording.processor, taken(self._times)
        return {
            c: replace(before[c], look_s=t.look_s, looks=t.looks)
            for c, t in now.items()
            if c in before
        }

    def summary(self) -> str:
        """Return how many detections were in parts of images, and how long detections took."""
        parts = [seconds for _, _, part, seconds in self.detections_s if part]
        wholes = [seconds for _, _, part, seconds in self.detections_s if not part]
        count = f"{len(parts)} of {len(self.detections_s)} in the part where people were expected"
        times = [
            f"{1000 * median(taken):.3g} ms {what}"
            for taken, what in ((parts, "each"), (wholes, "each in the whole image"))
            if taken
        ]
        return f"detections: {', '.join([count, *times])} (median, this machine)"


def check_pixels(recording: Recording) -> None:
    """Raise `InputError` unless every camera of a recording has a video."""
    lacking = [name for name in recording.rig.camera_ids if name not in recording.videos]
    if lacking:
        raise InputError(
            "feedback",
            f"no video of {', '.join(lacking)[:200]} in recording {recording.name[:80]}",
            "a recording that e3pose detect made, with its videos",
        )


def open_pixels(
    recording: Recording,
    folder: Path,
    model: str | None = None,
    threads: int | None = None,
    feedback: bool = False,
) -> PixelViews:
    """Return the detector of the videos of a stored recording.

    Args:
        recording: with videos.
        folder: where it is stored.
        model: a detector; by default the one that the recording names.
        threads: of the processor for the network; all cores by default.
        feedback: whether it is given the people expected in the image.

    Raises:
        InputError: when a video or the detector is missing, or has no use for feedback.
    """
    check_pixels(recording)
    name = model or recording.detector
    if not name:
        raise InputError("detector", "none named by the recording", "--detector NAME")
    detector = make_detector(name, threads=threads)
    if feedback:
        check_feedback(detector, name)
    return PixelViews(recording, detector, folder, load_provenance(folder))
