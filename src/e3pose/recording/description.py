"""Describe a recording in numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from e3pose.model.camera import Camera
from e3pose.recording.record import Recording, ViewSeries


@dataclass(frozen=True, slots=True)
class CameraDescription:
    """One camera of a recording.

    Attributes:
        camera_id: its name.
        image_size: `(width, height)` in pixels.
        lens: `none`, `fisheye`, or the number of distortion coefficients.
        center_m: optical centre in the world.
        frames: views that exist.
        lost: slots without a view.
        mean_people: people per view; None without a view.
        max_people: most people in one view.
        missing_keypoints: share of missing keypoints in the detected poses; None without any.
        median_score: of the keypoints that are there; None if there is none.
        video: file name, if there is one.
    """

    camera_id: str
    image_size: tuple[int, int]
    lens: str
    center_m: tuple[float, float, float]
    frames: int
    lost: int
    mean_people: float | None
    max_people: int
    missing_keypoints: float | None
    median_score: float | None
    video: str | None


@dataclass(frozen=True, slots=True)
class TruthDescription:
    """The truth of a recording: its skeleton, and the slots in which each person is annotated."""

    skeleton: str
    complete: bool
    annotated_slots: int
    slots_of_person: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Description:
    """A recording in numbers."""

    name: str
    source: str
    detector: str
    fps: float
    num_slots: int
    duration_s: float
    skeleton: str
    scored_slots: tuple[int, int]
    cameras: tuple[CameraDescription, ...]
    truth: TruthDescription | None


def describe(recording: Recording) -> Description:
    """Count the content of a recording."""
    return Description(
        name=recording.name,
        source=recording.source,
        detector=recording.detector,
        fps=recording.fps,
        num_slots=recording.num_slots,
        duration_s=recording.num_slots * recording.interval_s,
        skeleton=recording.skeleton.name,
        scored_slots=recording.scored_slots or (0, recording.num_slots),
        cameras=tuple(
            _describe_camera(camera, series, recording)
            for camera, series in zip(recording.rig.cameras, recording.views, strict=True)
        ),
        truth=_describe_truth(recording),
    )


def _describe_camera(camera: Camera, series: ViewSeries, recording: Recording) -> CameraDescription:
    people = np.diff(series.starts)
    seen = series.scores > 0
    lens = "fisheye" if camera.fisheye else f"{len(camera.distortion)} coefficients"
    x, y, z = (float(value) for value in camera.center_m)
    return CameraDescription(
        camera_id=camera.camera_id,
        image_size=camera.image_size,
        lens=lens if len(camera.distortion) else "none",
        center_m=(x, y, z),
        frames=len(series.slots),
        lost=recording.num_slots - len(series.slots),
        mean_people=float(people.mean()) if len(people) else None,
        max_people=int(people.max(initial=0)),
        missing_keypoints=float(1 - seen.mean()) if seen.size else None,
        median_score=float(np.median(series.scores[seen])) if seen.any() else None,
        video=recording.videos.get(camera.camera_id),
    )


def _describe_truth(recording: Recording) -> TruthDescription | None:
    truth = recording.truth
    if truth is None:
        return None
    annotated = np.any(truth.annotated, axis=-1)  # (num_slots, num_persons)
    return TruthDescription(
        skeleton=truth.skeleton.name,
        complete=recording.truth_complete,
        annotated_slots=int(np.any(annotated, axis=1).sum()),
        slots_of_person=dict(
            zip(truth.person_ids, annotated.sum(axis=0).astype(int).tolist(), strict=True)
        ),
    )
