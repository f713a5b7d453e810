"""Run a site of real processes for a while, and receive all its messages."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.settings.resolved import resolve_site
from e3pose.site.follow import Follower, viewer_link
from e3pose.site.up import Program, camera_command, edge_command, run_site
from e3pose.wire import topics
from e3pose.wire.arrays import poses_2d
from e3pose.wire.codec import decode
from e3pose.wire.messages import Heartbeat, Order, View
from e3pose.wire.network import open_network
from e3pose.wire.site_messages import Poses, Status
from e3pose.wire.transport import Transport

START_S = 60.0  # until the first slot, without what the edge compiles on its first start
SLOT_S = 30.0  # without a new slot for so long, something hangs
SHOW_S = 0.2
PATIENCE = 3.0  # times the usual, at most, until cameras must be ready

# Shows how the site is: the newest status, and slots done of how many.
Show = Callable[["Status | None", int, int], None]


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
        sent_bytes: by camera, of its views.
        order_bytes: of the orders to all cameras.
        beats: the newest heartbeat of each camera.
        delays_s: from the middle of each slot until its poses were published.
        status: the last of the edge at work.
        slots: slots whose poses were published.
        newest_ns: when the newest of them was, since 1970.
        begin_ns: when the cameras began to play, since 1970.
        end_ns: when their first round ends; slots from then on are of the next one.
        round_slots: slots of the first round whose poses were published.
    """

    views: dict[tuple[int, str], HeardView] = field(default_factory=dict)
    sent_bytes: Counter[str] = field(default_factory=Counter)
    order_bytes: int = 0
    beats: dict[str, Heartbeat] = field(default_factory=dict)
    delays_s: list[float] = field(default_factory=list)
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
        transport.subscribe(f"{topics.ROOT}/{site}/order/{topics.ANY}", self._order)

    def poses(self, poses: Poses) -> None:
        """Take in the people of a slot."""
        self.slots = max(self.slots, poses.slot + 1)
        self.newest_ns = max(self.newest_ns, poses.time_edge_ns)
        self.round_slots += poses.time_edge_ns < self.end_ns
        self.delays_s.append((poses.published_edge_ns - poses.time_edge_ns) / 1e9)

    def enough(self, num_slots: int, slot_ns: int) -> bool:
        """Return whether all wanted slots arrived, or half of them after a first round."""
        over = self.newest_ns >= self.end_ns - slot_ns
        return self.slots >= num_slots or (over and self.round_slots >= num_slots // 2)

    def _view(self, _topic: str, payload: bytes) -> None:
        view = decode(payload, View, "camera")
        self.views[view.slot, view.camera_id] = HeardView(poses_2d(view), view.captured_edge_ns)
        self.sent_bytes[view.camera_id] += len(payload)

    def _beat(self, _topic: str, payload: bytes) -> None:
        beat = decode(payload, Heartbeat, "camera")
        self.beats[beat.camera_id] = beat

    def _order(self, _topic: str, payload: bytes) -> None:
        decode(payload, Order, "edge")
        self.order_bytes += len(payload)


def run_live(
    site_file: Path, rig: Rig, num_slots: int, round_s: float, ready_s: float, show: Show
) -> Heard:
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
        show: called a few times a second.

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
    begun_s = newest_s = shown_s = time.monotonic()
    slot_ns = round(1e9 / site.file.fps / site.file.pace)
    edge_s, newest = 0.0, 0  # how long the edge took to be there; the newest slot

    def stopped() -> bool:
        nonlocal edge_s, newest, newest_s, shown_s
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
        if now_s - shown_s >= SHOW_S:
            shown_s = now_s
            show(heard.status, min(heard.slots, num_slots), num_slots)
        waited_s = now_s - newest_s
        if waited_s > (SLOT_S if newest else START_S):
            raise InputError(f"edge: no slot for {waited_s:.0f} s: {last_words(programs)}")
        if any(program.restarts for program in programs):
            raise InputError(f"a program of the site stopped: {last_words(programs)}")
        return bool(heard.begin_ns) and heard.enough(num_slots, slot_ns)

    try:
        run_site(programs, stopped, lambda line: None)
    finally:
        transport.close()
    return heard


def last_words(programs: list[Program]) -> str:
    """Return the last line of every program that wrote one."""
    said = []
    for program in programs:
        text = (
            program.log.read_text(errors="replace", encoding="utf-8")
            if program.log.exists()
            else ""
        )
        lines = [line for line in text.strip().splitlines() if line.strip()]
        said += [f"{program.name}: {lines[-1][:200]}"] if lines else []
    return "; ".join(said) or "no output"
