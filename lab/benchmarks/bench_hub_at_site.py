"""What summaries, a hub and an archive cost the edge of one site: its CPU of a slot, as a ratio.

    python lab/benchmarks/bench_hub_at_site.py                 # two minutes

Two sites with the same scene and all of `bench_many_edges.py`: the edge of one makes summaries, a
hub asks it every five seconds, which is twelve times as often as usual, and its store is archived
again and again; that of the other makes no summaries and is asked by nobody. Both run at the same
time on the same core, so that whatever else the machine does meets both; they change places half
way. Hub and archive are programs of their own, on other cores.
"""

from __future__ import annotations

import argparse
import datetime
import os
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from bench_many_edges import FPS, SETTLE_S, START_S, bind, make_sites, metrics, parts_of, port_of
from e3pose.wire.keys.folder import add_keys
from paired import mean_interval

EVERY_S = 5.0  # between two questions of the hub
E3POSE = [sys.executable, "-m", "e3pose"]


def be_without(place: Path) -> None:
    """Be an edge that makes no summaries."""
    import e3pose.store
    from e3pose.cli import main

    make = e3pose.store.WriterSettings
    e3pose.store.WriterSettings = lambda **said: make(**{**said, "summaries": 0})  # type: ignore[assignment, misc]
    sys.argv[1:] = ["edge", str(place)]
    main()


def write_hub(folder: Path, place: Path) -> Path:
    """Write the file of a hub of one site, with a certificate of it."""
    now = datetime.datetime.now(datetime.timezone.utc)
    add_keys(place / "keys", "house", now, kind="hub")
    (folder / "hub.toml").write_text(
        f'format = "e3pose-hub"\nversion = 1\nevery_s = {EVERY_S}\n[[site]]\n'
        f'name = "{place.name}"\nendpoint = "tls/localhost:{port_of(place, "endpoint")}"\n'
        f'keys = "{place / "keys" / "hubs" / "house"}"\n'
    )
    return folder / "hub.toml"


def ratios(folder: Path, swapped: bool, core: int, windows: int, seconds: float) -> list[float]:
    """Run both, and return how much CPU a slot takes with a hub over that without, by window."""
    places = make_sites(folder, 2, cameras=4, people=2, alike=True)
    plain, asked = places[::-1] if swapped else places
    others = sorted(os.sched_getaffinity(0) - {core}) or [core]
    with ExitStack() as stack:
        log = stack.enter_context((folder / "log").open("w"))

        def start(*words: str) -> subprocess.Popen[bytes]:
            process = subprocess.Popen(words, stdout=log, stderr=log)
            stack.callback(process.wait)
            stack.callback(process.terminate)
            return process

        script = str(Path(__file__).with_name("bench_many_edges.py"))
        cameras = start(sys.executable, script, "--feed", *map(str, places))
        edges = {
            plain: start(sys.executable, __file__, "--without", str(plain)),
            asked: start(*E3POSE, "edge", str(asked)),
        }
        end_s = time.monotonic() + START_S
        while any(metrics(place).get("e3pose_slots_total", 0) < FPS for place in places):
            if time.monotonic() > end_s or any(one.poll() is not None for one in edges.values()):
                raise SystemExit((folder / "log").read_text()[-3000:])
            time.sleep(1.0)
        hub = start(*E3POSE, "hub", "run", str(write_hub(folder, asked)))
        for process, cores in (
            (cameras, others),
            (hub, others),
            *((e, [core]) for e in edges.values()),
        ):
            bind(process.pid, cores)
        time.sleep(SETTLE_S)
        found = list[float]()
        for _ in range(windows):
            start(*E3POSE, "archive", str(asked / "poses.db"), str(folder / "archive"))
            before = {p: (sum(parts_of([e]).values()), slots(p)) for p, e in edges.items()}
            time.sleep(seconds)
            cost = {}
            for place, edge in edges.items():
                spent_s = sum(parts_of([edge]).values()) - before[place][0]
                cost[place] = 1e3 * spent_s / (slots(place) - before[place][1])
            found.append(cost[asked] / cost[plain])
            print(f"  {cost[plain]:.2f} ms of CPU a slot without, {cost[asked]:.2f} with a hub; "
                  f"load {os.getloadavg()[0]:.1f}", flush=True)  # fmt: skip
        return found


def slots(place: Path) -> float:
    return metrics(place)["e3pose_slots_total"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--windows", type=int, default=4, help="of each half")
    parser.add_argument("--seconds", type=float, default=10.0, help="of a window")
    parser.add_argument("--core", type=int, default=0)
    parser.add_argument("--without", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.without:
        return be_without(options.without)
    found = list[float]()
    for swapped in (False, True):
        with tempfile.TemporaryDirectory(prefix="e3pose-site-") as name:
            folder = Path(name)
            found += ratios(folder, swapped, options.core, options.windows, options.seconds)
    ratio = mean_interval(np.array(found))
    print(f"CPU of an edge with summaries, hub and archive over that without: {ratio.mean:.3f} "
          f"({ratio.low:.3f} to {ratio.high:.3f}, 95 %, {len(found)} windows)")  # fmt: skip


if __name__ == "__main__":
    main()
