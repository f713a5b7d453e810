"""A site of real processes over TLS on loopback, whose cameras replay simulated detections."""

from __future__ import annotations

import datetime
import os
import re
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from e3pose.recording import save_recording
from e3pose.settings.resolved import resolve_site
from e3pose.simulate.settings import SceneSettings
from e3pose.simulate.simulation import simulate
from e3pose.site.example import free_port
from e3pose.site.follow import Follower, viewer_link
from e3pose.site.up import Program, camera_command, edge_command, end, view_command
from e3pose.wire.keys.folder import add_keys, init_keys
from e3pose.wire.network import open_network
from e3pose.wire.site_messages import Poses

SETTLE_S = 4.0
PAGE = "page"
ASLEEP = '[[camera]]\nidle_mode = "aggressive-power-saving"\nwake_s = 0.1'
# Names of the edge's threads, and what they do.
PARTS = {
    "fusion": "step, encoding",
    "sending": "sending",
    "keeping": "status, checkpoint",
    "store": "store",
}
RECEIVING, MAIN, TRANSPORT = "decoding", "rest", "transport"


@dataclass
class Sample:
    """Resources of the processes of a site at one time."""

    at_s: float
    edge_rss: int
    edge_threads: int
    camera_rss: int
    camera_threads: int
    page_rss: int = 0
    page_threads: int = 0


@dataclass
class Site:
    """A running site."""

    folder: Path
    programs: list[Program]
    follower: Follower
    metrics_port: int
    page_port: int | None = None
    cpu_begin_s: float = 0.0
    begun_s: float = 0.0
    samples: list[Sample] = field(default_factory=list)
    parts_begin_s: dict[str, float] = field(default_factory=dict)

    def edge(self) -> psutil.Process:
        """Return the process of the edge.

        Raises:
            SystemExit: when it has ended, with what it said last.
        """
        program = self.programs[0]
        assert program.process is not None
        if (code := program.ended()) is not None:
            said = program.log.read_text()[-3000:]
            raise SystemExit(f"the edge ended with exit code {code}: {said}")
        return psutil.Process(program.process.pid)

    def cameras(self) -> list[psutil.Process]:
        return self._processes(lambda name: name not in ("edge", PAGE))

    def page(self) -> list[psutil.Process]:
        """Return the process of the page, if it runs."""
        return self._processes(lambda name: name == PAGE)

    def _processes(self, wanted: Callable[[str], bool]) -> list[psutil.Process]:
        running = [p for p in self.programs if wanted(p.name) and p.process is not None]
        return [psutil.Process(p.process.pid) for p in running if p.process is not None]

    def begin_count(self) -> None:
        times = self.edge().cpu_times()
        self.cpu_begin_s, self.begun_s = times.user + times.system, time.monotonic()
        self.parts_begin_s = _cpu_by_part(self.edge().pid)

    def edge_cpu_share(self) -> float:
        times = self.edge().cpu_times()
        spent_s = times.user + times.system - self.cpu_begin_s
        return float(spent_s / (time.monotonic() - self.begun_s))

    def cpu_by_part(self) -> dict[str, float]:
        """Return the share of a core that each part of the edge took since `begin_count`.

        Threads are known by their names: those of the network library have its own, and what is
        called from it, decoding and taking in messages, those of the interpreter.
        """
        passed_s = time.monotonic() - self.begun_s
        now = _cpu_by_part(self.edge().pid)
        return {part: (now[part] - self.parts_begin_s[part]) / passed_s for part in now}

    def metric(self, name: str) -> float:
        """Return a metric of the edge, summed over the cameras if they have it each."""
        url = f"http://127.0.0.1:{self.metrics_port}/metrics"
        with urllib.request.urlopen(url, timeout=5.0) as answer:
            lines = answer.read().decode().splitlines()
        return sum(float(line.split()[-1]) for line in lines if re.match(rf"{name}[ {{]", line))

    def sample(self) -> Sample:
        edge, cameras, page = self.edge(), self.cameras(), self.page()
        made = Sample(
            time.monotonic() - self.begun_s,
            edge.memory_info().rss,
            edge.num_threads(),
            sum(c.memory_info().rss for c in cameras),
            sum(c.num_threads() for c in cameras),
            sum(p.memory_info().rss for p in page),
            sum(p.num_threads() for p in page),
        )
        self.samples.append(made)
        return made


def _cpu_by_part(pid: int) -> dict[str, float]:
    """Return the seconds of CPU that the threads of an edge took so far, by what they do."""
    tick_s = 1 / os.sysconf("SC_CLK_TCK")
    spent_s = dict.fromkeys((*PARTS.values(), RECEIVING, MAIN, TRANSPORT), 0.0)
    for task in Path(f"/proc/{pid}/task").iterdir():
        try:
            said = (task / "stat").read_text()
        except OSError:  # a thread that has just ended
            continue
        name, after = said.split("(", 1)[1].rsplit(")", 1)
        python = name.startswith("python") or name.startswith("e3pose")
        other = (MAIN if int(task.name) == pid else RECEIVING) if python else TRANSPORT
        user, system = after.split()[11:13]
        spent_s[PARTS.get(name, other)] += (int(user) + int(system)) * tick_s
    return spent_s


@contextmanager
def live_site(
    cameras: int = 5,
    people: int = 4,
    fps: float = 25.0,
    seconds: float = 20.0,
    loop: str = "cameras = 2",
    store: bool = True,
    tls: bool = True,
    page: bool = False,
    spare: int = 0,
    record: bool = False,
    asleep: bool = False,
    keys_made: datetime.datetime | None = None,
    more: Callable[[int], str] = lambda camera: "",
    change: Callable[[Program], None] = lambda program: None,
    on_poses: Callable[[Poses], object] | None = None,
    settle_s: float = SETTLE_S,
) -> Iterator[Site]:
    """Start a site and wait until its slots flow; end it at the end.

    Args:
        cameras: of the rig.
        people: in the scene.
        fps: slots per second.
        seconds: of the scene, which repeats.
        loop: lines below `[loop]`.
        store: whether slots are stored.
        tls: whether the link is encrypted.
        page: whether its page runs too.
        spare: so many cameras, the last ones, have no program.
        record: whether the edge keeps the views of all cameras.
        asleep: whether cameras close their sources between orders, as soon as there is time.
        more: lines of the site file on the camera of an index.
        keys_made: from when on the certificates are valid; None for now.
        change: called with each program before it starts.
        on_poses: called with the poses of each slot.
        settle_s: to wait after the first slots.
    """
    with tempfile.TemporaryDirectory(prefix="e3pose-live-") as name:
        folder = Path(name)
        scene = SceneSettings("ring", people=people, seconds=seconds, fps=fps, cameras=cameras)
        recording = simulate(scene, seed=1)
        save_recording(recording, folder / "recording")
        now = keys_made or datetime.datetime.now(datetime.timezone.utc)
        init_keys(folder / "keys", "bench", [], now)
        for camera_id in recording.rig.camera_ids:
            add_keys(folder / "keys", camera_id, now)
        add_keys(folder / "keys", "wall", now, kind="viewer")
        path = folder / "site.toml"
        metrics_port = free_port()
        file = _site_file(recording.rig.camera_ids, fps, loop, store, tls, metrics_port)
        if record:
            file = file.replace("[[camera]]", '[[camera]]\nrecord = "keypoints"')
        if asleep:
            file = file.replace("[[camera]]", ASLEEP)
        for index, camera_id in enumerate(recording.rig.camera_ids):
            file = file.replace(f'id = "{camera_id}"', f'id = "{camera_id}"\n{more(index)}')
        path.write_text(file)
        site = resolve_site(path)
        command = [*edge_command(path), "--json-logs"]
        programs = [Program("edge", command, folder / "edge.log")] + [
            Program(i, camera_command(site, i), folder / f"{i}.log")
            for i in recording.rig.camera_ids[: cameras - spare]
        ]
        page_port = free_port() if page else None
        if page:
            command = [*view_command(path), "--listen", f"127.0.0.1:{page_port}"]
            programs.append(Program(PAGE, command, folder / "page.log"))
        follower = Follower("bench")
        transport = open_network(viewer_link(site.file, None))
        follower.listen(transport, on_poses)
        for program in programs:
            change(program)
            program.start()
        try:
            _wait_until_it_runs(follower, programs)
            time.sleep(settle_s)
            made = Site(folder, programs, follower, metrics_port, page_port)
            made.begin_count()
            yield made
        finally:
            transport.close()
            end(programs)


def _site_file(
    camera_ids: tuple[str, ...], fps: float, loop: str, store: bool, tls: bool, metrics_port: int
) -> str:
    port = free_port()
    lines = [
        'format = "e3pose-site"',
        "version = 1",
        'name = "bench"',
        'calibration = "recording/calibration.toml"',
        f"fps = {fps}",
        f"metrics_port = {metrics_port}",
        "[link]",
        f'endpoint = "{"tls" if tls else "tcp"}/127.0.0.1:{port}"',
        'keys = "keys"',
        "[loop]",
        loop,
    ]
    if store:
        lines += ["[store]", 'path = "poses.db"']
    for camera_id in camera_ids:
        lines += ["[[camera]]", f'id = "{camera_id}"', 'source = "recorded:recording"']
    return "\n".join(lines) + "\n"


def _wait_until_it_runs(follower: Follower, programs: list[Program]) -> None:
    end_s = time.monotonic() + 300  # the first start compiles, and is slow until then
    while (said := follower.status) is None or said.fps <= 0 or said.compiling_s is not None:
        if time.monotonic() > end_s or programs[0].ended() is not None:
            raise SystemExit(f"the edge does not run: {programs[0].log.read_text()[-2000:]}")
        time.sleep(0.1)


def traffic(loopback: str = "lo") -> int:
    """Return bytes that went over the loopback device so far."""
    return int(psutil.net_io_counters(pernic=True)[loopback].bytes_sent)


def wait(seconds: float) -> None:
    threading.Event().wait(seconds)
