"""How long `e3pose reconstruct` takes beside the network alone, on the same frames, and its memory.

    python lab/benchmarks/reconstruct_speed.py CALIBRATION FILM...

Each runs in a process of its own, one after the other: the whole; the network with frames that are
decoded beforehand, one look at a time on all cores; and as many looks at a time as there are cores.
Prints their seconds, the ratio of the whole to each network, what the whole takes of the
processor, and its peak memory.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time

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
    main(*sys.argv[1:])
