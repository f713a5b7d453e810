"""What a picture for the live page costs its camera: CPU time and bytes.

    python lab/benchmarks/pictures.py FOLDER

FOLDER holds images (`.jpg`, also in folders of it), which are taken as frames. CPU time is of the
thread that answers, in milliseconds, without what its answer then takes on the network.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

from e3pose.base.clock import WallClock
from e3pose.camera.pictures import Pictures
from e3pose.wire.codec import decode, encode
from e3pose.wire.site_messages import Picture, PictureQuestion

IMAGES, ROUNDS = 40, 5


def measure(paths: list[Path], large: bool) -> str:
    """Return the size and the CPU time of pictures of images."""
    sizes_kb, took_ms, seen = [], [], set()
    for path in paths:
        image = np.ascontiguousarray(np.asarray(cv2.imread(str(path)))[..., ::-1])
        size = (image.shape[1], image.shape[0])
        seen.add(f"{size[0]} x {size[1]}")
        for _ in range(ROUNDS):
            pictures = Pictures("camera", WallClock())
            pictures.offer(image, 0, 1, size)
            begun_s = time.thread_time()
            answer = pictures.answer("", encode(PictureQuestion(large=large)))
            took_ms.append(1e3 * (time.thread_time() - begun_s))
        assert answer is not None
        sizes_kb.append(len(decode(answer, Picture, "camera").jpeg) / 1e3)
    middle, most = np.median(sizes_kb), np.max(sizes_kb)
    return (
        f"{'large' if large else 'small'} of {', '.join(sorted(seen))}: {middle:.0f} kB "
        f"(at most {most:.0f}), {np.median(took_ms):.1f} ms"
    )


def main() -> None:
    """Print what small and large pictures cost."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    paths = sorted(parser.parse_args().folder.rglob("*.jpg"))[:IMAGES]
    if not paths:
        parser.error("found no .jpg in the folder")
    for large in (False, True):
        print(measure(paths, large))


if __name__ == "__main__":
    main()
