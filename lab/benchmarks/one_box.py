"""Cameras of one computer: a process each against one program for all of them.

    python lab/benchmarks/one_box.py --model FOLDER_OR_FILE     # two minutes on an idle machine
    python lab/benchmarks/one_box.py --model FILE --decoding    # likewise

The four films of the demo's clip are played at a quarter of their speed as cameras of a site. All
four look as often as they can, for looks per second and memory (proportional set size); then two of
four look in each of five slots per second, for the time from a frame to the arrival of its view.
Each figure stands beside its ratio to that of a process each, in the same run.

With --decoding: one program, one and two of four look, once where all pictures of the films are
decoded and once where those are that are needed. Processor time is that of the program, and its
part outside looks; a view must not come later. Then the films are decoded by the same orders and
nothing else is done, for the processor time of decoding alone.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from e3pose.camera.source import VideoSource, open_video
from e3pose.recording.calibration import load_calibration
from e3pose.settings.resolved import resolve_site
from e3pose.site.demo_clip import find_clip
from e3pose.site.example import Example, write_example
from e3pose.site.follow import Follower, viewer_link
from e3pose.site.up import Program, camera_program, cameras_program, edge_command, end
from e3pose.wire import topics
from e3pose.wire.codec import decode
from e3pose.wire.messages import Heartbeat, View
from e3pose.wire.network import open_network

WAIT_S = 120.0  # for the first view
SETTLE_S = 5.0
PACE = 0.25  # of the films, so that decoding 60 frames per second is not most of the work
BUSY, CALM = (4, 60.0), (2, 20.0)  # cameras per slot, slots per second of the scene
FEW = (1, 20.0)
# Starts a program whose films are decoded whole.
WHOLE = (
    "from e3pose.camera.live_source import PacedSource;"
    "PacedSource.need = lambda self, in_s: None;"
    "from e3pose.cli import main; main()"
)


@dataclass
class Found:
    """Figures of a site over a stretch of time.

    Attributes:
        seconds: the while.
        late_ms: of each view, from its frame to its arrival.
        memory_mb: of the camera programs.
        cpu_s: processor time of the camera programs.
        beside_s: part of it outside looks, by the heartbeats.
        slots: in which each camera looked.
        lead: slots from an order's making to its slot.
    """

    seconds: float
    late_ms: list[float] = field(default_factory=list)
    memory_mb: float = 0.0
    cpu_s: float = 0.0
    beside_s: float = 0.0
    slots: dict[str, set[int]] = field(default_factory=dict)
    lead: int = 1

    @property
    def looks_hz(self) -> float:
        """Looks per second of all cameras."""
        return len(self.late_ms) / self.seconds

    def late(self, percent: float = 50.0) -> float:
        """From a frame to the arrival of its view, ms, in this percentile."""
        return float(np.percentile(self.late_ms, percent))


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


def measure(
    together: bool, cameras: int, fps: float, model: Path, seconds: float, whole: bool = False
) -> Found:
    """Run a site and return its figures; `whole` decodes all pictures."""
    with tempfile.TemporaryDirectory(prefix="e3pose-box-") as name:
        folder = Path(name)
        site = resolve_site(site_file(folder, model, cameras, fps))
        boxes = [cameras_program(site, folder)]
        if not together:
            boxes = [camera_program(site, each, folder) for each in site.cameras]
        for box in boxes if whole else ():
            box.command = [sys.executable, "-c", WHOLE, *box.command[3:]]
        programs = [Program("edge", edge_command(site.file.path), folder / "edge.log"), *boxes]
        late_ms: list[float] = []
        beats: dict[str, Heartbeat] = {}
        slots: dict[str, set[int]] = {}

        def beat(_topic: str, payload: bytes) -> None:
            heard = decode(payload, Heartbeat, "camera")
            beats[heard.camera_id] = heard

        def cpu_s() -> tuple[float, float]:
            ids = [box.process.pid for box in boxes if box.process is not None]
            spent = sum(sum(psutil.Process(each).cpu_times()[:2]) for each in ids)
            return spent, sum((b.cpu_s or 0.0) - b.look_cpu_s for b in beats.values())

        def came(_topic: str, payload: bytes) -> None:
            view = decode(payload, View, "camera")
            late_ms.append((time.time_ns() - view.captured_edge_ns) / 1e6)
            slots.setdefault(view.camera_id, set()).add(view.slot)

        follower = Follower(site.file.name)
        with closing(open_network(viewer_link(site.file, None))) as transport:
            follower.listen(transport)
            transport.subscribe(topics.of_camera(site.file.name, topics.ANY, "view"), came)
            transport.subscribe(topics.of_camera(site.file.name, topics.ANY, "heartbeat"), beat)
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
                begun_s, before = time.monotonic(), cpu_s()
                time.sleep(seconds)
                found = Found(time.monotonic() - begun_s, list(late_ms), slots=slots)
                found.lead = follower.status.lead
                found.cpu_s, found.beside_s = np.subtract(cpu_s(), before)
                found.memory_mb = sum(
                    psutil.Process(box.process.pid).memory_full_info().pss / 1e6
                    for box in boxes
                    if box.process is not None
                )
            finally:
                end(programs)
        return found


def decoding_s(found: Found, fps: float) -> tuple[float, float]:
    """Return the processor time of decoding all of the films, and by the orders of a run."""
    clip = find_clip()
    assert clip is not None
    whole_s = needed_s = 0.0
    for path in clip.videos:
        video = open_video(path)
        assert isinstance(video, VideoSource)
        active, each = (
            found.slots.get(path.stem, set()),
            round(video.rate / fps),
        )  # frames in a slot
        first, last = min(active, default=0), max(active, default=0)
        for begin in range(first, last, video.num_frames // each):
            begun_s = time.process_time()
            for _ in video.frames():
                pass
            whole_s += time.process_time() - begun_s
            begun_s = time.process_time()
            for number, (_, coded) in enumerate(video.coded()):
                slot, stream = begin + number // each, coded.stream
                if number % each == each // 2 and slot in active:
                    coded.decode()
                ahead = range(slot + 1, slot + found.lead)
                free = next((s for s in ahead if s in active), slot + found.lead) - slot - 0.5
                assert stream is not None
                stream.keep_up(free / fps / PACE, 1 / video.rate / PACE)
            needed_s += time.process_time() - begun_s
    return whole_s, needed_s


def compare(name: str, before: float, after: float) -> None:
    """Print two figures and their ratio."""
    print(f"  {name:30} {before:7.1f} {after:7.1f} {after / before:6.2f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--model", type=Path, required=True, help="file of the network")
    parser.add_argument("--seconds", type=float, default=15.0, help="of each of four runs")
    parser.add_argument("--decoding", action="store_true", help="compare decoding on demand")
    asked = parser.parse_args()
    if asked.decoding:
        for cameras, fps in (FEW, CALM):
            whole, needed = (
                measure(True, cameras, fps, asked.model, asked.seconds, each)
                for each in (True, False)
            )
            print(f"{cameras} of four look: all pictures decoded, those needed, ratio")
            compare(
                "processor time, % of a core", *(100 * f.cpu_s / f.seconds for f in (whole, needed))
            )
            compare("  outside looks", *(100 * f.beside_s / f.seconds for f in (whole, needed)))
            compare("looks per second", whole.looks_hz, needed.looks_hz)
            compare("median from frame to view, ms", whole.late(), needed.late())
            compare(
                "mean from frame to view, ms", *(float(np.mean(f.late_ms)) for f in (whole, needed))
            )
            compare("95 % from frame to view, ms", whole.late(95), needed.late(95))
            compare("memory, MB", whole.memory_mb, needed.memory_mb)
            compare("decoding alone, s", *decoding_s(needed, fps))
        return
    for what, (cameras, fps) in (("all look", BUSY), ("two of four look", CALM)):
        each, one = (
            measure(together, cameras, fps, asked.model, asked.seconds)
            for together in (False, True)
        )
        print(f"{what}, {PACE * fps:g} slots per second: a process each, one program, ratio")
        compare("looks per second", each.looks_hz, one.looks_hz)
        compare("median from frame to view, ms", each.late(), one.late())
        compare("memory, MB", each.memory_mb, one.memory_mb)


if __name__ == "__main__":
    main()
