"""How often the motion gate lets a network rest, and what it saves of a camera's processor time.

    python lab/benchmarks/gate.py --detector openpose-thin=FILE.onnx

Plays the demo's four real videos at 20 slots per second through `camera.gate`, every camera looking
in every slot; then the first image of each with the noise of a sensor drawn anew (4 grey levels),
as of a room in which nobody moves. Processor time is of this machine, one thread, without decoding.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from e3pose.camera.gate import Gate
from e3pose.camera.source import open_video
from e3pose.detectors import make_detector
from e3pose.detectors.base import Image
from e3pose.site.demo.clip import find_clip

EVERY, FPS, NOISE = 3, 20.0, 4.0


def standing(image: Image, frames: int, seed: int) -> Iterator[Image]:
    """Yield an image again and again, with other noise."""
    rng = np.random.default_rng(seed)
    for _ in range(frames):
        noisy = image + rng.normal(scale=NOISE, size=image.shape)
        yield np.asarray(np.clip(noisy, 0, 255), np.uint8)


def looked(gate: Gate, images: Sequence[Image]) -> tuple[int, float]:
    """Return in how many images the network rested, and processor seconds of all."""
    rested, spent_s = 0, 0.0
    for slot, image in enumerate(images):
        begun_s = time.process_time()
        rested += gate.look(image, None, round((slot + 1) / FPS * 1e9)).unchanged_s > 0
        spent_s += time.process_time() - begun_s
    return rested, spent_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--detector", default="openpose-thin", help="NAME, or NAME=FILE")
    name, _, file = parser.parse_args().detector.partition("=")
    clip = find_clip()
    assert clip is not None, "the demo fetches it"
    detector = make_detector(name, Path(file) if file else None, "cpu", 1)
    totals = {(kind, on): np.zeros(3) for kind in ("clip", "standing") for on in (False, True)}
    for camera, video in enumerate(clip.videos):
        images = [f.image for at, f in enumerate(open_video(video).frames(0.0)) if at % EVERY == 0]
        detector.detect(images[0])
        for kind, shown in (("clip", images), ("standing", standing(images[0], 34, camera))):
            frames = list(shown)
            for on in (False, True):
                totals[kind, on] += len(frames), *looked(Gate(detector, on), frames)
    print("images    gate  frames  rested %  CPU s  ms a frame")
    for (kind, on), (frames_seen, rested, spent_s) in totals.items():
        share, ms = 100 * rested / frames_seen, 1000 * spent_s / frames_seen
        print(f"{kind:9} {on!s:5} {frames_seen:6.0f} {share:9.1f} {spent_s:6.2f} {ms:11.1f}")


if __name__ == "__main__":
    main()
