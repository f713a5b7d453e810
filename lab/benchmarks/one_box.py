"""Cameras of one computer: a process each against one program for all of them.

    python lab/benchmarks/one_box.py --model FOLDER_OR_FILE     # two minutes on an idle machine

The four films of the demo's clip are played at a quarter of their speed as cameras of a site. All
four look as often as they can, for looks per second and memory (proportional set size); then two of
four look in each of five slots per second, for the time from a frame to the arrival of its view.
Each figure stands beside its ratio to that of a process each, in the same run.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from e3pose.recording.calibration import load_calibration
from e3pose.settings.resolved import resolve_site
from e3pose.site.demo_clip import find_clip
from e3pose.site.example import Example, write_example
from e3pose.site.follow import Follower, viewer_link
from e3pose.site.up import Program, camera_program, cameras_program, edge_command, end
from e3pose.wire import topics
from e3pose.wire.codec import decode
from e3pose.wire.messages import View
from e3pose.wire.network import open_network

WAIT_S = 120.0  # for the first view
SETTLE_S = 5.0
PACE = 0.25  # of the films, so that decoding 60 frames per second is not most of the work
BUSY, CALM = (4, 60.0), (2, 20.0)  # cameras per slot, slots per second of the scene


@dataclass
class Found:
    """What a site did in a while.

    Attributes:
        seconds: the while.
        late_ms: of each view, from its frame to its arrival.
        memory_mb: of the camera programs.
    """

    seconds: float
    late_ms: list[float] = field(default_factory=list)
    memory_mb: float = 0.0

    @property
    def looks_hz(self) -> float:
        """Looks per second of all cameras."""
        return len(self.late_ms) / self.seconds

    def late(self) -> float:
        """Median from a frame to the arrival of its view, ms."""
        return float(np.median(self.late_ms))


def site_file(folder: Path, model: Path, cameras: int, fps: float) -> Path:
    """Write a site whose cameras play the clip; return its file."""
    clip = find_clip()
    if clip is None:
        raise SystemExit("no clip in the cache: `e3pose demo` fetches it")
    rig = load_calibration(clip.calibration).rig
    sources = {path.stem: str(path) for path in clip.videos}
    names = {camera_id: sources[camera_id] for camera_id in rig.camera_ids}
    detector = {"detector": str(model)}
    example = Example("box", names, fps, "coco17", cameras, PACE, 2000.0, detector)
    return write_example(folder, example, rig)


def measure(together: bool, cameras: int, fps: float, model: Path, seconds: float) -> Found:
    """Run a site and return what it did."""
    with tempfile.TemporaryDirectory(prefix="e3pose-box-") as name:
        folder = Path(name)
        site = resolve_site(site_file(folder, model, cameras, fps))
        boxes = [cameras_program(site, folder)]
        if not together:
            boxes = [camera_program(site, each, folder) for each in site.cameras]
        programs = [Program("edge", edge_command(site.file.path), folder / "edge.log"), *boxes]
        late_ms: list[float] = []

        def came(_topic: str, payload: bytes) -> None:
            view = decode(payload, View, "camera")
            late_ms.append((time.time_ns() - view.captured_edge_ns) / 1e6)

        follower = Follower(site.file.name)
        with closing(open_network(viewer_link(site.file, None))) as transport:
            follower.listen(transport)
            transport.subscribe(topics.of_camera(site.file.name, topics.ANY, "view"), came)
            try:
                for program in programs:
                    program.start()
                begun_s = time.monotonic()
                while not late_ms or follower.status is None or follower.status.compiling_s:
                    ended = [program for program in programs if program.ended() is not None]
                    if ended or time.monotonic() - begun_s > WAIT_S:
                        said = "\n".join(p.log.read_text()[-1000:] for p in programs)
                        raise SystemExit(f"the site does not run: {said}")
                    time.sleep(0.2)
                time.sleep(SETTLE_S)
                late_ms.clear()
                begun_s = time.monotonic()
                time.sleep(seconds)
                found = Found(time.monotonic() - begun_s, list(late_ms))
                found.memory_mb = sum(
                    psutil.Process(box.process.pid).memory_full_info().pss / 1e6
                    for box in boxes
                    if box.process is not None
                )
            finally:
                end(programs)
        return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--model", type=Path, required=True, help="file of the network")
    parser.add_argument("--seconds", type=float, default=15.0, help="of each of four runs")
    asked = parser.parse_args()
    for what, (cameras, fps) in (("all look", BUSY), ("two of four look", CALM)):
        each, one = (
            measure(together, cameras, fps, asked.model, asked.seconds)
            for together in (False, True)
        )
        print(f"{what}, {PACE * fps:g} slots per second: a process each, one program, ratio")
        for name, before, after in (
            ("looks per second", each.looks_hz, one.looks_hz),
            ("median from frame to view, ms", each.late(), one.late()),
            ("memory, MB", each.memory_mb, one.memory_mb),
        ):
            print(f"  {name:30} {before:7.1f} {after:7.1f} {after / before:6.2f}")


if __name__ == "__main__":
    main()
