"""Run a site of real processes for one round of what its cameras play, and read it back as records.

Imported by `camera_work.py` and `live_choice.py`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording, Truth, ViewSeries
from e3pose.settings.resolved import resolve_site
from e3pose.site.follow import Follower, viewer_link
from e3pose.site.up import Program, camera_command, edge_command, last_line, run_site
from e3pose.store import Store
from e3pose.store.records import charged_j, slot_records
from e3pose.wire import topics
from e3pose.wire.arrays import poses_2d
from e3pose.wire.codec import decode
from e3pose.wire.messages import Heartbeat, View
from e3pose.wire.network import open_network
from e3pose.wire.site_messages import Poses, Status
from e3pose.wire.transport import Transport

START_S = 60.0  # until the first slot, without what the edge compiles on its first start
SLOT_S = 30.0  # without a new slot for so long, something hangs
PATIENCE = 3.0  # times the usual, at most, until cameras must be ready


@dataclass(frozen=True, slots=True, eq=False)
class HeardView:
    """A view of a camera, and the time of its frame since 1970."""

    poses: Poses2D
    captured_ns: int


@dataclass(eq=False)
class Heard:
    """The messages of a site.

    Attributes:
        views: by slot and camera, what a camera saw.
        beats: the newest heartbeat of each camera.
        status: the last of the edge at work.
        slots: slots whose poses were published.
        newest_ns: when the newest of them was, since 1970.
        begin_ns: when the cameras began to play, since 1970.
        end_ns: when their first round ends; slots from then on are of the next one.
        round_slots: slots of the first round whose poses were published.
    """

    views: dict[tuple[int, str], HeardView] = field(default_factory=dict)
    beats: dict[str, Heartbeat] = field(default_factory=dict)
    status: Status | None = None
    slots: int = 0
    newest_ns: int = 0
    begin_ns: int = 0
    end_ns: int = 0
    round_slots: int = 0

    def listen(self, site: str, transport: Transport) -> None:
        """Receive all messages from now on; on loopback, no certificate is needed."""
        transport.subscribe(topics.of_camera(site, topics.ANY, "view"), self._view)
        transport.subscribe(topics.of_camera(site, topics.ANY, "heartbeat"), self._beat)

    def poses(self, poses: Poses) -> None:
        """Take in the people of a slot."""
        self.slots = max(self.slots, poses.slot + 1)
        self.newest_ns = max(self.newest_ns, poses.time_edge_ns)
        self.round_slots += poses.time_edge_ns < self.end_ns

    def enough(self, num_slots: int, slot_ns: int) -> bool:
        """Return whether all wanted slots arrived, or half of them after a first round."""
        over = self.newest_ns >= self.end_ns - slot_ns
        return self.slots >= num_slots or (over and self.round_slots >= num_slots // 2)

    def _view(self, _topic: str, payload: bytes) -> None:
        view = decode(payload, View, "camera")
        self.views[view.slot, view.camera_id] = HeardView(poses_2d(view), view.captured_edge_ns)

    def _beat(self, _topic: str, payload: bytes) -> None:
        beat = decode(payload, Heartbeat, "camera")
        self.beats[beat.camera_id] = beat


def run_live(site_file: Path, rig: Rig, num_slots: int, round_s: float, ready_s: float) -> Heard:
    """Run the edge and every camera as processes of their own until enough slots are done.

    The cameras are started once the edge has compiled, and all begin to play at one moment. What
    they play begins again after `round_s`, where people jump: the run ends there if that gave half
    of the slots. Whatever ends it, an exception or a signal that raises one, ends the processes.

    Args:
        site_file: of the site; its output goes to `logs` beside it.
        rig: its cameras.
        num_slots: how many are enough.
        round_s: how long one round of what is played takes.
        ready_s: how long a camera takes to get ready, about.

    Raises:
        InputError: with the last words of the program that did not do its work.
    """
    site = resolve_site(site_file)
    logs = site_file.parent / "logs"
    logs.mkdir()
    programs = [Program("edge", edge_command(site_file), logs / "edge.log")]
    heard, follower = Heard(), Follower(site.file.name)
    link = viewer_link(site.file, None)
    transport = open_network(link)
    follower.listen(transport, heard.poses)
    heard.listen(site.file.name, transport)
    begun_s = newest_s = time.monotonic()
    slot_ns = round(1e9 / site.file.fps / site.file.pace)
    edge_s, newest = 0.0, 0  # how long the edge took to be there; the newest slot

    def stopped() -> bool:
        nonlocal edge_s, newest, newest_s
        now_s, status = time.monotonic(), follower.status
        if status is not None and not edge_s:
            edge_s = now_s - begun_s
        if status is not None and status.compiling_s is not None:
            newest_s = now_s
        elif status is not None and not heard.begin_ns:
            # A machine on which the edge took long will take long for the cameras too.
            wait_s = min(max(ready_s, edge_s), PATIENCE * ready_s)
            heard.begin_ns = time.time_ns() + round(wait_s * 1e9)
            heard.end_ns = heard.begin_ns + round(round_s * 1e9) - slot_ns // 2
            for camera_id in rig.camera_ids:
                begin = ["--begin-s", str(heard.begin_ns / 1e9)]
                command = camera_command(site, camera_id) + begin
                programs.append(Program(camera_id, command, logs / f"{camera_id}.log"))
                programs[-1].start()
        heard.status = status or heard.status
        if heard.slots > newest:
            newest, newest_s = heard.slots, now_s
        waited_s = now_s - newest_s
        if waited_s > (SLOT_S if newest else START_S):
            raise InputError(f"edge: no slot for {waited_s:.0f} s: {_last_words(programs)}")
        if any(program.restarts for program in programs):
            raise InputError(f"a program of the site stopped: {_last_words(programs)}")
        return bool(heard.begin_ns) and heard.enough(num_slots, slot_ns)

    try:
        run_site(programs, stopped, lambda line: None)
    finally:
        transport.close()
    return heard


def _last_words(programs: Sequence[Program]) -> str:
    return "; ".join(f"{p.name}: {last_line(p.log)}" for p in programs if p.log.exists())


@dataclass(frozen=True, slots=True)
class Film:
    """What the cameras of a site play, again and again.

    Attributes:
        length_s: of one round, seconds of the scene.
        pace: seconds of the scene that pass in a second.
        begin_ns: when it began, since 1970.
    """

    length_s: float
    pace: float
    begin_ns: int = 0

    def at_s(self, time_ns: int) -> float:
        """Return what moment of the scene is shown at a time since 1970."""
        round_ns = round(self.length_s / self.pace * 1e9)
        return (time_ns - self.begin_ns) % round_ns / 1e9 * self.pace

    def moments(self, heard: Heard, records: Sequence[SlotRecord], times: Sequence[int]) -> Floats:
        """Return `(num_slots,)` seconds: which moment of the scene each slot was about.

        That is when the frames of its active cameras were taken; the middle of the slot without
        any.
        """
        taken = {slot: view.captured_ns for (slot, _), view in heard.views.items()}
        pairs = zip(records, times, strict=True)
        return np.array([self.at_s(taken.get(r.slot, time_ns)) for r, time_ns in pairs])


def stored_records(
    store: Path, interval_s: float, film: Film, num_slots: int
) -> tuple[list[SlotRecord], list[int], Floats | None]:
    """Return the records of the newest run in a store, when each slot was, and its joules.

    Times are since 1970; joules are those of `store.records.charged_j`.

    Args:
        store: the database.
        interval_s: seconds of the scene that a slot lasts.
        film: what was played.
        num_slots: how many were wanted; those after them are left out, and those after the first
            round of the film if it gave half of them.
    """
    asked = Store(store)
    run = asked.runs()[-1].run_id
    found = asked.query(run=run)
    end_ns = film.begin_ns + round((film.length_s - interval_s / 2) / film.pace * 1e9)
    rows = [row for row in asked.rows("slots", run=run) if row["slot"] < num_slots]
    first_round = [row for row in rows if row["time_ns"] < end_ns]
    rows = first_round if len(first_round) >= num_slots // 2 else rows
    times = [row["time_ns"] for row in rows]
    return slot_records(rows, found, interval_s), times, charged_j(rows)


def heard_views(
    heard: Heard, cameras: Sequence[str], num_slots: int, fps: float, num_joints: int
) -> tuple[ViewSeries, ...]:
    """Return what every camera sent, as the views of a recording that begins at slot 0."""
    series = []
    for camera_id in cameras:
        slots = sorted(s for s, who in heard.views if who == camera_id and s < num_slots)
        views: list[Poses2D] = [heard.views[slot, camera_id].poses for slot in slots]
        series.append(ViewSeries.from_views(views, slots, [s / fps for s in slots], num_joints))
    return tuple(series)


def truth_at(truth: Truth, moments_s: Floats, fps: float) -> Truth:
    """Return the truth of the moments that were shown, one a slot."""
    frames = np.round(moments_s * fps).astype(np.int64) % len(truth.joints_m)
    return Truth(truth.skeleton, truth.person_ids, truth.joints_m[frames])


def as_recording(scene: Recording, heard: Heard, moments_s: Floats) -> Recording:
    """Return a live run as a recording: what the cameras sent, and the truth of those moments.

    Args:
        scene: what was shown.
        heard: what the cameras sent of it.
        moments_s: `(num_slots,)` which moment of the scene each slot was about.
    """
    count, joints = len(moments_s), len(scene.skeleton)
    return replace(
        scene,
        num_slots=count,
        views=heard_views(heard, scene.rig.camera_ids, count, scene.fps, joints),
        truth=None if scene.truth is None else truth_at(scene.truth, moments_s, scene.fps),
        scored_slots=None,
    )
