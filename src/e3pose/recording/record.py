"""A recording in memory: what every camera's detector saw, when, and optionally the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton
from e3pose.recording.processor import ProcessorTime

MIN_FPS = 0.001  # slower is nothing that people do, and its times overflow
MAX_FPS = 1000.0
MAX_NAME = 200
MAX_SOURCE = 10_000
MAX_DETECTOR = 200
MAX_PEOPLE = 1000
MAX_BATTERY_WH = 1e6
# A recording may have lost views, but not so many that a few views stand for days of slots.
FREE_SLOTS = 10_000
SLOTS_PER_VIEW = 100


@dataclass(frozen=True, slots=True, eq=False)
class ViewSeries:
    """One camera's views over time, people of all frames in one array.

    Attributes:
        slots: `(num_frames,)` rising slot indices for which the camera has a view.
        times_s: `(num_frames,)` capture times since the recording began.
        starts: `(num_frames + 1,)` frame i owns people `starts[i]:starts[i + 1]`.
        keypoints_px: `(num_poses, num_joints, 2)` pixels in the real image, NaN where missing.
        scores: `(num_poses, num_joints)` in [0, 1], 0 where missing.
    """

    slots: NDArray[np.int64]
    times_s: Floats
    starts: NDArray[np.int64]
    keypoints_px: Floats
    scores: Floats

    @classmethod
    def from_views(
        cls,
        views: Sequence[Poses2D],
        slots: Sequence[int],
        times_s: Sequence[float],
        num_joints: int,
    ) -> ViewSeries:
        """Gather single views, in slot order, into a series."""
        counts = [len(view) for view in views]
        empty = Poses2D.empty(num_joints)
        return cls(
            np.asarray(slots, dtype=np.int64),
            np.asarray(times_s, dtype=np.float64),
            np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
            np.concatenate([empty.keypoints_px, *(view.keypoints_px for view in views)]),
            np.concatenate([empty.scores, *(view.scores for view in views)]),
        )

    def view(self, slot: int) -> Poses2D | None:
        """Return the camera's view in `slot`, or None without one."""
        frame = int(np.searchsorted(self.slots, slot))
        if frame == len(self.slots) or self.slots[frame] != slot:
            return None
        people = slice(int(self.starts[frame]), int(self.starts[frame + 1]))
        return Poses2D(self.keypoints_px[people], self.scores[people])


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Known 3D poses, for evaluation only: no stage may see them.

    Attributes:
        skeleton: the convention of the truth, which need not be the detector's.
        person_ids: one name per person, such as `actor1`.
        joints_m: `(num_slots, num_persons, num_joints, 3)` metres, NaN where not annotated.
    """

    skeleton: Skeleton
    person_ids: tuple[str, ...]
    joints_m: Floats

    @property
    def annotated(self) -> NDArray[np.bool_]:
        """`(num_slots, num_persons, num_joints)`: which joints are known."""
        return np.asarray(np.isfinite(self.joints_m).all(axis=-1))


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """The views of a rig over `num_slots` slots of `1 / fps` seconds.

    Attributes:
        name: a title for people.
        rig: the calibrated cameras.
        fps: slots per second.
        num_slots: length of the recording.
        skeleton: the convention of the keypoints.
        views: one series per camera, in rig order.
        truth: exact or annotated 3D poses, if any.
        truth_complete: whether everybody in the scene is annotated, so that false positives and AP
            can be scored; Shelf labels only some of the people present.
        scored_slots: half-open range of the slots that evaluation scores; all by default.
        videos: camera id to a file name in the recording's `videos` folder, or an absolute path.
        source: where it comes from and under what terms, for people.
        detector: what found the keypoints, by the name of a noise file (`model.noises`); empty
            where nobody said.
        processor: camera id to the processor time that was measured of it, if any.
        battery_wh: camera id to the energy in its battery at the start; others have a supply, or
            the battery that an evaluation assumes.
        dies_at_s: camera id to when it went for good and could no longer be reached.

    Raises:
        InputError: when shapes, counts or ids do not fit together.
    """

    name: str
    rig: Rig
    fps: float
    num_slots: int
    skeleton: Skeleton
    views: tuple[ViewSeries, ...]
    truth: Truth | None = None
    truth_complete: bool = True
    scored_slots: tuple[int, int] | None = None
    videos: Mapping[str, str] = field(default_factory=dict)
    source: str = ""
    battery_wh: Mapping[str, float] = field(default_factory=dict)
    dies_at_s: Mapping[str, float] = field(default_factory=dict)
    detector: str = ""
    processor: Mapping[str, ProcessorTime] = field(default_factory=dict)

    def __repr__(self) -> str:
        truth = "no truth" if self.truth is None else f"truth of {len(self.truth.person_ids)}"
        return (
            f"<Recording {self.name[:40]!r}: {plural(len(self.rig), 'camera')}, "
            f"{plural(self.num_slots, 'slot')} at {self.fps:g} fps, {truth}>"
        )

    def __post_init__(self) -> None:
        if not MIN_FPS <= self.fps <= MAX_FPS:  # NaN fails too
            raise InputError(
                f"recording: fps is {self.fps}, expected a rate from {MIN_FPS:g} to {MAX_FPS:g}"
            )
        if not 0 <= self.num_slots <= 100_000_000:
            raise InputError(f"recording: num_slots is {self.num_slots}, expected 0 to 100 million")
        if len(self.views) != len(self.rig):
            raise InputError(
                f"recording: has views of {len(self.views)} cameras, expected {len(self.rig)}"
            )
        for camera_id, series in zip(self.rig.camera_ids, self.views, strict=True):
            self._check_series(camera_id, series)
        if self.truth is not None and self.truth.joints_m.shape != (
            self.num_slots,
            len(self.truth.person_ids),
            len(self.truth.skeleton),
            3,
        ):
            raise InputError(
                f"recording: truth has shape {self.truth.joints_m.shape}, expected "
                "(num_slots, num_persons, num_joints, 3)"
            )
        if self.truth is not None:
            self._check_people(self.truth.person_ids)
        else:
            self._check_length()
        if self.scored_slots is not None:
            first, end = self.scored_slots
            if not 0 <= first <= end <= self.num_slots:
                raise InputError(
                    f"recording: scored_slots: found {first}..{end}, expected a half-open range "
                    f"within 0..{self.num_slots}"
                )
        _check_text("name", self.name, MAX_NAME, more="")
        _check_text("source", self.source, MAX_SOURCE, more="\n")
        _check_text("detector", self.detector, MAX_DETECTOR, more="")
        for camera_id, name in self.videos.items():
            self.rig.index(camera_id)
            _check_video(camera_id, name)
        for camera_id, energy_wh in self.battery_wh.items():
            self.rig.index(camera_id)
            _check_number(f"battery_wh.{camera_id}", energy_wh, MAX_BATTERY_WH)
        for camera_id, time_s in self.dies_at_s.items():
            self.rig.index(camera_id)
            _check_number(f"dies_at_s.{camera_id}", time_s, np.inf)

    @property
    def interval_s(self) -> float:
        """Length of a slot in seconds."""
        return 1.0 / self.fps

    def view(self, slot: int, camera: int) -> Poses2D | None:
        """Return the view of camera index `camera` in `slot`, or None for a lost one."""
        return self.views[camera].view(slot)

    def _check_length(self) -> None:
        views = max(len(series.slots) for series in self.views)
        limit = FREE_SLOTS + SLOTS_PER_VIEW * views
        if self.num_slots > limit:
            raise InputError(
                f"recording: num_slots: found {self.num_slots}, expected at most {limit} for "
                f"{views} views of a camera"
            )

    def _check_people(self, person_ids: tuple[str, ...]) -> None:
        if len(person_ids) > MAX_PEOPLE or len(set(person_ids)) != len(person_ids):
            raise InputError(
                f"recording: truth.person_ids: found {len(person_ids)} names of which "
                f"{len(set(person_ids))} differ, expected at most {MAX_PEOPLE} unique names"
            )
        for name in person_ids:
            if not 1 <= len(name) <= 64 or not name.isprintable():
                raise InputError(
                    f"recording: truth.person_ids: found {name[:64]!r}, "
                    "expected 1 to 64 printable characters"
                )

    def _check_series(self, camera_id: str, series: ViewSeries) -> None:
        frames = len(series.slots)
        where = f"recording: camera {camera_id}"
        if len(series.times_s) != frames or len(series.starts) != frames + 1:
            raise InputError(f"{where}: slots, times and starts have different lengths")
        if not np.isfinite(series.times_s).all():
            raise InputError(f"{where}: a time is not a number")
        people = len(series.scores)
        if (
            series.starts[0] != 0
            or series.starts[-1] != people
            or (np.diff(series.starts) < 0).any()
            or series.scores.shape != series.keypoints_px.shape[:-1]
        ):
            raise InputError(f"{where}: starts, keypoints and scores do not fit together")
        if (np.diff(series.slots) <= 0).any():
            raise InputError(f"{where}: slots are not increasing")
        if frames and not 0 <= series.slots[0] <= series.slots[-1] < self.num_slots:
            raise InputError(
                f"{where}: slots {series.slots[0]}..{series.slots[-1]} lie outside "
                f"0..{self.num_slots - 1}"
            )
        if series.keypoints_px.shape[1:] != (len(self.skeleton), 2):
            raise InputError(
                f"{where}: poses of {series.keypoints_px.shape[1]} joints, expected "
                f"{len(self.skeleton)} ({self.skeleton.name})"
            )


def _check_text(field: str, text: str, limit: int, more: str) -> None:
    # Control characters could rewrite the terminal that shows them.
    if len(text) > limit or not all(char.isprintable() or char in more for char in text):
        raise InputError(
            f"recording: {field}: found {len(text)} characters {text[:40]!r}, expected at most "
            f"{limit} printable ones"
        )


def _check_number(field: str, value: float, most: float) -> None:
    if not (np.isfinite(value) and 0 <= value <= most):
        most_words = "" if most == np.inf else f" to {most:.10g}"
        raise InputError(f"recording: {field}: found {value}, expected a number from 0{most_words}")


def _check_video(camera_id: str, name: str) -> None:
    path = PurePath(name)
    inside = len(path.parts) == 1 and name not in ("", ".", "..")
    if len(name) > 4096 or not name.isprintable() or not (path.is_absolute() or inside):
        raise InputError(
            f"recording: videos.{camera_id}: found {name[:80]!r}, expected the name of a file in "
            "the videos folder or an absolute path"
        )


def of_cameras(recording: Recording, camera_ids: Sequence[str]) -> Recording:
    """Return the recording as if there were only some of its cameras, in the order of the rig."""
    rows = [row for row, name in enumerate(recording.rig.camera_ids) if name in camera_ids]
    by_camera: dict[str, Any] = {
        item: {k: v for k, v in getattr(recording, item).items() if k in camera_ids}
        for item in ("videos", "battery_wh", "dies_at_s", "processor")
    }
    views = tuple(recording.views[row] for row in rows)
    return replace(recording, rig=recording.rig.subset(rows), views=views, **by_camera)


def with_places(recording: Recording) -> Recording:
    """Return the recording without the cameras that have no place, where others have one."""
    rig = recording.rig
    return (
        of_cameras(recording, [rig.camera_ids[i] for i in rig.placed_ones])
        if rig.unplaced
        else recording
    )
