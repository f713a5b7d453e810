"""How many sites an edge process bears: CPU of a slot in a process each, and in one for all.

    python lab/benchmarks/bench_many_edges.py                             # some minutes
    python lab/benchmarks/bench_many_edges.py --sites 14 --cameras 5 --people 4

Edges are real processes with the whole loop, the default policy and the store, over mutual TLS on
loopback. Cameras are sessions of their own with certificates of their own, in one process on other
cores: they answer orders with simulated detections, and do nothing else. All edges are bound to one
core. `processes`: `e3pose edge SITE` for each; `one`: `e3pose edge SITE...`. CPU is that of whole
processes, all threads.
"""

from __future__ import annotations

import argparse
import datetime
import heapq
import os
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench_hub import free_ports
from e3pose.recording import load_recording, save_recording
from e3pose.simulate import SceneSettings, simulate
from e3pose.wire import topics
from e3pose.wire.access import Link
from e3pose.wire.arrays import pack
from e3pose.wire.codec import decode, encode
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import add_keys, certificates_in, init_keys
from e3pose.wire.messages import Heartbeat, Hello, Order, View
from e3pose.wire.network import open_network
from live_site import _cpu_by_part

FPS, SECONDS = 25.0, 20.0
DETECT_NS = 5_000_000  # from the middle of a slot until its view leaves
BEAT_S, HELLO_BEATS = 0.5, 4
START_S, SETTLE_S = 400.0, 8.0
KINDS = ("processes", "one")


def make_sites(
    folder: Path, sites: int, cameras: int, people: int, alike: bool = False
) -> list[Path]:
    """Make the folders of sites, whose scenes are the same where they are alike; return them."""
    made, now = list[Path](), datetime.datetime.now(datetime.timezone.utc)
    ports = free_ports(2 * sites)
    for at in range(sites):
        place, name = folder / f"site{at}", f"site{at}"
        place.mkdir()
        scene = SceneSettings("ring", people=people, seconds=SECONDS, fps=FPS, cameras=cameras)
        recording = simulate(scene, seed=701 if alike else 701 + at)
        save_recording(recording, place / "recording")
        init_keys(place / "keys", name, [], now)
        for camera_id in recording.rig.camera_ids:
            add_keys(place / "keys", camera_id, now)
        (place / "site.toml").write_text(
            f'format = "e3pose-site"\nversion = 1\nname = "{name}"\nfps = {FPS}\n'
            f'calibration = "recording/calibration.toml"\nmetrics_port = {ports[2 * at + 1]}\n'
            f'[link]\nendpoint = "tls/127.0.0.1:{ports[2 * at]}"\nkeys = "keys"\n'
            '[loop]\ncameras = 2\n[store]\npath = "poses.db"\n'
        )
        made.append(place)
    return made


def port_of(place: Path, key: str) -> int:
    """Return a port in a site file."""
    text = (place / "site.toml").read_text().split(key)[1].splitlines()[0]
    return int(text.rpartition(":")[2].strip('" =') or 0)


@dataclass(eq=False)
class Cameras:
    """The cameras of some sites: they send the view of a slot when its order says so."""

    due: list[tuple[int, int, ThinCamera, int]] = field(default_factory=list)
    changed: threading.Condition = field(default_factory=threading.Condition)
    count: int = 0

    def add(self, due_ns: int, camera: ThinCamera, slot: int) -> None:
        with self.changed:
            self.count += 1
            heapq.heappush(self.due, (due_ns, self.count, camera, slot))
            self.changed.notify()

    def run(self) -> None:
        """Send what is due, without end."""
        while True:
            with self.changed:
                while not self.due or self.due[0][0] > time.time_ns():
                    left_s = (self.due[0][0] - time.time_ns()) / 1e9 if self.due else None
                    self.changed.wait(left_s)
                due_ns, _, camera, slot = heapq.heappop(self.due)
            camera.send(slot, due_ns)


class ThinCamera:
    """A camera that needs next to no time."""

    def __init__(self, place: Path, index: int, all_cameras: Cameras) -> None:
        recording = load_recording(place / "recording")
        self.site, self.camera_id = place.name, recording.rig.camera_ids[index]
        self.cameras, self.joints = all_cameras, recording.skeleton.joints
        self.size = recording.rig.cameras[index].image_size
        self.session, self.ordered = time.time_ns() // 1000, -1
        empty = np.zeros((0, len(self.joints), 2), np.float32)
        self.views = []
        for slot in range(recording.num_slots):
            view = recording.view(slot, index)
            keypoints_px = empty if view is None else view.keypoints_px.astype(np.float32)
            scores = empty[..., 0] if view is None else view.scores.astype(np.float32)
            self.views.append((pack(keypoints_px), pack(scores)))
        keys = certificates_in(place / "keys" / "cameras" / self.camera_id, "camera")
        endpoint = f"tls/localhost:{port_of(place, 'endpoint')}"
        self.transport = open_network(Link("camera", self.site, read_endpoint(endpoint), keys))
        self.transport.be_present(self.topic("alive"))
        self.transport.subscribe(topics.of_order(self.site, self.camera_id), self.order)

    def topic(self, what: str) -> str:
        return topics.of_camera(self.site, self.camera_id, what)

    def order(self, topic: str, payload: bytes) -> None:
        order = decode(payload, Order, "edge")
        if order.active and order.slot > self.ordered:
            self.ordered = order.slot
            middle_ns = order.origin_edge_ns + order.slot * order.interval_ns
            self.cameras.add(middle_ns + DETECT_NS, self, order.slot)

    def send(self, slot: int, due_ns: int) -> None:
        keypoints_px, scores = self.views[slot % len(self.views)]
        view = View(
            self.camera_id, self.session, slot, due_ns - DETECT_NS, keypoints_px, scores,
            sent_edge_ns=time.time_ns(),
        )  # fmt: skip
        self.transport.publish(self.topic("view"), encode(view))

    def greet(self) -> None:
        hello = Hello(self.camera_id, self.session, self.joints, self.size, FPS)
        self.transport.publish(self.topic("hello"), encode(hello))

    def beat(self) -> None:
        taken = round(time.time() * FPS) % 10**9
        beat = Heartbeat(self.camera_id, self.session, time.time_ns(), "power-saving", taken)
        self.transport.publish(self.topic("heartbeat"), encode(beat))


def be_cameras(places: Sequence[Path]) -> None:
    """Be all cameras of some sites until killed."""
    together = Cameras()
    made = [
        ThinCamera(place, index, together)
        for place in places
        for index in range(len(load_recording(place / "recording").rig))
    ]
    print("cameras ready", flush=True)
    threading.Thread(target=together.run, daemon=True).start()
    for turn in range(10**9):
        for camera in made:
            if turn % HELLO_BEATS == 0:
                camera.greet()
            camera.beat()
            time.sleep(BEAT_S / len(made))


def metrics(place: Path) -> dict[str, float]:
    """Return the metrics of an edge, summed over labels; none while it does not answer."""
    url = f"http://127.0.0.1:{port_of(place, 'metrics_port')}/metrics"
    found = dict[str, float]()
    try:
        with urllib.request.urlopen(url, timeout=5.0) as answer:
            lines = answer.read().decode().splitlines()
    except OSError:
        return found
    for line in lines:
        if not line.startswith("#"):
            name, value = line.split("{")[0].split(" ")[0], float(line.split()[-1])
            found[name] = found.get(name, 0.0) + value
    return found


@dataclass(frozen=True)
class Figures:
    """What edges took and did while they were watched."""

    cpu_ms: float  # of a slot
    share: float  # of a core
    slots: float  # per second and site
    lost: float
    blind: float
    latency_ms: tuple[float, float]  # median and largest p99 of a site
    rss_mb: float
    parts_ms: dict[str, float]


def measured(kind: str, places: Sequence[Path], core: int, seconds: float) -> Figures:
    """Run edges and cameras of sites, and watch them."""
    others = sorted(os.sched_getaffinity(0) - {core}) or [core]
    with ExitStack() as stack:
        log = stack.enter_context((places[0].parent / f"{kind}.log").open("w"))

        def start(*words: str) -> subprocess.Popen[bytes]:
            process = subprocess.Popen(words, stdout=log, stderr=log)
            stack.callback(process.wait)
            stack.callback(process.terminate)
            return process

        start_one = [sys.executable, "-m", "e3pose", "edge"]
        if kind == "processes":
            edges = [start(*start_one, str(place)) for place in places]
        else:
            edges = [start(*start_one, *map(str, places))]
        end_s = time.monotonic() + START_S
        waiting = set(places)
        cameras = start(sys.executable, __file__, "--feed", *map(str, places))
        while waiting:
            waiting = {p for p in waiting if metrics(p).get("e3pose_slots_total", 0) < FPS}
            if time.monotonic() > end_s or any(edge.poll() is not None for edge in edges):
                raise SystemExit(Path(log.name).read_text()[-3000:])
            time.sleep(1.0)
        bind(cameras.pid, others)
        for edge in edges:
            bind(edge.pid, [core])
        time.sleep(SETTLE_S)
        before, parts = [metrics(place) for place in places], parts_of(edges)
        begun_s = time.monotonic()
        time.sleep(seconds)
        passed_s, after = time.monotonic() - begun_s, [metrics(place) for place in places]
        spent = {name: s - parts[name] for name, s in parts_of(edges).items()}
        rss = sum(int(Path(f"/proc/{e.pid}/statm").read_text().split()[1]) for e in edges)

        def grown(name: str) -> float:
            return sum(b.get(name, 0) - a.get(name, 0) for a, b in zip(before, after, strict=True))

        slots = grown("e3pose_slots_total")
        latencies_ms = [1e3 * one.get("e3pose_latency_seconds_p99", np.nan) for one in after]
        return Figures(
            1e3 * sum(spent.values()) / slots, sum(spent.values()) / passed_s,
            slots / passed_s / len(places), grown("e3pose_slots_lost_total"),
            grown("e3pose_slots_blind_total"),
            (float(np.median(latencies_ms)), float(np.max(latencies_ms))), rss * 4096 / 1e6,
            {name: 1e3 * s / slots for name, s in spent.items()},
        )  # fmt: skip


def bind(pid: int, cores: Sequence[int]) -> None:
    """Bind all threads of a process to cores."""
    for task in Path(f"/proc/{pid}/task").iterdir():
        os.sched_setaffinity(int(task.name), cores)


def parts_of(edges: Sequence[subprocess.Popen[bytes]]) -> dict[str, float]:
    """Return the seconds of CPU that the threads of edges took so far, by what they do."""
    total = dict[str, float]()
    for edge in edges:
        for name, spent_s in _cpu_by_part(edge.pid).items():
            total[name] = total.get(name, 0.0) + spent_s
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sites", type=int, nargs="+", default=[1, 8, 20])
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--people", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--core", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--feed", type=Path, nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.feed:
        return be_cameras(options.feed)
    print(f"{options.cameras} cameras, {options.people} people, {FPS:g} slots per second, one core")
    for sites in options.sites:
        with tempfile.TemporaryDirectory(prefix="e3pose-edges-") as name:
            places = make_sites(Path(name), sites, options.cameras, options.people)
            for kind in options.kinds:
                f = measured(kind, places, options.core, options.seconds)
                print(
                    f"{sites:>3} sites, {kind:<9}: {f.cpu_ms:.2f} ms of CPU a slot, "
                    f"{f.share:.0%} of the core, so {1e3 / FPS / f.cpu_ms:.0f} sites a core; "
                    f"{f.slots:.1f} slots a second, {f.lost:.0f} lost, {f.blind:.0f} blind; "
                    f"p99 of view to poses {f.latency_ms[0]:.1f} ms, worst site "
                    f"{f.latency_ms[1]:.1f}; {f.rss_mb:.0f} MB; load {os.getloadavg()[0]:.1f}"
                )
                print("    " + ", ".join(f"{n} {v:.2f}" for n, v in f.parts_ms.items()), flush=True)


if __name__ == "__main__":
    main()
