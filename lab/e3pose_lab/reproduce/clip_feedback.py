"""Real videos with all cameras, with and without feedback: what detections cost, and the error."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from e3pose.base.arrays import Floats
from e3pose.camera.detect import DetectSettings, detect_videos
from e3pose.detectors import make_detector
from e3pose.detectors.base import Image
from e3pose.detectors.focus import Part
from e3pose.detectors.weights import is_installed
from e3pose.estimate.smooth import SmoothSettings
from e3pose.evaluate.detect_again import PixelViews
from e3pose.evaluate.metrics import mean_errors_m
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.smoothed import smooth_poses
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17, Skeleton, convert
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording, load_recording
from e3pose.recording.calibration import load_rig
from e3pose.settings.loop import MAX_WHOLE_EVERY, WHOLE_EVERY
from e3pose.site.demo_clip import find_clip
from e3pose_lab.reproduce.sources import NETWORK, Sources

OTHER = "movenet-multipose"  # a reference that the network under test did not make
FPS, LEAD, WARMUP = 20.0, 2, 4
SAME_M = 0.5
WAYS = {  # feedback, and how often a whole image is looked at without it
    "SA": (False, WHOLE_EVERY),
    "SA + feedback, in parts": (True, WHOLE_EVERY),
    "SA + feedback, in whole images": (True, MAX_WHOLE_EVERY),
}


@dataclass(frozen=True, slots=True)
class FeedbackAsked:
    """How much of the videos.

    Attributes:
        slots: from the first.
        pipeline: that fuses.
    """

    slots: int
    pipeline: str = "paper"


@dataclass(frozen=True, slots=True)
class WayFigures:
    """One way to look.

    Attributes:
        look_ms: processor time of a detection.
        error_mm: mean distance from each reference, by the network that made it.
        found: share of the people of the reference of the network itself who are found.
    """

    look_ms: float
    error_mm: dict[str, float]
    found: float


class WholeImages:
    """A detector that looks at whole images and is told who is expected there (RSS 2021)."""

    def __init__(self, detector: Any) -> None:
        self.skeleton, self.detect = detector.skeleton, detector.detect
        self.person_px, self.long_side = detector.person_px, detector.long_side
        self.multiple, self._detector = detector.multiple, detector

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        """Look at the whole image instead; see `Focusing.detect_part`."""
        height, width = image.shape[:2]
        whole = Part(0, 0, width, height, self.long_side)
        found: Poses2D = self._detector.detect_part(image, whole, expected)
        return found


def clip_feedback(sources: Sources, asked: FeedbackAsked) -> dict[str, WayFigures]:
    """Return the figures of each of `WAYS` on the demo's videos."""
    detector: Any = make_detector(NETWORK, threads=1)
    names = [NETWORK, *([OTHER] if is_installed(OTHER) else [])]
    with tempfile.TemporaryDirectory(prefix="e3pose-") as folder:
        seen = {name: _detected(name, Path(folder) / name, asked.slots) for name in names}
        truth = {name: _reference(recording) for name, recording in seen.items()}
        found = {}
        for way, (feedback, whole_every) in WAYS.items():
            looking = WholeImages(detector) if whole_every == MAX_WHOLE_EVERY else detector
            views = PixelViews(seen[NETWORK], looking, clock=time.process_time)
            settings = ReplaySettings(
                pipeline=asked.pipeline, policy="all", lead_slots=LEAD, warmup_slots=WARMUP,
                feedback=feedback, whole_every=whole_every,
            )  # fmt: skip
            records = list(replay(seen[NETWORK], settings, read_view=views))[WARMUP + LEAD :]
            looks = [s for slot, _, _, s in views.detections_s if slot >= WARMUP + LEAD]
            errors = {n: _errors_mm(records, seen[NETWORK].skeleton, truth[n]) for n in names}
            people = sum(len(truth[NETWORK][record.slot]) for record in records)
            found[way] = WayFigures(
                1000 * float(np.mean(looks)),
                {name: float(np.mean(each)) for name, each in errors.items()},
                len(errors[NETWORK]) / max(people, 1),
            )
    return found


def _detected(name: str, folder: Path, slots: int) -> Recording:
    """Return the detections of a network in whole images."""
    clip = find_clip()
    assert clip is not None, "items say what they need"
    rig = load_rig(clip.calibration)
    videos = [f"{c}={v}" for c, v in zip(rig.camera_ids, clip.videos, strict=True)]
    detector = make_detector(name, threads=1)
    detect_videos(videos, rig, detector, folder, DetectSettings(FPS, max_slots=slots), name)
    return load_recording(folder)


def _reference(recording: Recording) -> dict[int, Floats]:
    """Return the people of each slot by the smoother over all views, `(num_people, 17, 3)`."""
    records = list(replay(recording, ReplaySettings(policy="all")))
    smooth = smooth_poses(records, recording.skeleton, recording.interval_s, SmoothSettings("rts"))
    return {record.slot: _coco17(record, recording.skeleton) for record in smooth}


def _errors_mm(
    records: Sequence[SlotRecord], skeleton: Skeleton, truth: dict[int, Floats]
) -> list[float]:
    """Return the mean error of each person who is found, in mm."""
    errors: list[float] = []
    for record in records:
        apart = mean_errors_m(_coco17(record, skeleton), truth[record.slot])
        rows, columns = linear_sum_assignment(np.minimum(apart, 2 * SAME_M))
        errors += [1000 * e for e in apart[rows, columns].tolist() if e < SAME_M]
    return errors


def _coco17(record: SlotRecord, skeleton: Skeleton) -> Floats:
    return convert(record.people.joints_m, record.people.scores, skeleton, COCO17)[0]
