"""What crops of people in one input are worth beside one part of the image, by people's size.

    python lab/benchmarks/crops.py --model movenet-multipose=FILE.onnx
    python lab/benchmarks/crops.py --images pizza,pizza-pairs --model movenet-multipose=FILE.onnx

All cameras look in every slot; people are expected where the smoother over all cameras has them,
less an error of `ERROR_M` and `JOINT_ERROR_M`. *Images*: the demo's four real videos (`clip`); the
35 of `pizza`, with `E3POSE_SHARED`; and `-pairs` of either, two cameras' images beside each other
with grey between, so that people are apart. Ways to look: at the whole image, at one part, at crops
where they are better (`look_at`); each for people of several sizes in the input, as shares of the
size at which the network is said to find people best.

*Input* is the pixels of the network's input, in percent of those of the whole image. *ms* is
processor time of one thread, the median over images, all ways in turn on each. *Found* is the
share of the people in the images who are found, *off* the median distance of their keypoints from
the references. *Noise* is learned without labels, by leaving one view out, in pixels of 1920;
`pizza` has too few slots for it. *Crops* is the share of looks at crops.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from clip_error import references
from e3pose.base.arrays import Floats
from e3pose.camera.source import open_video
from e3pose.detectors import make_detector
from e3pose.detectors.base import Image
from e3pose.detectors.focus import Part, detect_expected, look_at, look_pixels
from e3pose.detectors.mosaic import Mosaic
from e3pose.model.expected import ExpectedView
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.recording import Recording, ViewSeries, load_recording
from e3pose.recording.calibration import load_rig
from e3pose.select.feedback import expected_in_views
from e3pose.site.demo.clip import find_clip
from feedback import converted, in_views, view_recall
from levels import EVERY, FPS, noise_px

ERROR_M, JOINT_ERROR_M = 0.03, 0.02  # standard deviations along an axis, of people and of joints
REACH_M = 0.10  # that nine of ten joints are within
BETWEEN_PX, GREY = 400, 114  # between two images beside each other
WAYS = ("whole", "part", "crops")


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """An image, of one camera or of two beside each other.

    Attributes:
        slot: of it.
        image: `(height, width, 3)`.
        cameras: shown in it, from the left.
        lefts: first column of each.
    """

    slot: int
    image: Image
    cameras: tuple[int, ...]
    lefts: tuple[int, ...]


class Way:
    """A detector that looks one way, for people of one size.

    Attributes:
        pixels: of the input, of each look in shares of a look at the whole image.
        crops: whether each look was at crops.
        spent_s: seconds of each look.
        seen: by slot and camera.
    """

    def __init__(self, network: Any, name: str, size: float) -> None:
        self.name, self.size, self._network = name, size, network
        self.skeleton, self.multiple = network.skeleton, network.multiple
        self.long_side, self.person_px = network.long_side, size * network.person_px
        self.free_input = name == "crops"
        self.pixels, self.crops = list[float](), list[bool]()
        self.spent_s, self.seen = list[float](), dict[tuple[int, int], Poses2D]()

    def detect(self, image: Image) -> Poses2D:
        """Look at a whole image."""
        found: Poses2D = self._network.detect(image)
        return found

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        """See `Focusing.detect_part`."""
        found: Poses2D = self._network.detect_part(image, part, expected)
        return found

    def look(self, shot: Shot, expected: ExpectedView) -> None:
        """Look at an image, and keep what was seen and what it took."""
        size = shot.image.shape[1], shot.image.shape[0]
        asked = None if self.name == "whole" else expected
        begun_s = time.process_time()
        found = detect_expected(self, shot.image, asked)
        self.spent_s.append(time.process_time() - begun_s)
        look = None if asked is None else look_at(expected, size, self)
        self.pixels.append(look_pixels(look, size, self) / look_pixels(None, size, self))
        self.crops.append(isinstance(look, Mosaic))
        middle = np.nanmean(found.keypoints_px[..., 0], axis=1) if len(found) else np.zeros(0)
        owner = np.searchsorted(shot.lefts, middle, side="right") - 1
        for number, (camera, left) in enumerate(zip(shot.cameras, shot.lefts, strict=True)):
            mine = owner == number
            self.seen[shot.slot, camera] = Poses2D(
                found.keypoints_px[mine] - (left, 0), found.scores[mine]
            )


@dataclass
class Images:
    """Images, and who is in them.

    Attributes:
        recording: with the rig, and what the network saw in whole images.
        shots: all.
        joints_m: `(num_slots, num_people, num_joints, 3)` of the references, in the network's.
        pixels: of them, from `in_views`.
        fps: slots per second.
        dense: whether there are slots enough to learn noise.
    """

    recording: Recording
    shots: list[Shot]
    joints_m: Floats
    pixels: Floats
    fps: float
    dense: bool
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def expected(self, slot: int) -> list[ExpectedView]:
        """Return what each camera is told of a slot."""
        joints_m = self.joints_m[slot]
        joints_m = joints_m[np.isfinite(joints_m).all(axis=-1).any(axis=-1)]
        off_m = self.rng.normal(0, ERROR_M, (len(joints_m), 1, 3))
        off_m = off_m + self.rng.normal(0, JOINT_ERROR_M, joints_m.shape)
        reach_m = np.full(len(joints_m), REACH_M)
        return list(expected_in_views(self.recording.rig, joints_m + off_m, reach_m))


def beside(shots: list[Shot]) -> list[Shot]:
    """Return the images of each slot in pairs of cameras."""
    by_slot: dict[int, list[Shot]] = {}
    for shot in shots:
        by_slot.setdefault(shot.slot, []).append(shot)
    pairs = []
    for slot, those in by_slot.items():
        for one, other in zip(those[::2], those[1::2], strict=False):
            height = max(each.image.shape[0] for each in (one, other))
            lefts = 0, one.image.shape[1] + BETWEEN_PX
            image = np.full((height, lefts[1] + other.image.shape[1], 3), GREY, dtype=np.uint8)
            for left, each in zip(lefts, (one, other), strict=True):
                image[: each.image.shape[0], left : left + each.image.shape[1]] = each.image
            pairs.append(Shot(slot, image, one.cameras + other.cameras, lefts))
    return pairs


def together(views: list[ExpectedView], shot: Shot) -> ExpectedView:
    """Return who is expected in an image of one or more cameras."""
    mine = [(views[c], left) for c, left in zip(shot.cameras, shot.lefts, strict=True)]
    return ExpectedView(
        np.concatenate([view.keypoints_px + (left, 0) for view, left in mine]),
        np.concatenate([view.reach_px for view, _ in mine]),
    )


def clip(network: Any, name: str) -> Images:
    """Return the demo's videos; references are of whole looks of all cameras."""
    found = find_clip()
    assert found is not None, "the demo fetches it"
    rig = load_rig(found.calibration)
    shots, series = list[Shot](), list[ViewSeries]()
    for camera, video in enumerate(found.videos):
        frames = [f.image for at, f in enumerate(open_video(video).frames(0.0)) if at % EVERY == 0]
        shots += [Shot(slot, image, (camera,), (0,)) for slot, image in enumerate(frames)]
        series.append(_series([network.detect(image) for image in frames], network))
    slots = len(shots) // len(rig)
    shots.sort(key=lambda shot: shot.slot)
    recording = Recording(
        name, rig, FPS, slots, network.skeleton, tuple(series), detector=name,
        videos={c: str(v) for c, v in zip(rig.camera_ids, found.videos, strict=True)},
    )  # fmt: skip
    people = references(recording, load_noise(name))
    joints_m = np.array([[p.at(slot) for p in people] for slot in range(slots)])
    return Images(recording, shots, joints_m, in_views(recording, people), FPS, True)


def _series(views: list[Poses2D], network: Any) -> ViewSeries:
    slots = range(len(views))
    times = [slot / FPS for slot in slots]
    return ViewSeries.from_views(views, slots, times, len(network.skeleton))


def pizza(network: Any, name: str) -> Images:
    """Return the images of pizza; references are of another network's looks."""
    import cv2

    shared = Path(os.environ["E3POSE_SHARED"]) / "data" / "pizza"
    recording = load_recording(shared / "recording")
    people = references(recording, load_noise(recording.detector))
    people = converted(people, recording.skeleton, network.skeleton)
    shots = []
    for camera, folder in enumerate(sorted((shared / "images").iterdir())):
        for path in folder.glob("frame*_*.jpg"):
            slot = int(path.stem.removeprefix("frame").partition("_")[0])
            image = np.asarray(cv2.imread(str(path)))[..., ::-1].copy()
            shots.append(Shot(slot, image, (camera,), (0,)))
    shots.sort(key=lambda shot: (shot.slot, shot.cameras))
    joints_m = np.array([[p.at(slot) for p in people] for slot in range(recording.num_slots)])
    return Images(recording, shots, joints_m, in_views(recording, people), 1.0, False)


def off_px(pixels: Floats, seen: dict[tuple[int, int], Poses2D]) -> float:
    """Return the median distance of keypoints from those of the people in the images."""
    found = list[Floats]()
    for (slot, camera), poses in seen.items():
        for points in pixels[slot, :, camera]:
            if np.isfinite(points[:, 0]).mean() < 0.5 or not len(poses):
                continue
            size = np.nanmax(np.nanmax(points, axis=0) - np.nanmin(points, axis=0))
            off = np.linalg.norm(poses.keypoints_px - points, axis=-1)
            known = np.isfinite(off)
            mean = np.where(known, off, 0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
            mean[~known.any(axis=1)] = np.inf
            if mean.min() < size / 5:
                found.append(off[mean.argmin()])
    return float(np.nanmedian(np.concatenate(found)))


def rows(network: Any, images: Images, sizes: list[float]) -> Iterator[str]:
    """Yield a row for each way and size."""
    ways = [Way(network, name, s) for s in sizes for name in WAYS if name != "whole"]
    ways = [Way(network, "whole", 1.0), *ways]
    told = {slot: images.expected(slot) for slot in sorted({shot.slot for shot in images.shots})}
    for shot in images.shots:
        for way in ways:
            way.look(shot, together(told[shot.slot], shot))
    for way in ways:
        found = 100 * view_recall(images.pixels, way.seen, images.fps)[0]
        noise = "-"
        if images.dense:
            slots, cameras = range(images.recording.num_slots), range(len(images.recording.rig))
            series = [_series([way.seen[s, c] for s in slots], network) for c in cameras]
            noise = f"{noise_px(replace(images.recording, views=tuple(series))):.1f}"
        yield (
            f"{way.name} | {way.person_px:.0f} | {100 * np.mean(way.pixels):.0f} | "
            f"{1000 * np.median(way.spent_s):.1f} | {found:.1f} | "
            f"{off_px(images.pixels, way.seen):.1f} | {noise} | {100 * np.mean(way.crops):.0f}"
        )


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--model", action="append", default=[], help="NAME=FILE of a network")
    parser.add_argument("--networks", default="movenet-multipose")
    parser.add_argument("--images", default="clip,clip-pairs")
    parser.add_argument(
        "--sizes", default="1", help="of people in the input, in shares of the best"
    )
    options = parser.parse_args()
    files = dict(word.partition("=")[::2] for word in options.model)
    print(
        "| network | images | look | people, px | input, % | ms | found, % | off, px | noise, px | "
        f"crops, % |\n|{'---|' * 10}"
    )
    for name in options.networks.split(","):
        network = make_detector(name, Path(files[name]) if name in files else None, "cpu", 1)
        for kind in options.images.split(","):
            base, _, pairs = kind.partition("-")
            images = {"clip": clip, "pizza": pizza}[base](network, name)
            if pairs:
                images = replace(images, shots=beside(images.shots))
            for row in rows(network, images, [float(s) for s in options.sizes.split(",")]):
                print(f"| {name} | {kind} | {row} |", flush=True)


if __name__ == "__main__":
    main()
