"""Detect in all videos slot by slot, with feedback from the estimated people."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from e3pose.camera.image_folder import Source
from e3pose.camera.look_times import LookTimes
from e3pose.camera.slots import Picture, SlotGrid, frames_in_slots
from e3pose.camera.unfinished import Unfinished
from e3pose.detectors import Detector
from e3pose.detectors.focus import detect_expected
from e3pose.model.camera import Rig
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton
from e3pose.pipeline import initial_state, step
from e3pose.recording import ViewSeries, encode_view
from e3pose.settings.loop import LoopSettings
from e3pose.settings.parts import make_pipeline

LEAD = 1  # slots


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
    """One camera: what was detected in an earlier run, then its video."""

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
        """Return what an earlier run found in a slot."""
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
        """Return who is in a camera's frame of the slot; None without a frame."""
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
