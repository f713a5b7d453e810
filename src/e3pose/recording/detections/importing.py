"""Detections of other tools: find the files of each camera, and make a recording of them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import gcd
from pathlib import Path, PurePosixPath

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton, load_skeleton
from e3pose.recording import Recording
from e3pose.recording.calibration import load_calibration
from e3pose.recording.detections.forms import (
    HDF5,
    MAX_FILE_BYTES,
    SUFFIXES,
    Picture,
    Pictures,
    image_table,
    parse,
    read_pictures,
)
from e3pose.recording.detections.hdf5 import read_hdf5
from e3pose.recording.detections.layouts import Layout, choose_layout, named_layout
from e3pose.recording.detections.views import check_fps, poses_from_triples, series_from_frames
from e3pose.recording.pairing import has_word, pair_names
from e3pose.recording.videos import frame_number, frame_numbers

SHARE = 1.5  # keypoints within it are shares of the image, not pixels
PAST = 0.5  # shares below its negative are counted from the middle
PERCENT = 1.5  # scores above it are on another scale than 0 to 1
# A number so many times beyond the percentile is a broken one, which says nothing of the scale.
USUAL, FAR_BEYOND = 99, 2.0
NO_CAMERA = -1

Progress = Callable[[Sequence[Path]], Iterable[Path]]
People = list[dict[int, tuple[Floats, ...]]]  # per camera, by frame number


@dataclass(frozen=True, slots=True)
class ImportSettings:
    """Facts that the files themselves lack.

    Attributes:
        folders: camera id to the name of its folder or file, where names alone do not tell.
        images: COCO data set whose `images` names the image of an `image_id`.
        skeleton: order of the keypoints, where their count does not tell: a name or a file.
        score_scale: what scores are divided by; None for their highest where that is beyond 1.5.
        detector: what made them; empty if unknown.
        strict: refuse what could be left out.
    """

    folders: Mapping[str, str] = field(default_factory=dict)
    images: Path | None = None
    skeleton: str | None = None
    score_scale: float | None = None
    detector: str = ""
    strict: bool = False


@dataclass(eq=False)
class Reader:
    """Reads detections; one bad file or person costs that alone.

    Attributes:
        notes: what a user should know, in order.
    """

    source: Path
    rig: Rig
    settings: ImportSettings
    notes: list[str] = field(default_factory=list)
    _bad: list[str] = field(default_factory=list)

    def read(self, progress: Progress) -> tuple[Skeleton, list[dict[int, Poses2D]], int]:
        """Return the skeleton, per camera its views by frame number, and the step of numbers."""
        people, names = self._people(progress)
        seen = [person for camera in people for found in camera.values() for person in found]
        if not seen:
            why = f": {self._bad[0]}" if self._bad else ""
            raise InputError(f"{self.source}: found nobody, expected a person{why}")
        count = Counter(len(person) for person in seen).most_common(1)[0][0]
        others = sum(len(person) != count for person in seen)
        if others:
            self._leave_out(f"{plural(others, 'person', 'people')} without {count} keypoints")
        stack = np.stack([person for person in seen if len(person) == count])
        layout = self._layout(stack, names)
        scale, highest = self.settings.score_scale, usual_high(stack[..., 2])
        if scale is None and highest > PERCENT:
            scale = highest
            self.notes.append(f"scores go up to {highest:.3g}: divided by it (--score-scale)")
        divide_by = scale or 1.0
        places = stack[stack[..., 2] > 0][:, :2]
        shares = not usual_high(np.abs(places)) > SHARE
        signed = shares and usual_high(-places) > PAST
        if shares:
            what = "shares of the image" + " from -1 to 1" * signed
            self.notes.append(f"keypoints are {what}, taken times its size")
        frames: list[dict[int, Poses2D]] = []
        for index, camera in enumerate(people):
            size = np.array([*self.rig.cameras[index].image_size, 1.0])
            views: dict[int, Poses2D] = {}
            for frame, found in camera.items():
                fitting = [p for p in found if len(p) == count]
                triples = np.array(fitting, dtype=np.float64).reshape(-1, count, 3)
                triples = layout.of_skeleton(triples) / [1.0, 1.0, divide_by]
                if signed:
                    triples[..., :2] = np.where(triples[..., 2:] > 0, (triples[..., :2] + 1) / 2, 0)
                where = f"{self.source}: camera {self.rig.camera_ids[index]} frame {frame}"
                try:
                    views[frame] = poses_from_triples(triples * (size if shares else 1.0), where)
                except InputError as error:
                    self._leave_out(str(error))
            frames.append(views)
        if self._bad:
            self.notes.insert(0, f"left out {plural(len(self._bad), 'item')}: {self._bad[0]}")
        return layout.skeleton, frames, self._step(frames)

    def _people(self, progress: Progress) -> tuple[People, tuple[str, ...]]:
        """Return per camera who is in each frame, and the names of keypoints if files tell."""
        images: Mapping[object, str] = {}
        if self.settings.images is not None:
            path = self.settings.images
            try:
                images = image_table(parse(read_bytes(path, MAX_FILE_BYTES), path))
            except InputError as error:
                raise error.at(path) from None
        sources = self._sources()
        files = [(path, camera) for camera, paths in sources for path in paths]
        people: People = [{} for _ in self.rig.camera_ids]
        read: dict[int | None, list[tuple[Path, Pictures]]] = {}
        for path, (_, camera) in zip(progress([p for p, _ in files]), files, strict=True):
            try:
                is_hdf5 = path.suffix.lower() in HDF5
                pictures = read_hdf5(path) if is_hdf5 else read_pictures(path, images)
                read.setdefault(camera, []).append((path, pictures))
                for why in pictures.bad:
                    self._leave_out(f"{path}: {why}")
            except InputError as error:
                if len(files) == 1:
                    raise
                self._leave_out(str(error))
        for camera, found in read.items():
            self._place(people, camera, found)
        every = [pictures for found in read.values() for _, pictures in found]
        single = [picture for pictures in every for picture in pictures.pictures]
        named = any(picture.name is not None for picture in single)
        if named and not any(pictures.all_named for pictures in every):
            self._fill(people)
        names = next((pictures.names for pictures in every if pictures.names), ())
        return people, names

    def _sources(self) -> list[tuple[int | None, list[Path]]]:
        """Return the files of each camera; None for a file of several cameras."""
        source = self.source
        if source.exists() and not source.is_dir():  # a pipe is refused where it is read
            return [(0 if len(self.rig) == 1 else None, [source])]
        if not source.is_dir():
            raise InputError(f"{source}: found nothing, expected a folder or file of detections")
        entries = sorted(e for e in source.iterdir() if not e.name.startswith("."))
        folders = {e.name: _files(e) for e in entries if e.is_dir() and _files(e)}
        if not folders:
            folders = {e.name: [e] for e in _files(source)}
        paired, unpaired = pair_names(source, list(folders), self.rig.camera_ids,
                                      self.settings.folders)  # fmt: skip
        for name in unpaired:
            self._leave_out(f"{source / name}: belongs to no camera (--folder CAMERA={name})")
        lonely = [camera_id for camera_id in self.rig.camera_ids if camera_id not in paired]
        if lonely:
            self.notes.append(f"cameras without detections are left out: {', '.join(lonely)}")
            self.rig = self.rig.subset(
                [i for i, c in enumerate(self.rig.camera_ids) if c in paired]
            )
        return [(i, folders[paired[name]]) for i, name in enumerate(self.rig.camera_ids)]

    def _place(
        self, people: People, camera: int | None, found: Sequence[tuple[Path, Pictures]]
    ) -> None:
        """Give pictures their camera and frame number."""
        entries = [(path, picture) for path, pictures in found for picture in pictures.pictures]
        labels = [path.name if picture.name is None else picture.name for path, picture in entries]
        cameras = self._cameras(camera, entries, labels)
        for index in {*cameras} - {NO_CAMERA}:
            own = self._numbered([i for i, c in enumerate(cameras) if c == index], labels)
            texts = [label for i in own if isinstance(label := labels[i], str)]
            numbers = iter(frame_numbers([*map(_base, texts)]))
            for i in own:
                label = labels[i]
                number = next(numbers) if isinstance(label, str) else int(label)
                if number in people[index]:
                    raise InputError(
                        f"{entries[i][0]}: frame number {number} of camera "
                        f"{self.rig.camera_ids[index]} appears twice"
                    )
                people[index][number] = entries[i][1].people

    def _numbered(self, own: list[int], labels: Sequence[str | int]) -> list[int]:
        """Leave out what has no frame number, among others that have one."""
        odd: dict[int, str] = {}
        for i in own:
            if isinstance(label := labels[i], str):
                try:
                    frame_number(_base(label))
                except InputError as error:
                    odd[i] = str(error)
        if len(odd) < len(own):
            for why in odd.values():
                self._leave_out(f"{self.source}: {why}")
            own = [i for i in own if i not in odd]
        return own

    def _cameras(
        self,
        camera: int | None,
        entries: Sequence[tuple[Path, Picture]],
        labels: Sequence[str | int],
    ) -> list[int]:
        """Return the camera of each picture: of its file, its number, or a folder in its name.

        What belongs to none is left out, and has `NO_CAMERA`.
        """
        if camera is not None:
            return [camera] * len(entries)
        stated = {picture.camera for _, picture in entries if picture.camera is not None}
        numbered = self._by_number(stated, entries[0][0]) if stated else {}
        found = []
        for (path, picture), label in zip(entries, labels, strict=True):
            if picture.camera is not None:
                found.append(numbered[picture.camera])
                continue
            parts = PurePosixPath(str(label).replace("\\", "/")).parent.parts
            fitting = [index for index, name in enumerate(self.rig.camera_ids) if name in parts]
            if not fitting:
                stem = PurePosixPath(str(label)).stem.lower()
                fitting = [
                    i for i, n in enumerate(self.rig.camera_ids) if has_word(stem, n.lower())
                ]
            if len(fitting) != 1:
                self._leave_out(
                    f"{path}: file name: found {str(label)[:120]!r}, expected <camera>/<frame> "
                    f"with a camera of {', '.join(self.rig.camera_ids)}"
                )
                fitting = [NO_CAMERA]
            found += fitting
        return found

    def _by_number(self, numbers: set[int], path: Path) -> dict[int, int]:
        """Return the cameras for a file's numbers: ids that end in them, else their places."""
        ends = [re.findall(r"\d+", name)[-1:] for name in self.rig.camera_ids]
        named = {int(end[0][-9:]): i for i, end in enumerate(ends) if end}
        if numbers <= {*named} and len(named) == len(self.rig):
            return named
        if numbers <= {*range(len(self.rig))}:
            return {number: number for number in numbers}
        raise InputError(
            f"{path}: cameras {sorted(numbers)[:40]}: expected those of "
            f"{', '.join(self.rig.camera_ids)}"
        )

    def _fill(self, people: People) -> None:
        """Count frames without a result as empty views: lists of results do not tell of them."""
        numbers = [number for camera in people for number in camera]
        seen = range(min(numbers), max(numbers) + 1) if numbers else range(0)
        if len(seen) > 1000 + 100 * len(numbers):
            raise InputError(
                f"{self.source}: frame numbers: found {seen[0]} to {seen[-1]}, expected "
                "consecutive ones"
            )
        step = _step(numbers)
        for camera in people:
            for number in seen[::step]:
                camera.setdefault(number, ())

    def _layout(self, people: Floats, names: Sequence[str]) -> Layout:
        layout = None
        chosen = self.settings.skeleton
        if names:
            layout = named_layout(names, load_skeleton(chosen) if chosen else None)
            if layout is None:
                raise InputError(
                    f"{self.source}: found the body parts {', '.join(names)[:200]}, expected "
                    "left and right elbow, wrist, knee and ankle among them"
                )
        if layout is None:
            layout, note = choose_layout(people, chosen, str(self.source))
            self.notes += [note] if note else []
        if layout.unused:
            self.notes.append(f"{layout.unused} (the skeleton is {layout.skeleton.name})")
        return layout

    def _step(self, frames: Sequence[Mapping[int, Poses2D]]) -> int:
        step = _step([number for camera in frames for number in camera])
        if step > 1:
            self.notes.append(f"frame numbers go in steps of {step}: --fps is the rate of the "
                              f"numbers, of which every {step}. is a slot")  # fmt: skip
        return step

    def _leave_out(self, reason: str) -> None:
        if self.settings.strict:
            raise InputError(reason)
        self._bad.append(reason)


def import_detections(
    source: Path,
    calibration: Path,
    fps: float,
    settings: ImportSettings | None = None,
    progress: Progress = iter,
) -> tuple[Recording, list[str]]:
    """Read the 2D poses that another tool found, in any form that `forms` reads.

    Args:
        source: a folder with a folder or file for each camera, or a file with all cameras.
        calibration: the rig, in any format that `e3pose.recording.calibration` reads.
        fps: frame numbers per second.
        settings: what the files do not say.
        progress: wraps the list of files that is read.

    Returns:
        A recording whose slot 0 is the lowest frame number of any camera, and what a user should
        know of how it was read.

    Raises:
        InputError: naming the file and field that is wrong.
    """
    check_fps(fps)
    settings = settings or ImportSettings()
    known = load_calibration(calibration)
    reader = Reader(source, known.rig, settings, list(known.notes))
    skeleton, frames, step = reader.read(progress)
    frames = [{number // step: view for number, view in camera.items()} for camera in frames]
    num_slots, views = series_from_frames(frames, fps / step, len(skeleton), str(source))
    name = "".join(char for char in source.resolve().stem if char.isprintable())
    recording = Recording(
        name=name[:200] or "detections",
        rig=reader.rig,
        fps=fps / step,
        num_slots=num_slots,
        skeleton=skeleton,
        views=views,
        detector=settings.detector,
        source=f"Detections of {source.resolve().name}, {skeleton.name}",
    )
    return recording, reader.notes


def read_detections(
    source: Path, rig: Rig, folders: Mapping[str, str], progress: Progress = iter
) -> tuple[Skeleton, list[dict[int, Poses2D]]]:
    """Return the skeleton and, per camera of `rig`, frame number to view; nothing is left out.

    Raises:
        InputError: for files without people, or without a camera, or the reverse.
    """
    reader = Reader(source, rig, ImportSettings(folders=folders, strict=True))
    skeleton, frames, _ = reader.read(progress)
    if len(reader.rig) < len(rig):
        raise InputError(f"{source}: {reader.notes[0]}")
    return skeleton, frames


def _base(label: str) -> str:
    """Return the file name of a picture without folders."""
    return PurePosixPath(label.replace("\\", "/")).name


def usual_high(values: Floats) -> float:
    """Return the highest number, but for a few that are far beyond all others; 0 without any."""
    if not values.size:
        return 0.0
    return float(values[values <= FAR_BEYOND * max(np.percentile(values, USUAL), 1.0)].max())


def _files(folder: Path) -> list[Path]:
    """Return the files of detections in a folder; text counts only where nothing else is."""
    entries = sorted(e for e in folder.iterdir() if not e.name.startswith("."))
    found = [e for e in entries if e.suffix.lower() in SUFFIXES]
    return [e for e in found if e.suffix.lower() != ".txt"] or found


def _step(numbers: Sequence[int]) -> int:
    """Return the step in which frame numbers go; 1 unless all go in it."""
    first = min(numbers, default=0)
    step = 0
    for number in numbers:
        step = gcd(step, number - first)
        if step == 1:
            break
    return step or 1
