"""Run a site of real processes for one round of what its cameras play, and read it from its store.

Imported by `camera_work.py` and `live_choice.py`.
"""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.output.report.stored import slot_records
from e3pose.pipeline import SlotRecord
from e3pose.settings.resolved import resolve_site
from e3pose.site.follow import Follower, viewer_link
from e3pose.site.up import Program, camera_command, edge_command, last_line, run_site
from e3pose.store import Store
from e3pose.wire import topics
from e3pose.wire.codec import decode
from e3pose.wire.messages import Heartbeat, View
from e3pose.wire.network import open_network
from e3pose.wire.site_messages import Poses, Status

STALLED_S = 60.0  # without a new slot, beyond what the edge compiles on its first start
PATIENCE = 3.0  # times the usual, at most, until cameras must be ready


@dataclass(eq=False)
class Heard:
    """The messages of a site.

    Attributes:
        length_s: of one round of what its cameras play, seconds of the scene.
        pace: seconds of the scene that pass in a second.
        slot_ns: how long a slot takes.
        beats: the newest heartbeat of each camera.
        captured_ns: when a frame of each slot was taken, since 1970.
        status: the last of the edge at work.
        slots: slots whose poses were published.
        round_slots: those of the first round.
        newest_ns: when the newest of them was, since 1970.
        begin_ns: when the cameras began to play, since 1970.
    """

    length_s: float
    pace: float
    slot_ns: int
    beats: dict[str, Heartbeat] = field(default_factory=dict)
    captured_ns: dict[int, int] = field(default_factory=dict)
    status: Status | None = None
    slots: int = 0
    round_slots: int = 0
    newest_ns: int = 0
    begin_ns: int = 0

    @property
    def end_ns(self) -> int:
        """When the first round ends, since 1970; slots from then on are of the next one."""
        return self.begin_ns + round(self.length_s / self.pace * 1e9) - self.slot_ns // 2

    def poses(self, poses: Poses) -> None:
        """Take in the people of a slot."""
        self.slots = max(self.slots, poses.slot + 1)
        self.newest_ns = max(self.newest_ns, poses.time_edge_ns)
        self.round_slots += poses.time_edge_ns < self.end_ns

    def view(self, _topic: str, payload: bytes) -> None:
        """Take in a view."""
        view = decode(payload, View, "camera")
        self.captured_ns[view.slot] = view.captured_edge_ns

    def beat(self, _topic: str, payload: bytes) -> None:
        """Take in a heartbeat."""
        beat = decode(payload, Heartbeat, "camera")
        self.beats[beat.camera_id] = beat

    def at_s(self, time_ns: int) -> float:
        """Return the moment of the scene, in seconds, that is shown at a time since 1970."""
        round_ns = round(self.length_s / self.pace * 1e9)
        return (time_ns - self.begin_ns) % round_ns / 1e9 * self.pace


def run_live(site_file: Path, num_slots: int, length_s: float, ready_s: float) -> Heard:
    """Run the edge and every camera as processes of their own until enough slots are done.

    The cameras are started once the edge has compiled, and all begin to play at one moment. What
    they play begins again after `length_s` of the scene, where people jump: the run ends there if
    that gave half of the slots. Whatever ends it, an exception or a signal, ends the processes.

    Args:
        site_file: of the site; its output goes to `logs` beside it.
        num_slots: how many are enough.
        length_s: how long one round of what is played is, seconds of the scene.
        ready_s: how long a camera takes to get ready, about.

    Raises:
        InputError: with the last words of the program that did not do its work.
    """
    site, logs = resolve_site(site_file), site_file.parent / "logs"
    logs.mkdir()
    name, pace = site.file.name, site.file.pace
    programs = [Program("edge", edge_command(site_file), logs / "edge.log")]
    heard = Heard(length_s, pace, round(1e9 / site.file.fps / pace))
    follower = Follower(name)
    begun_s = newest_s = time.monotonic()
    newest = 0

    def stopped() -> bool:
        nonlocal newest, newest_s
        now_s, status = time.monotonic(), follower.status
        heard.status = status or heard.status
        if status is not None and status.compiling_s is None and not heard.begin_ns:
            # A machine on which the edge took long will take long for the cameras too.
            wait_s = min(max(ready_s, now_s - begun_s), PATIENCE * ready_s)
            heard.begin_ns = time.time_ns() + round(wait_s * 1e9)
            for camera_id in site.cameras:
                begin = ["--begin-s", str(heard.begin_ns / 1e9)]
                log = logs / f"{camera_id}.log"
                programs.append(Program(camera_id, camera_command(site, camera_id) + begin, log))
                programs[-1].start()
        if heard.slots > newest or not heard.begin_ns:
            newest, newest_s = heard.slots, now_s
        if now_s - newest_s > STALLED_S or any(program.restarts for program in programs):
            said = (f"{one.name}: {last_line(one.log)}" for one in programs if one.log.exists())
            raise InputError(f"a program of the site stopped: {'; '.join(said)}")
        over = heard.newest_ns >= heard.end_ns - heard.slot_ns
        enough = heard.slots >= num_slots or (over and heard.round_slots >= num_slots // 2)
        return bool(heard.begin_ns) and enough

    with closing(open_network(viewer_link(site.file, None))) as transport:
        follower.listen(transport, heard.poses)
        transport.subscribe(topics.of_camera(name, topics.ANY, "view"), heard.view)
        transport.subscribe(topics.of_camera(name, topics.ANY, "heartbeat"), heard.beat)
        run_site(programs, stopped, lambda line: None)
    return heard


def stored_records(
    store: Path, interval_s: float, heard: Heard, num_slots: int
) -> tuple[list[SlotRecord], Floats]:
    """Return the records of the newest run in a store, and what moment of the scene each was about.

    Moments are `(num_slots,)` seconds: when the frames of a slot's active cameras were taken, or
    its middle without any.

    Args:
        store: the database.
        interval_s: seconds of the scene that a slot lasts.
        heard: of the run.
        num_slots: how many were wanted; those after them are left out, and those after the first
            round if it gave half of them.
    """
    asked = Store(store)
    run = asked.runs()[-1].run_id
    rows = [row for row in asked.rows("slots", run=run) if row["slot"] < num_slots]
    first_round = [row for row in rows if row["time_ns"] < heard.end_ns]
    rows = first_round if len(first_round) >= num_slots // 2 else rows
    times_ns = [heard.captured_ns.get(row["slot"], row["time_ns"]) for row in rows]
    records = slot_records(rows, asked.query(run=run), interval_s)
    return records, np.array([heard.at_s(time_ns) for time_ns in times_ns])
