"""How often the motion gate lets a network rest, and what it saves of a camera's processor time.

    python lab/benchmarks/gate.py --detector openpose-thin=FILE.onnx
    python lab/benchmarks/gate.py --thresholds

Plays the demo's four real videos at 20 slots per second through `camera.gate`, every camera looking
in every slot; then the first image of each with the noise of a sensor drawn anew (4 grey levels),
as of a room in which nobody moves. Processor time is of this machine, one thread, without decoding.

With `--thresholds`, for each pair of thresholds: how many images of a room in which nobody moves
count as changed, by the noise of the sensor; how many of the clip's, by the time between two, in
all of which somebody moves, count as unchanged; and how many with somebody who has come in do. The
one who has come in is the first image's part around a person of the clip, at a fifth to a hundredth
of the image's height, at a place drawn anew, on the clip's and pizza's images.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from e3pose.camera import gate
from e3pose.camera.gate import Gate
from e3pose.camera.source import open_video
from e3pose.detectors import make_detector
from e3pose.detectors.base import Image
from e3pose.site.demo.clip import find_clip

EVERY, FPS, NOISE = 3, 20.0, 4.0
RATE = EVERY * FPS  # of the clip
NOISES, SHARES = (2.0, 4.0, 8.0, 12.0), (1 / 5, 1 / 10, 1 / 20, 1 / 40, 1 / 100)
Small = NDArray[np.uint8]


def read_image(path: Path) -> Image:
    """Return an image in a file."""
    import cv2

    image = cv2.imread(str(path))
    assert image is not None, path
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


def standing(image: Image, frames: int, noise: float, seed: int) -> Iterator[Image]:
    """Yield an image again and again, with other noise."""
    rng = np.random.default_rng(seed)
    for _ in range(frames):
        noisy = image + rng.normal(scale=noise, size=image.shape)
        yield np.asarray(np.clip(noisy, 0, 255), np.uint8)


def looked(gate: Gate, images: Sequence[Image]) -> tuple[int, float]:
    """Return in how many images the network rested, and processor seconds of all."""
    rested, spent_s = 0, 0.0
    for slot, image in enumerate(images):
        begun_s = time.process_time()
        rested += gate.look(image, None, round((slot + 1) / FPS * 1e9)).unchanged_s > 0
        spent_s += time.process_time() - begun_s
    return rested, spent_s


def unchanged(pairs: Sequence[tuple[Small, Small]], changed: int, fewest: int) -> float:
    """Return the share in percent of pairs of small images that count as unchanged."""
    with patch.object(gate, "CHANGED", changed), patch.object(gate, "FEWEST_CHANGED", fewest):
        return 100 * float(np.mean([gate.is_unchanged(after, before) for after, before in pairs]))


def noisy_pairs(images: Sequence[Image], noise: float) -> list[tuple[Small, Small]]:
    """Return pairs of the same image, each with its own noise."""
    pairs = []
    for number, image in enumerate(images):
        first, *others = (gate.small_grey(one) for one in standing(image, 6, noise, number))
        pairs += [(other, first) for other in others]
    return pairs


def entered(images: Sequence[Image], person: Image, share: float) -> list[tuple[Small, Small]]:
    """Return pairs of an image with somebody of a share of its height, and without."""
    import cv2

    rng, pairs = np.random.default_rng(0), []
    for image in images:
        high, wide = (round(share * image.shape[0]), round(share * image.shape[0] / 3))
        small = cv2.resize(person, (max(wide, 1), max(high, 1)), interpolation=cv2.INTER_AREA)
        for _ in range(10):
            top = rng.integers(0, len(image) - len(small))
            left = rng.integers(0, image.shape[1] - small.shape[1])
            other = image.copy()
            other[top : top + len(small), left : left + small.shape[1]] = small
            pairs.append((gate.small_grey(other), gate.small_grey(image)))
    return pairs


def thresholds(
    firsts: Sequence[Image], smalls: Sequence[Sequence[Small]], others: Sequence[Image]
) -> None:
    """Print what counts as unchanged at pairs of thresholds.

    Args:
        firsts: the first image of each film.
        smalls: the small images of each film.
        others: further images.
    """
    height, width = firsts[0].shape[:2]
    person = firsts[0][height // 4 : 3 * height // 4, width // 3 : width // 3 + height // 6]
    kinds: dict[str, list[tuple[Small, Small]]] = {}
    for noise in NOISES:
        kinds[f"noise {noise:g}"] = noisy_pairs([*firsts, *others], noise)
    for apart in (1, 3, 6):
        kinds[f"moves {1000 * apart / RATE:.0f} ms"] = [
            (film[at], film[at - apart]) for film in smalls for at in range(apart, len(film), 3)
        ]
    for share in SHARES:
        kinds[f"came 1/{1 / share:.0f}"] = entered([*firsts, *others], person, share)
    print("unchanged, %    " + "  ".join(f"{kind:>11}" for kind in kinds))
    for changed in (6, 8, 10, 12, 16, 24):
        for fewest in (1, 3, 6):
            shares = [unchanged(pairs, changed, fewest) for pairs in kinds.values()]
            row = "  ".join(f"{share:11.1f}" for share in shares)
            print(f"> {changed:2} in >= {fewest:<2}    {row}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--detector", default="openpose-thin", help="NAME, or NAME=FILE")
    parser.add_argument("--thresholds", action="store_true", help="try pairs of thresholds")
    options = parser.parse_args()
    if options.thresholds:
        clip = find_clip()
        assert clip is not None, "the demo fetches it"
        films = [open_video(video).frames(0.0) for video in clip.videos]
        firsts = [next(film).image for film in films]
        smalls = [[gate.small_grey(frame.image) for frame in film] for film in films]
        folder = Path(os.environ.get("E3POSE_SHARED", "")) / "data" / "pizza" / "images"
        pizza = [read_image(path) for path in sorted(folder.glob("*/frame?00_*.jpg"))]
        thresholds(firsts, smalls, pizza)
        return
    name, _, file = options.detector.partition("=")
    clip = find_clip()
    assert clip is not None, "the demo fetches it"
    detector = make_detector(name, Path(file) if file else None, "cpu", 1)
    totals = {(kind, on): np.zeros(3) for kind in ("clip", "standing") for on in (False, True)}
    for camera, video in enumerate(clip.videos):
        images = [f.image for at, f in enumerate(open_video(video).frames(0.0)) if at % EVERY == 0]
        detector.detect(images[0])
        for kind, shown in (("clip", images), ("standing", standing(images[0], 34, NOISE, camera))):
            frames = list(shown)
            for on in (False, True):
                totals[kind, on] += len(frames), *looked(Gate(detector, on), frames)
    print("images    gate  frames  rested %  CPU s  ms a frame")
    for (kind, on), (frames_seen, rested, spent_s) in totals.items():
        share, ms = 100 * rested / frames_seen, 1000 * spent_s / frames_seen
        print(f"{kind:9} {on!s:5} {frames_seen:6.0f} {share:9.1f} {spent_s:6.2f} {ms:11.1f}")


if __name__ == "__main__":
    main()
