"""Make the moving picture of the README: one camera's view, poses from all cameras and from two.

    python lab/benchmarks/moving_picture.py docs/images/two-of-four.webp --recording clip
    e3pose replay clip --cameras 2 --hold-out each

The second command says how often a limb is wrong; so does `--policy all`.

The clip is that of the demo, 20 of its frames a second; both runs are those of `e3pose replay`
(`--cameras all`, `--cameras 2`), from the end of the warm-up on. `--model FILE` is a network; by
default MoveNet's of the cache.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from e3pose.camera.detect import DetectSettings, detect_videos
from e3pose.camera.provenance import load_provenance
from e3pose.camera.slots import SlotReader
from e3pose.detectors import make_detector
from e3pose.evaluate.replay import replay
from e3pose.output.report.overlay import draw_poses, reproject, track_color
from e3pose.recording import Recording, load_recording
from e3pose.recording.calibration import load_rig
from e3pose.settings.loop import ReplaySettings
from e3pose.site.demo_clip import fetch_clip

MODEL = "movenet-multipose"
FPS, SLOWER = 20.0, 3
HEIGHT_PX, BAND_PX, GAP_PX, QUALITY = 420, 26, 6, 55


def recorded(weights: Path | None, dest: Path) -> Recording:
    """Return the clip as a recording, with the people that the network finds."""
    clip = fetch_clip()
    rig = load_rig(clip.calibration)
    videos = [f"{i}={video}" for i, video in zip(rig.camera_ids, clip.videos, strict=True)]
    settings = DetectSettings(fps=FPS, keep_videos="copy")
    detect_videos(videos, rig, make_detector(MODEL, weights), dest, settings, MODEL)
    return load_recording(dest)


def views(
    recording: Recording, settings: ReplaySettings, index: int, folder: Path
) -> Iterator[NDArray[np.uint8]]:
    """Yield a camera's view of each slot after the warm-up, with the poses of a run."""
    camera, num_cameras = recording.rig.cameras[index], len(recording.rig)
    reader = SlotReader(recording, index, folder, load_provenance(folder), settings.warmup_slots)
    for record in replay(recording, settings.for_rig(num_cameras)):
        if record.slot < settings.warmup_slots:
            continue
        image = reader.newest(record.slot)
        assert image is not None, "every camera films in every slot"
        colors = [track_color(int(track)) for track in record.people.track_ids]
        poses = reproject(record.people, camera)
        drawn = draw_poses(image, poses, recording.skeleton, colors, image.shape[0] // 150)
        width = round(image.shape[1] * HEIGHT_PX / image.shape[0])
        panel = cv2.resize(drawn, (width, HEIGHT_PX), interpolation=cv2.INTER_AREA)
        count = int(record.selected.sum())
        said = "all cameras" if count == num_cameras else f"{count} of {num_cameras} cameras"
        panel[:BAND_PX] //= 3
        cv2.putText(panel, said, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, 16)
        yield np.asarray(panel, dtype=np.uint8)


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dest", type=Path)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--camera", default="cam02")
    parser.add_argument("--recording", type=Path, help="a folder to keep the recording in")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = asked.recording or Path(name) / "clip"
        recording = recorded(asked.model, folder)
        index = recording.rig.index(asked.camera)
        runs = ReplaySettings(policy="all"), ReplaySettings(num_selected=2)
        sides = [views(recording, settings, index, folder) for settings in runs]
        gap = np.full((HEIGHT_PX, GAP_PX, 3), 255, dtype=np.uint8)
        images = [
            Image.fromarray(np.concatenate([left, gap, right], axis=1))
            for left, right in zip(*sides, strict=True)
        ]
    images[0].save(
        asked.dest,
        save_all=True,
        append_images=images[1:],
        duration=round(1000 * SLOWER / FPS),
        loop=0,
        quality=QUALITY,
        method=6,
    )
    print(f"{asked.dest}: {len(images)} images, {asked.dest.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
