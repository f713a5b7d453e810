"""Detect people in calibrated videos and write a recording."""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from e3pose.base.atomic import atomic_folder, check_free
from e3pose.base.errors import InputError
from e3pose.base.lock import hold
from e3pose.base.threads import in_order
from e3pose.camera.look_times import LookTimes, taken
from e3pose.camera.orientation import turned
from e3pose.camera.provenance import save_provenance
from e3pose.camera.slots import Picture, SlotGrid, frames_in_slots
from e3pose.camera.source import Frame, ImageFolder, Source, open_sources
from e3pose.camera.unfinished import Unfinished
from e3pose.detectors import Detector, looks_at_a_time, threads_of
from e3pose.detectors.focus import check_feedback, detect_expected
from e3pose.model.camera import Rig
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton
from e3pose.pipeline import initial_state, step
from e3pose.recording import (
    Recording,
    ViewSeries,
    encode_view,
    read_series,
    save_recording,
)
from e3pose.recording.calibration.world import assumed_rig
from e3pose.recording.pairing import name_videos, pair_videos
from e3pose.recording.record import MAX_FPS, MIN_FPS
from e3pose.recording.videos import VIDEOS, begin_of, chapters_of
from e3pose.settings.limits import Rotation
from e3pose.settings.loop import WHOLE_EVERY, LoopSettings
from e3pose.settings.parts import make_pipeline

LEAD = 1  # slots
MAX_SLOTS = 100_000_000


@dataclass(frozen=True, slots=True)
class DetectSettings:
    """The frames to detect in, and the use of the videos.

    Attributes:
        fps: slots per second; None for the videos' common rate.
        every: detect in every so many slots of that rate only.
        start_s: where slot 0 lies, in seconds after the common clock's zero.
        max_slots: at most so many slots; None for all.
        rotations: for each camera, by how many degrees clockwise its images are turned for the
            detector, so that people are upright; 0 if not given.
        offsets_s: for each camera, when its video's first frame was taken on the common clock, in
            seconds; 0 if not given.
        as_stored: ignore the turn that videos ask players for.
        keep_videos: `refer` to the videos where they are, `link` or `copy` them into the recording.
        overwrite: replace a recording at the destination, and unfinished work of other settings.
        name: of the recording; that of its folder if None.
        feedback: detect in the parts of images in which people are expected, by what all cameras
            found before; needs cameras whose places are known.
        whole_every: with feedback, one of so many detections uses the full frame.
        threads: of the CPU, for all looks that go on at a time; None for all cores. With feedback
            one goes on at a time, else as many as the detector has room for.
    """

    fps: float | None = None
    every: int = 1
    start_s: float = 0.0
    max_slots: int | None = None
    rotations: Mapping[str, int] = field(default_factory=dict)
    offsets_s: Mapping[str, float] = field(default_factory=dict)
    as_stored: bool = False
    keep_videos: Literal["refer", "link", "copy"] = "refer"
    overwrite: bool = False
    name: str | None = None
    feedback: bool = False
    whole_every: int = WHOLE_EVERY
    threads: int | None = None

    def __post_init__(self) -> None:
        if self.fps is not None and not MIN_FPS <= self.fps <= MAX_FPS:
            raise InputError(
                f"fps: found {self.fps}, expected a rate from {MIN_FPS:g} to {MAX_FPS:g}"
            )
        if not 1 <= self.every <= 100_000:
            raise InputError(f"every: found {self.every}, expected 1 to 100000")
        if not (isfinite(self.start_s) and 0 <= self.start_s <= 1e7):
            raise InputError(f"start: found {self.start_s}, expected seconds, 0 or more")
        if self.max_slots is not None and not 1 <= self.max_slots <= MAX_SLOTS:
            raise InputError(f"max slots: found {self.max_slots}, expected 1 to {MAX_SLOTS}")
        for camera_id, degrees in self.rotations.items():
            if degrees not in get_args(Rotation):
                wanted = "0, 90, 180 or 270 degrees"
                raise InputError(f"camera {camera_id}: rotation", str(degrees), wanted)
        for camera_id, offset_s in self.offsets_s.items():
            if not abs(offset_s) <= 1e7:
                raise InputError(f"camera {camera_id}: offset: found {offset_s}, expected seconds")


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """Where the loop runs, see `settings.parts.Place`.

    Attributes:
        rig: the cameras.
        skeleton: of the detector.
        interval_s: seconds per slot.
        detector: name of the network.
        source: nothing, as `detector` says it.
    """

    rig: Rig
    skeleton: Skeleton
    interval_s: float
    detector: str
    source: str = ""


class _Film:
    """One camera: the detections of an earlier run, then its video."""

    def __init__(
        self,
        camera_id: str,
        work: Unfinished,
        source: Source,
        grid: SlotGrid,
        offset_s: float,
        earlier: Callable[[], ViewSeries],
        num_joints: int,
    ) -> None:
        self.last = work.last_slot(camera_id, num_joints)
        self._earlier = earlier() if self.last >= 0 else None
        begin_s = max(0.0, grid.video_time_s(self.last + 1, offset_s))
        ended = work.damage(camera_id) is not None
        frames: Iterator[tuple[int, float, Picture]] = iter(())
        if not ended:
            frames = frames_in_slots(source.frames(begin_s), grid, offset_s, self.last + 1)
        self._frames, self.next = frames, next(frames, None)

    def earlier(self, slot: int) -> Poses2D | None:
        """Return the detections of an earlier run in a slot."""
        return None if self._earlier is None else self._earlier.view(slot)

    def frame(self, slot: int) -> tuple[float, Picture] | None:
        """Return time and frame of a slot; None without one."""
        if self.next is None or self.next[0] != slot:
            return None
        _, time_s, frame = self.next
        self.next = next(self._frames, None)
        return time_s, frame


def detect_together(
    work: Unfinished,
    grid: SlotGrid,
    sources: Mapping[str, Source],
    offsets_s: Mapping[str, float],
    room: Room,
    detectors: Mapping[str, Detector],
    times: Mapping[str, LookTimes],
    whole_every: int,
    earlier: Callable[[str], ViewSeries],
    report: Callable[[str, int], None],
) -> int:
    """Detect in every camera's video, with feedback from the slots before.

    Args:
        work: takes the lines; what it has already is not detected again.
        grid: the slots.
        sources: camera id to video, in the order of the rig.
        offsets_s: camera id to when its video's first frame was taken.
        room: where the loop runs.
        detectors: camera id to what finds the people.
        times: camera id to what takes the processor time of its looks.
        whole_every: one of so many detections uses the full frame.
        earlier: camera id to the lines that `work` has.
        report: called with a camera and the number of its slots that are done.

    Returns:
        Slots of all cameras that an earlier run had done.
    """
    settings = LoopSettings(policy="all", feedback=True, whole_every=whole_every, lead_slots=LEAD)
    pipeline = make_pipeline(room, settings)
    films = [
        _Film(
            name, work, source, grid, offsets_s.get(name, 0.0),
            lambda name=name: earlier(name), len(room.skeleton),  # type: ignore[misc]
        )
        for name, source in sources.items()
    ]  # fmt: skip

    def look(name: str, film: _Film, people: ExpectedView | None) -> Poses2D | None:
        """Return the people in a camera's frame of the slot; None without a frame."""
        if (here := film.frame(state.slot)) is None:
            return None
        with times[name].look():
            found = detect_expected(detectors[name], here[1].image, people)
        with work.path(name).open("ab", buffering=0) as file:
            file.write(encode_view(state.slot, here[0], found))
        report(name, state.slot + 1)
        return found

    state, online = initial_state(pipeline), np.ones(len(films), dtype=bool)
    expected: tuple[ExpectedView, ...] | None = None
    while any(film.next is not None or film.last >= state.slot for film in films):
        slot, views = state.slot, {}
        for index, (name, film) in enumerate(zip(sources, films, strict=True)):
            found = film.earlier(slot)
            if found is None:
                with times[name].awake():
                    found = look(name, film, None if expected is None else expected[index])
            if found is not None:
                views[index] = found
        state, record = step(pipeline, state, views, online)
        expected = record.expected
    for name, source in sources.items():
        if work.damage(name) is None:
            work.mark_done(name, source.damage)
    return sum(film.last + 1 for film in films)


SAME_RATE = 0.005  # relative; 29.97 and 30 frames per second are the same nominal rate


@dataclass(frozen=True, slots=True)
class CameraReport:
    """The result for one camera's video.

    Attributes:
        frames: slots with a view.
        people: 2D poses in all of them together.
        damage: what was wrong with the file, in words; empty if nothing was.
    """

    frames: int
    people: int
    damage: str


@dataclass(frozen=True, slots=True)
class DetectReport:
    """The result of `detect_videos`.

    Attributes:
        fps: slots per second.
        num_slots: length of the recording.
        cameras: one report per camera with a video.
        without_video: cameras of the rig that are not in the recording.
        resumed_slots: of all cameras together, slots that an interrupted run had done before.
    """

    fps: float
    num_slots: int
    cameras: Mapping[str, CameraReport]
    without_video: tuple[str, ...]
    resumed_slots: int


Progress = Callable[[int, int], None]  # slots of all cameras: done, in all (an estimate)


def partial_folder(dest: Path) -> Path:
    """Return the folder in which the work for `dest` stands until it is done."""
    dest = Path(os.path.abspath(dest))
    return dest.with_name(f"{dest.name}.partial")


def detect_videos(
    videos: Sequence[Path | str],
    rig: Rig | None,
    detector: Detector,
    dest: Path,
    settings: DetectSettings | None = None,
    detector_name: str = "",
    progress: Progress = lambda done, total: None,
) -> DetectReport:
    """Find the people in every camera's video and write a recording.

    Lines are on disk as soon as they are found, frame by frame, in `dest` + `.partial`; the same
    call continues an interrupted one. `dest` appears when everything is done.

    Args:
        videos: files or folders of numbered images, paired with cameras by `pair_videos`; or
            `CAMERA=path` strings. Folders need `settings.fps`, and the recording does not name
            them.
        rig: calibrated cameras. Those without a video are not in the recording. None names cameras
            after their videos; their lenses are assumed and their places unknown then.
        detector: finds the people.
        dest: the recording folder to make.
        settings: which frames to detect in; all by default.
        detector_name: of the detector, and after a space which weights these are, such as a
            checksum; work begun with others is not continued.
        progress: called after every frame with how many slots of all cameras are done, of about how
            many.

    Raises:
        InputError: naming the video, camera or setting that is wrong.
    """
    settings = settings or DetectSettings()
    check_free(dest, settings.overwrite)
    if settings.feedback and (rig is None or not rig.placed):
        found = "without camera positions"
        raise InputError("feedback", found, "--calibration with the positions of all cameras")
    if settings.feedback:
        check_feedback(detector, detector_name.partition(" ")[0])
    paths = name_videos(videos) if rig is None else pair_videos(videos, rig)
    settings = replace(settings, offsets_s={**_begins_s(paths), **settings.offsets_s})
    sizes = {} if rig is None else {c.camera_id: c.image_size for c in rig.cameras}
    sources = open_sources(paths, settings.fps, sizes, settings.as_stored)
    if rig is None:
        rig = assumed_rig({name: source.image_size for name, source in sources.items()})
    for option, chosen in (("offset", settings.offsets_s), ("rotation", settings.rotations)):
        for camera_id in chosen:
            try:
                rig.index(camera_id)
            except InputError as error:
                raise error.at(thing=option) from None
    seen_rig = rig.subset([rig.index(camera_id) for camera_id in sources])
    for camera_id, source in sources.items():
        _check_size(seen_rig, camera_id, source)
    grid = _grid(settings, sources)
    _check_any_slot(settings, sources, grid)
    folder = partial_folder(dest)
    folder.mkdir(parents=True, exist_ok=True)
    with hold(dest):
        identity = _identity(settings, seen_rig, sources, grid, detector, detector_name)
        work = Unfinished(folder, identity, restart=settings.overwrite)
        run = _Run(work, grid, settings, detector, sources, progress, detector_name)
        try:
            damages = run.detect_together(seen_rig) if settings.feedback else run.detect_each()
        except BaseException:
            if run.done == 0:
                work.remove()  # there is nothing to continue
            raise
        recording = _recording(settings.name or dest.name, run, seen_rig, damages)
        _finish(recording, dest, sources, settings, identity)
        work.remove()
    reports = {
        camera_id: CameraReport(len(series.slots), len(series.scores), damages[camera_id])
        for camera_id, series in zip(sources, recording.views, strict=True)
    }
    without = tuple(name for name in rig.camera_ids if name not in sources)
    return DetectReport(grid.fps, recording.num_slots, reports, without, run.resumed)


def _begins_s(paths: Mapping[str, Path]) -> dict[str, float]:
    """Return when videos of a live session begin after the first of them, by their names.

    Nothing unless all are such videos.
    """
    begins_ns = {camera_id: begin_of(path) for camera_id, path in paths.items()}
    known_ns = [begin_ns for begin_ns in begins_ns.values() if begin_ns is not None]
    if len(known_ns) < len(begins_ns):
        return {}
    first_ns = min(known_ns)
    return {name: ((ns or first_ns) - first_ns) / 1e9 for name, ns in begins_ns.items()}


class _Run:
    """Walks the videos one after the other, or slot by slot, appending a line per frame."""

    def __init__(
        self,
        work: Unfinished,
        grid: SlotGrid,
        settings: DetectSettings,
        detector: Detector,
        sources: Mapping[str, Source],
        progress: Progress,
        detector_name: str,
    ) -> None:
        self.work, self.grid, self.detector, self.progress = work, grid, detector, progress
        self.sources, self.offsets_s = sources, settings.offsets_s
        self.detectors = {
            name: turned(detector, settings.rotations.get(name, 0)) for name in sources
        }
        self.whole_every, self.detector_name = settings.whole_every, detector_name
        self.at_a_time = looks_at_a_time([detector], settings.threads)
        self.expected = dict(zip(sources, _expected(settings, sources, grid), strict=True))
        self.before = self.done = self.resumed = 0
        self.times = {camera_id: LookTimes() for camera_id in sources}

    def detect_each(self) -> dict[str, str]:
        """Detect in one video after the other; return the damage found in each."""
        return {camera_id: self._detect(camera_id) for camera_id in self.sources}

    def detect_together(self, rig: Rig) -> dict[str, str]:
        """Detect in all videos slot by slot, with feedback; return the damage found in each."""
        skeleton, reached = self.detector.skeleton, dict.fromkeys(self.sources, 0)
        room = Room(rig, skeleton, 1 / self.grid.fps, self.detector_name.partition(" ")[0])

        def report(camera_id: str, slots: int) -> None:
            reached[camera_id] = slots
            self.done = sum(reached.values())
            self.progress(self.done, max(self.done, sum(self.expected.values())))

        self.resumed = detect_together(
            self.work,
            self.grid,
            self.sources,
            self.offsets_s,
            room,
            self.detectors,
            self.times,
            self.whole_every,
            lambda camera_id: _series(self.work.path(camera_id), len(skeleton)),
            report,
        )
        return {camera_id: self.work.damage(camera_id) or "" for camera_id in self.sources}

    def _detect(self, camera_id: str) -> str:
        """Detect in the rest of one video; return the damage found in it."""
        source, offset_s = self.sources[camera_id], self.offsets_s.get(camera_id, 0.0)
        first = self.work.last_slot(camera_id, len(self.detector.skeleton)) + 1
        self.resumed += first
        self._report(camera_id, first)
        damage = self.work.damage(camera_id)
        if damage is not None:  # read to its end by an earlier run
            self._pass(camera_id)
            return damage
        begin_s = max(0.0, self.grid.video_time_s(first, offset_s))
        frames = frames_in_slots(source.frames(begin_s), self.grid, offset_s, first)
        detector, times = self.detectors[camera_id], self.times[camera_id]
        alone = self.at_a_time == 1
        # Beside others, nobody can tell the time of a look that is not all on its thread.
        counted = alone or threads_of(self.detector) == 1
        now_s = time.process_time if alone else time.thread_time

        def look(found: tuple[int, float, Picture]) -> tuple[int, float, Poses2D, float]:
            begun_s = now_s()
            poses = _look(detector, found[2])
            return found[0], found[1], poses, now_s() - begun_s

        with times.awake(), self.work.path(camera_id).open("ab", buffering=0) as file:
            for slot, time_s, poses, look_s in in_order(look, frames, self.at_a_time):
                if counted:
                    times.add(look_s)
                file.write(encode_view(slot, time_s, poses))
                self._report(camera_id, slot + 1)
        self.work.mark_done(camera_id, source.damage)
        self._pass(camera_id)
        return source.damage

    def _report(self, camera_id: str, slots: int) -> None:
        # A header may announce too few frames; the bar waits then, rather than run backwards.
        self.done = self.before + min(slots, max(1, self.expected[camera_id]))
        self.progress(self.done, sum(self.expected.values()))

    def _pass(self, camera_id: str) -> None:
        self._report(camera_id, self.expected[camera_id])
        self.before += self.expected[camera_id]


def _look(detector: Detector, picture: Picture) -> Poses2D:
    """Return the people in a picture, which gets the size of the network's input at once."""
    size_of = getattr(detector, "content_size", None)
    if size_of is None or not isinstance(picture, Frame):
        return detector.detect(picture.image)
    size = size_of(picture.size)
    if size[0] >= picture.size[0]:
        return detector.detect(picture.image)
    return detector.detect(picture.shrunk(size)).resized(np.divide(picture.size, size))


def _expected(settings: DetectSettings, sources: Mapping[str, Source], grid: SlotGrid) -> list[int]:
    """Return the number of slots of each camera's video, by its header."""
    return [
        grid.last_slot((source.num_frames - 1) / source.rate, settings.offsets_s.get(camera_id, 0))
        + 1
        for camera_id, source in sources.items()
    ]


def _check_any_slot(
    settings: DetectSettings, sources: Mapping[str, Source], grid: SlotGrid
) -> None:
    if not any(_expected(settings, sources, grid)):
        raise InputError(
            f"videos: none has a frame after start {settings.start_s:g} s, expected an earlier "
            "start or other offsets"
        )


def _check_size(rig: Rig, camera_id: str, source: Source) -> None:
    expected = rig.cameras[rig.index(camera_id)].image_size
    found = source.image_size
    if found == expected:
        return
    hint = ""
    if found == expected[::-1]:
        hint = "; the sides are swapped, " + (
            "the file asks players for a quarter turn that the calibration was made without; "
            "--as-stored ignores it"
            if source.turned
            else "the calibration may be of a video that players show turned"
        )
    raise InputError(
        f"{source.path}: image size: found {found[0]}x{found[1]}, expected "
        f"{expected[0]}x{expected[1]} as the calibration of camera {camera_id}{hint}"
    )


def _grid(settings: DetectSettings, sources: Mapping[str, Source]) -> SlotGrid:
    fps = settings.fps
    if fps is None:
        rates = {camera_id: source.rate for camera_id, source in sources.items()}
        fps = min(rates.values())
        if max(rates.values()) > fps * (1 + SAME_RATE):
            listed = ", ".join(f"{camera_id} {rate:g}" for camera_id, rate in rates.items())
            raise InputError(f"videos: frame rates differ ({listed}), pass --fps with a slot rate")
    return SlotGrid(fps / settings.every, settings.start_s, settings.max_slots)


def _identity(
    settings: DetectSettings,
    rig: Rig,
    sources: Mapping[str, Source],
    grid: SlotGrid,
    detector: Detector,
    detector_name: str,
) -> dict[str, str]:
    digest = hashlib.sha256()
    for camera in rig.cameras:
        digest.update(f"{camera.camera_id} {camera.image_size} {camera.fisheye}".encode())
        if camera.known_to is not None:
            digest.update(f"{camera.known_to}".encode())
        for array in (camera.K, camera.T_world_camera, camera.distortion):
            digest.update(array.tobytes())
    identity = {
        "model": detector_name or "detector",
        "skeleton": detector.skeleton.name,
        "calibration": digest.hexdigest()[:16],
        "slots per second": f"{grid.fps:.9g}",
        "start": f"{grid.start_s:.9g} s",
        "max slots": str(grid.max_slots),
    }
    if settings.as_stored:
        identity["turn of videos"] = "ignored"
    if settings.feedback:
        identity["feedback"] = f"whole looks every {settings.whole_every}"
    for camera_id, source in sources.items():
        size = sum(path.stat().st_size for path in chapters_of(source.path))
        identity[f"video of {camera_id}"] = f"{source.path.name} ({size} bytes)"
        identity[f"offset of {camera_id}"] = f"{settings.offsets_s.get(camera_id, 0.0):.9g} s"
        if degrees := settings.rotations.get(camera_id, 0):
            identity[f"rotation of {camera_id}"] = f"{degrees} degrees"
    return identity


def _recording(name: str, run: _Run, rig: Rig, damages: Mapping[str, str]) -> Recording:
    sources, skeleton = run.sources, run.detector.skeleton
    views = [_series(run.work.path(camera_id), len(skeleton)) for camera_id in sources]
    num_slots = max((int(series.slots[-1]) + 1 for series in views if len(series.slots)), default=0)
    files_seen = ", ".join(video.path.name for video in sources.values())
    source = f"Detected by {run.detector_name or 'a detector'} in {files_seen}."
    for camera_id, damage in damages.items():
        source += f" {sources[camera_id].path.name}: {damage}." if damage else ""
    files = {
        camera_id: str(video.path.resolve())
        for camera_id, video in sources.items()
        if not isinstance(video, ImageFolder)
    }
    return Recording(
        name,
        rig,
        run.grid.fps,
        num_slots,
        skeleton,
        tuple(views),
        videos=files,
        source=source,
        detector=run.detector_name.partition(" ")[0],
        processor=taken(run.times),
    )


def _series(path: Path, num_joints: int) -> ViewSeries:
    if path.stat().st_size == 0:
        return ViewSeries.from_views([], [], [], num_joints)
    return read_series(path, num_joints, MAX_SLOTS)


def _finish(
    recording: Recording,
    dest: Path,
    sources: Mapping[str, Source],
    settings: DetectSettings,
    identity: Mapping[str, str],
) -> None:
    rotations = {name: settings.rotations[name] for name in sources if name in settings.rotations}
    starts_s = {name: settings.start_s - settings.offsets_s.get(name, 0.0) for name in sources}
    names = dict(recording.videos)
    files: dict[str, Path] = {}  # by name in the recording
    if settings.keep_videos != "refer":
        for camera_id in names:
            chapters = chapters_of(sources[camera_id].path)
            marks = [""] if len(chapters) == 1 else [f"-{i + 1}" for i in range(len(chapters))]
            kept = [
                f"{camera_id}{m}{c.suffix.lower()}" for m, c in zip(marks, chapters, strict=True)
            ]
            files |= zip(kept, chapters, strict=True)
            names[camera_id] = "+".join(kept)
    with atomic_folder(dest, settings.overwrite, held=True) as folder:
        save_recording(replace(recording, videos=names), folder)
        save_provenance(folder, identity, starts_s, rotations, settings.as_stored)
        for name, file in files.items():
            (folder / VIDEOS).mkdir(exist_ok=True)
            if settings.keep_videos == "link":
                (folder / VIDEOS / name).symlink_to(file.resolve())
            else:
                shutil.copyfile(file, folder / VIDEOS / name)
