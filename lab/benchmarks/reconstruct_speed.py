"""How long `e3pose reconstruct` takes beside the network alone, on the same frames, and its memory.

    python lab/benchmarks/reconstruct_speed.py CALIBRATION FILM...

Both run one after the other in processes of their own: the network with frames that are decoded
beforehand, as fast as it goes, and the whole. Prints seconds, their ratio and the peak memory.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ALONE = """
import sys, time
from e3pose.camera.source import open_video
from e3pose.detectors import chosen_name, make_detector
detector, spent_s, frames = make_detector(chosen_name("auto", None, live=False)), 0.0, 0
for film in sys.argv[1:]:
    for frame in open_video(film).frames():
        image = frame.image
        begun_s = time.perf_counter()
        detector.detect(image)
        spent_s, frames = spent_s + time.perf_counter() - begun_s, frames + 1
print(spent_s, frames)
"""


def main(calibration: str, *films: str) -> None:
    """Measure, and print JSON."""
    ended = subprocess.run(
        [sys.executable, "-c", ALONE, *films], capture_output=True, text=True, check=True
    )
    network_s, frames = map(float, ended.stdout.split())
    with tempfile.TemporaryDirectory() as folder:
        words = [
            "reconstruct",
            *films,
            "--calibration",
            calibration,
            "--out",
            str(Path(folder, "r")),
        ]
        begun_s = time.perf_counter()
        subprocess.run([sys.executable, "-m", "e3pose", *words], check=True, capture_output=True)
        whole_s = time.perf_counter() - begun_s
    peak_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    found = {"frames": int(frames), "network_s": round(network_s, 1), "whole_s": round(whole_s, 1)}
    print(json.dumps({**found, "ratio": round(whole_s / network_s, 2), "peak_mb": round(peak_mb)}))


if __name__ == "__main__":
    main(*sys.argv[1:])
