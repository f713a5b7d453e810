"""How long `e3pose reconstruct` takes beside the network alone, on the same frames, and its memory.

    python lab/benchmarks/reconstruct_speed.py CALIBRATION FILM...
    python lab/benchmarks/reconstruct_speed.py --memory [SLOTS SLOTS [STEP...]]

Each runs in a process of its own, one after the other: the whole; the network with frames that are
decoded beforehand, one look at a time on all cores; and as many looks at a time as there are cores.
Prints their seconds, the ratio of the whole to each network, what the whole takes of the
processor, and its peak memory.

With `--memory` each step of it runs in a process of its own on two made-up scenes of four cameras
and three people, one longer than the other. Prints the megabytes of memory of each, how many
kilobytes a slot more takes, in memory, in temporary files (the most at a time, of one process and
of all) and in the files that the step leaves, and the megabytes of memory that an hour of 30 slots
per second then takes.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
from numpy.typing import NDArray

from e3pose.recording import Recording, load_recording, save_recording
from e3pose.recording.record import ViewSeries

ALONE = """
import sys, time
from functools import partial
from itertools import islice
from e3pose.base.threads import in_order
from e3pose.camera.source import open_video
from e3pose.detectors import chosen_name, looks_at_a_time, make_detector, side_by_side
load = partial(make_detector, chosen_name("auto", None, live=False), None, "auto")
detector = load(None) if sys.argv[1] == "one" else side_by_side(load)
looks, spent_s, frames = looks_at_a_time([detector]), 0.0, 0
for film in sys.argv[2:]:
    shown = open_video(film).frames()
    while images := [frame.image for frame in islice(shown, 50)]:
        begun_s = time.perf_counter()
        list(in_order(detector.detect, images, looks))
        spent_s, frames = spent_s + time.perf_counter() - begun_s, frames + len(images)
print(spent_s, frames)
"""


HOUR = 108_000  # slots, 30 per second
KINDS = ("memory", "temporary", "all_temporary", "left")
LOOK_S = 0.2  # between two looks at what a process has open
STEPS = {  # of `reconstruct`; @ is the folder of the recording
    "detect": "detect a=@F.mp4 b=@F.mp4 c=@F.mp4 d=@F.mp4 @found --model drawn_people:Three",
    "poses": "replay @R --cameras all --smooth rts --hold-out each --poses @p.parquet "
    "--report @r.html --json @f.json",
    **{form: f"export @p.parquet @p.{form}" for form in ("trc", "mot", "glb", "c3d")},
    "angles": "export @p.parquet @angles.csv --angles",
    "calibrate": "calibrate extrinsics @R @rig.toml --height 171cm --force",  # of two minutes
}
THREE = """
import numpy as np
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
class Three:
    skeleton = COCO17
    def detect(self, image):
        return Poses2D(np.full((3, 17, 2), 9.0), np.ones((3, 17)))
"""


def made_up(folder: Path, num_slots: int) -> None:
    """Write a recording in which people walk to and fro, and a film of as many pictures."""
    words = ["simulate", folder / "short", "--people", 3, "--cameras", 4, "--seconds", 20]
    _e3pose([*map(str, words), "--fps", "30", "--seed", "701"])
    short = load_recording(folder / "short")
    back = 2 * short.num_slots - 2
    order = np.abs((np.arange(num_slots) + short.num_slots - 1) % back - short.num_slots + 1)
    views = []
    for series in short.views:
        frames = np.searchsorted(series.slots, order)
        counts = np.diff(series.starts)[frames]
        rows = [np.arange(series.starts[i], series.starts[i + 1]) for i in frames.tolist()]
        starts, people = np.concatenate([[0], np.cumsum(counts)]), np.concatenate(rows)
        slots = np.arange(num_slots)
        places = series.keypoints_px[people], series.scores[people]
        views.append(ViewSeries(slots, slots / short.fps, starts, *places))
    long: Recording = replace(short, num_slots=num_slots, views=tuple(views), truth=None)
    save_recording(long, folder / "R")
    import av

    with av.open(str(folder / "F.mp4"), "w") as file:
        stream = file.add_stream("mpeg4", rate=30)
        stream.width, stream.height = 64, 48
        for _ in range(num_slots):
            file.mux(stream.encode(av.VideoFrame(64, 48, "yuv420p")))
        file.mux(stream.encode(None))
    (folder / "drawn_people.py").write_text(THREE)


def memory(few: str = "4000", many: str = "12000", *names: str) -> None:
    """Measure each step, and print JSON."""
    more = int(many) - int(few)
    with tempfile.TemporaryDirectory() as made:
        folders = [Path(made) / number for number in (few, many)]
        for folder, number in zip(folders, (few, many), strict=True):
            made_up(folder, int(number))
        for name, step in STEPS.items():
            if names and name not in names:
                continue
            took = [_e3pose(step.replace("@", f"{each}/").split(), each) for each in folders]
            slopes = (took[1] - took[0]) / more
            kb = dict(zip(KINDS, (round(1e3 * slope, 1) for slope in slopes), strict=True))
            said = {"mb": [round(each[0]) for each in took], "kb_a_slot": kb}
            hour = round(took[1][0] + slopes[0] * (HOUR - int(many)))
            print(json.dumps({"step": name, **said, "mb_of_an_hour": hour}), flush=True)


def _e3pose(words: list[str], path: Path | None = None) -> NDArray[np.float64]:
    """Run a command in a folder.

    Returns:
        Megabytes: its peak memory; the most of its temporary files, of one process and of all; and
        of the files that it left.
    """
    before = _megabytes(path.rglob("*")) if path else 0.0
    begun = subprocess.Popen(
        [sys.executable, "-m", "e3pose", *words],
        stdout=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": str(path or "")},
    )
    most = np.zeros(2)
    while not (ended := os.wait4(begun.pid, os.WNOHANG))[0]:
        with suppress(psutil.Error, OSError):
            process = psutil.Process(begun.pid)
            held = [_temporary(each.pid) for each in (process, *process.children(recursive=True))]
            most = np.maximum(most, (max(held), sum(held)))
        time.sleep(LOOK_S)
    if ended[1]:
        raise SystemExit(f"e3pose {' '.join(words)}: code {os.waitstatus_to_exitcode(ended[1])}")
    left = _megabytes(path.rglob("*")) if path else 0.0
    return np.array([ended[2].ru_maxrss / 1e3, *most, left - before])


def _temporary(pid: int) -> float:
    """Return the megabytes of the files without a name that a process has open."""
    total = 0
    for name in os.listdir(f"/proc/{pid}/fd"):
        with suppress(OSError):  # closed meanwhile
            place = os.readlink(f"/proc/{pid}/fd/{name}")
            if place.startswith(tempfile.gettempdir()) and place.endswith("(deleted)"):
                total += os.stat(f"/proc/{pid}/fd/{name}").st_size
    return total / 1e6


def _megabytes(files: Iterable[Path]) -> float:
    return sum(file.stat().st_size for file in files if file.is_file()) / 1e6


def main(calibration: str, *films: str) -> None:
    """Measure, and print JSON."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["reconstruct", *films, "--calibration", calibration, "--out", f"{folder}/r"]
        begun_s = time.perf_counter()
        subprocess.run([sys.executable, "-m", "e3pose", *words], check=True, capture_output=True)
        whole_s = time.perf_counter() - begun_s
    whole = resource.getrusage(resource.RUSAGE_CHILDREN)  # before there are others
    processor_s = whole.ru_utime + whole.ru_stime
    network_s, frames = {}, 0.0
    for looks in ("one", "many"):
        words = [sys.executable, "-c", ALONE, looks, *films]
        said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
        network_s[looks], frames = map(float, said.split())
    found = {
        "frames": int(frames),
        "network_s": {looks: round(seconds, 1) for looks, seconds in network_s.items()},
        "whole_s": round(whole_s, 1),
        "ratio": {looks: round(whole_s / seconds, 2) for looks, seconds in network_s.items()},
        "processor_s": round(processor_s, 1),
        "peak_mb": round(whole.ru_maxrss / 1024),
    }
    print(json.dumps(found))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--memory"]:
        memory(*sys.argv[2:])
    else:
        main(*sys.argv[1:])
