"""Does anything grow? A site of real processes for a while; memory and threads, printed.

python lab/benchmarks/soak.py --minutes 30
python lab/benchmarks/soak.py --minutes 30 --no-churn
python lab/benchmarks/soak.py --up --minutes 120 --every 60   # `e3pose up --example --view`

Viewers, visitors of the page and a camera come and go meanwhile. Growth per hour is a line through
the second half of the time: a short run says what an hour would bring if it went on so.
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import itertools
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import psutil
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect as connect_socket

from e3pose.base.bounded import bytes_of
from e3pose.settings.site_file import load_site
from e3pose.site.example import make_example
from e3pose.site.follow import Follower, viewer_link
from e3pose.wire import topics
from e3pose.wire.access import Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import certificates_in
from e3pose.wire.network import open_network
from live_site import Sample, Site, live_site, wait

GROWTH_MB = 10.0  # from the second fifth of the time to the last: more is a leak
VIEWERS, VISITORS = 3, 3  # that come and go at the same time
ENTRY_S = 10.0
PAUSE_S = 0.2  # of each of those at the page, between two visits


@contextlib.contextmanager
def churn(site: Site, viewers: int, visitors: int, camera_id: str) -> Iterator[Counter[str]]:
    """Let viewers, visitors of the page and a camera come and go meanwhile, and count them.

    Args:
        site: with a page.
        viewers: how many come and go at the same time.
        visitors: likewise, of the page.
        camera_id: a camera of the site without a program.
    """
    stopping, seen = threading.Event(), Counter[str]()
    path = site.folder / "site.toml"
    port = site.page_port
    assert port is not None
    kinds: list[tuple[str, Callable[[], object]]] = [
        *[("viewers", lambda: _view(path))] * viewers,
        *zip(
            itertools.repeat("visitors", visitors),
            itertools.cycle([lambda: _ask(port), lambda: _follow(port), lambda: _leave(port)]),
            strict=False,
        ),
        ("cameras", lambda: _appear(path, camera_id)),
    ]

    def repeat(kind: str, visit: Callable[[], object]) -> None:
        while not stopping.is_set():
            with contextlib.suppress(OSError, http.client.HTTPException, WebSocketException):
                visit()
            seen[kind] += 1
            if kind == "visitors":
                stopping.wait(PAUSE_S)

    threads = [threading.Thread(target=repeat, args=one, daemon=True) for one in kinds]
    for thread in threads:
        thread.start()
    try:
        yield seen
    finally:
        stopping.set()
        for thread in threads:
            thread.join(ENTRY_S)


def _view(path: Path) -> None:
    """Join as a viewer, wait for a message, leave."""
    transport, follower = open_network(viewer_link(load_site(path), None)), Follower("bench")
    follower.listen(transport)
    follower.fresh.wait(ENTRY_S)
    transport.close()


def _ask(port: int) -> None:
    """Load the page and the status over one connection."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=ENTRY_S)
    for target in ("/", "/main.js", "/api/site", "/api/status", "/api/poses?start=-2s"):
        connection.request("GET", target)
        connection.getresponse().read()
    connection.close()


def _follow(port: int) -> None:
    """Follow some slots."""
    with connect_socket(f"ws://127.0.0.1:{port}/api/live", open_timeout=ENTRY_S) as following:
        for _ in range(5):
            following.recv(ENTRY_S)


def _leave(port: int) -> None:
    """Follow by server-sent events and go without a word."""
    with socket.create_connection(("127.0.0.1", port), timeout=ENTRY_S) as connection:
        connection.sendall(b"GET /api/live HTTP/1.1\r\nHost: localhost\r\n\r\n")
        connection.recv(1000)


def _appear(path: Path, camera_id: str) -> None:
    """Join with a camera's certificate, be present for a moment, leave."""
    site = load_site(path)
    files = certificates_in(site.keys / "cameras" / camera_id, "camera")
    port = site.link.endpoint.port
    transport = open_network(
        Link("camera", site.name, read_endpoint(f"tls/localhost:{port}"), files)
    )
    heard = threading.Event()
    transport.subscribe(topics.of_order(site.name, camera_id), lambda *_: heard.set())
    transport.be_present(topics.of_camera(site.name, camera_id, "alive"))
    end_s = time.monotonic() + ENTRY_S
    while not transport.connected() and time.monotonic() < end_s:
        wait(0.02)
    heard.wait(2.0)
    transport.close()


def medians(samples: list[Sample]) -> tuple[Sample, Sample]:
    """Return the middle of the second and of the last fifth of the samples."""
    fifth = max(1, len(samples) // 5)

    def middle(part: list[Sample]) -> Sample:
        at_s, *rest = np.median(_columns(part), axis=0).tolist()
        return Sample(at_s, *(int(value) for value in rest))

    return middle(samples[fifth : 2 * fifth] or samples[:1]), middle(samples[-fifth:])


def per_hour_mb(samples: list[Sample]) -> tuple[float, float, float]:
    """Return the growth of edge, all cameras and page by a line through the second half."""
    columns = _columns(samples[len(samples) // 2 :])
    if len(columns) < 3:
        return 0.0, 0.0, 0.0
    rss = columns[:, [1, 3, 5]]
    edge, cameras, page = (np.polyfit(columns[:, 0] / 3600, rss / 1e6, 1)[0]).tolist()
    return edge, cameras, page


def _columns(samples: list[Sample]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.array([
        [s.at_s, s.edge_rss, s.edge_threads, s.camera_rss, s.camera_threads, s.page_rss,
         s.page_threads]
        for s in samples
    ])  # fmt: skip


def watch_up(minutes: float, every_s: float, fps: float) -> None:
    """Run the example with `up --view`, kill its cameras in turn, visit its page; print growth.

    Args:
        minutes: for how long.
        every_s: between two looks, in whose middle a camera is killed.
        fps: slots per second.
    """
    looks: list[dict[str, tuple[float, float]]] = []  # bytes and descriptors, by program
    with tempfile.TemporaryDirectory(prefix="e3pose-soak-") as name:
        path = make_example(Path(name) / "try")
        path.write_text(re.sub(r"(?m)^fps = .*", f"fps = {fps}", path.read_text()))
        words = [sys.executable, "-m", "e3pose", "up", str(path), "--view"]
        log, begun_s = Path(name) / "up.log", time.monotonic()
        with log.open("w") as output, subprocess.Popen(words, stdout=output) as running:
            try:
                while not (page := re.search(r"http://127\.0\.0\.1:(\d+)/", log.read_text())):
                    wait(0.2)
                visits = itertools.cycle(partial(v, int(page[1])) for v in (_ask, _follow, _leave))
                for number in itertools.count():
                    programs = _programs(psutil.Process(running.pid))
                    held = {who: (p.memory_info().rss, p.num_fds()) for who, p in programs.items()}
                    looks.append({**held, "files": (bytes_of(path.parent), 0)})
                    print(f"{time.monotonic() - begun_s:6.0f} s  {looks[-1]}", flush=True)
                    if time.monotonic() - begun_s > 60 * minutes:
                        break
                    for part in range(10):
                        failures = OSError, WebSocketException, http.client.HTTPException
                        with contextlib.suppress(psutil.Error, *failures):
                            if part == 5 and (camera := programs.get(f"cam{number % 4}")):
                                camera.kill()
                            next(visits)()
                        wait(every_s / 10)
            finally:
                running.send_signal(signal.SIGINT)
    half = looks[len(looks) // 2 :]
    hours = np.arange(len(half)) * every_s / 3600
    for who in half[-1]:
        sizes, handles = np.array([each.get(who, (np.nan, 0)) for each in half]).T
        there = np.isfinite(sizes)
        growth = np.polyfit(hours[there], sizes[there] / 1e6, 1)[0] if there.sum() > 2 else 0.0
        most = f"{int(handles.max())} descriptors at most"
        print(f"{who}: {sizes[there][-1] / 1e6:.1f} MB, {growth:+.2f} MB per hour, {most}")


def _programs(up: psutil.Process) -> dict[str, psutil.Process]:
    """Return `up` and its programs by the words of their commands."""
    found = {"up": up}
    for child in up.children(recursive=True):
        with contextlib.suppress(psutil.Error, ValueError):
            words = child.cmdline()
            verb = words[words.index("e3pose") + 1]
            found[words[words.index("--name") + 1] if verb == "camera" else verb] = child
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--cameras", type=int, default=5)
    parser.add_argument("--people", type=int, default=4)
    parser.add_argument("--every", type=float, default=5.0, help="seconds between samples")
    parser.add_argument("--growth", type=float, default=GROWTH_MB, help="megabytes that are a leak")
    parser.add_argument("--churn", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--up", action="store_true", help="the example site, cameras killed")
    parser.add_argument("--fps", type=float, default=5.0, help="with --up: slots per second")
    options = parser.parse_args()
    if options.up:
        watch_up(options.minutes, options.every, options.fps)
        return
    with contextlib.ExitStack() as stack:
        spare = int(options.churn)
        site = stack.enter_context(
            live_site(options.cameras, options.people, page=options.churn, spare=spare)
        )
        seen: Counter[str] = Counter()
        if options.churn:
            spare_id = f"cam{options.cameras - 1}"
            seen = stack.enter_context(churn(site, VIEWERS, VISITORS, spare_id))
        lost = 0
        while (sample := site.sample()).at_s < options.minutes * 60:
            status = site.follower.status
            assert status is not None
            lost = status.slots_lost
            came = "".join(f"  {count} {kind}" for kind, count in sorted(seen.items()))
            print(
                f"{sample.at_s:6.0f} s  slot {status.slot}  edge {sample.edge_rss / 1e6:.1f} MB "
                f"{sample.edge_threads} threads  cameras {sample.camera_rss / 1e6:.1f} MB "
                f"{sample.camera_threads} threads  page {sample.page_rss / 1e6:.1f} MB "
                f"{sample.page_threads} threads  {status.slots_lost} slots lost{came}",
                flush=True,
            )
            wait(options.every)
    running = options.cameras - spare
    early, late = medians(site.samples)
    growth = (late.edge_rss - early.edge_rss) / 1e6
    cameras = (late.camera_rss - early.camera_rss) / 1e6 / running
    page = (late.page_rss - early.page_rss) / 1e6
    edge_h, cameras_h, page_h = per_hour_mb(site.samples)
    came = ", ".join(f"{count} {kind}" for kind, count in sorted(seen.items())) or "nobody"
    print(
        f"came and went: {came}; "
        f"per hour, from the last {options.minutes / 2:g} min: edge {edge_h:+.1f} MB, page "
        f"{page_h:+.1f} MB, a camera {cameras_h / running:+.1f} MB"
    )
    print(
        f"in {late.at_s - early.at_s:.0f} s the edge grew by {growth:+.1f} MB and "
        f"{late.edge_threads - early.edge_threads:+d} threads, the page by {page:+.1f} MB, "
        f"a camera by {cameras:+.1f} MB, "
        f"all cameras by {late.camera_threads - early.camera_threads:+d} threads; "
        f"{lost} slots lost"
    )
    # Threads of the network library come and go with sessions.
    threads = not options.churn and late.edge_threads > early.edge_threads
    threads = threads or late.camera_threads > early.camera_threads
    if max(growth, cameras, page) > options.growth or threads:
        sys.exit("something grows")


if __name__ == "__main__":
    main()
