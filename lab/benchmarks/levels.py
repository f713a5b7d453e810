"""Levels of looking: what networks and input sizes cost, how their keypoints err, and the poses.

    python lab/benchmarks/levels.py --model movenet-multipose=FILE.onnx
    python lab/benchmarks/levels.py --pictures    # in the images of pizza

A level is a network and a scale of its input, beside the usual one. The demo's four real videos, 34
slots at 20 per second. `ms` is processor time of one thread, all levels in turn on each image;
`noise` the error of its keypoints without labels, by leaving one view out, robust, in pixels of the
image; `in views` the share of people in the views who are found. Then for so many cameras per slot
(`information`, lead 2, whole images) the mean distance of poses in mm from two references, and the
share of people who are found; in brackets, the first distance for those alone whom all levels of
the network find. References are smoothers over all views: of the same network in
mirrored images at scale 1, which are no level, and of the other network at scale 1.

Last, how far networks differ systematically: the distance between their smoothed poses, and what is
left of it after the mean offset of each joint in the person's own frame, learned from the others.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clip_error import Errors, Reference, references
from e3pose.base.arrays import Floats
from e3pose.camera.source import open_video
from e3pose.detectors import make_detector
from e3pose.detectors.base import Image
from e3pose.detectors.focus import Part
from e3pose.evaluate.metrics import mean_errors_m
from e3pose.evaluate.noise.calibrate import all_camera_tracks
from e3pose.evaluate.noise.residuals import assign_detections, leave_one_out
from e3pose.evaluate.noise.statistics import RAYLEIGH
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.expected import ExpectedView
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17, Skeleton
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording, ViewSeries, load_recording
from e3pose.recording.calibration import load_rig
from e3pose.site.demo.clip import find_clip
from feedback import converted, in_views, view_recall

FPS, EVERY, LEAD, WARMUP = 20.0, 3, 2, 4
SAME_M = 0.3  # two networks' poses of one person are nearer
MIRRORED = 0.0  # layout: in place of a scale, of the reference
SCALED = ("movenet-multipose",)  # of the other the usual scale
SCALES = (1.0, 0.75, 0.625, 0.5)
COUNTS = (1.0, 1.5, 2.0, 4.0)
PHASES = 2


class Scaled:
    """A network whose input is smaller or larger than usual, or mirrored."""

    def __init__(self, network: Any, scale: float, mirrored: bool = False) -> None:
        self.mirrored = mirrored
        self.network, self.skeleton, self.multiple = network, network.skeleton, network.multiple
        side = round(scale * network.long_side / self.multiple) * self.multiple
        self.long_side, self.person_px = side, scale * network.person_px

    def detect(self, image: Image) -> Poses2D:
        """Look at a whole image."""
        height, width = image.shape[:2]
        part = Part(0, 0, width, height, self.long_side)
        if not self.mirrored:
            return self.detect_part(image, part)
        found = self.detect_part(np.ascontiguousarray(image[:, ::-1]), part)
        joints = self.skeleton.joints
        other = [joints.index(_other_side(joint)) for joint in joints]
        keypoints_px = found.keypoints_px[:, other] * (-1, 1) + (width - 1, 0)
        return Poses2D(keypoints_px, found.scores[:, other])

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        """See `Focusing.detect_part`."""
        found: Poses2D = self.network.detect_part(image, part, expected)
        return found


def _other_side(joint: str) -> str:
    for one, other in (("left_", "right_"), ("right_", "left_")):
        if joint.startswith(one):
            return other + joint.removeprefix(one)
    return joint


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """A network at a scale, and what it saw."""

    network: str
    scale: float
    detector: Scaled
    recording: Recording
    look_ms: float


def looked(detectors: dict[str, Any]) -> list[Level]:
    """Look at all images with all levels, in turn."""
    clip = find_clip()
    assert clip is not None, "the demo fetches it"
    rig = load_rig(clip.calibration)
    scaled = {
        (name, scale): Scaled(network, scale or 1.0, mirrored=scale == MIRRORED)
        for name, network in detectors.items()
        for scale in (*(SCALES if name in SCALED else SCALES[:1]), MIRRORED)
    }
    views = {key: [list[Poses2D]() for _ in rig.cameras] for key in scaled}
    spent_s = dict.fromkeys(scaled, 0.0)
    for camera, video in enumerate(clip.videos):
        images = [f.image for at, f in enumerate(open_video(video).frames(0.0)) if at % EVERY == 0]
        for number, image in enumerate(images):
            for key, detector in scaled.items():
                begun_s = time.process_time()
                views[key][camera].append(detector.detect(image))
                spent_s[key] += (time.process_time() - begun_s) * (number > 0)
    slots = len(views[next(iter(scaled))][0])
    levels = []
    for (name, scale), seen in views.items():
        detector = scaled[name, scale]
        joints = len(detector.skeleton)
        times = [slot / FPS for slot in range(slots)]
        series = tuple(ViewSeries.from_views(v, range(slots), times, joints) for v in seen)
        recording = Recording(
            f"{name} {scale:g}", rig, FPS, slots, detector.skeleton, series, detector=name,
            videos={c: str(v) for c, v in zip(rig.camera_ids, clip.videos, strict=True)},
        )  # fmt: skip
        ms = 1000 * spent_s[name, scale] / (len(rig) * (slots - 1))
        levels.append(Level(name, scale, detector, recording, ms))
    return levels


def noise_px(recording: Recording) -> float:
    """Return the robust standard deviation of keypoints, by leaving one view out."""
    tracks, _, _ = all_camera_tracks(recording, recording.num_slots)
    people = list(assign_detections(recording, tracks, recording.num_slots))
    noise = load_noise(recording.detector)
    found = leave_one_out(people, recording.rig, noise, recording.interval_s)
    scale = max(max(c.image_size) for c in recording.rig.cameras) / noise.image_px
    return float(np.median(np.linalg.norm(found.errors_px, axis=1)) / RAYLEIGH * scale)


def judged(level: Level, people: Sequence[Sequence[Reference]], count: float) -> str:
    """Return the errors to several references in mm and the share of the first's who are found."""
    errors = [Errors() for _ in people]
    for phase in range(PHASES):
        settings = ReplaySettings(
            policy="information", num_selected=count, lead_slots=LEAD, warmup_slots=WARMUP,
            phase=phase, seed=phase,
        )  # fmt: skip
        for record in replay(level.recording, settings):
            if record.slot >= WARMUP + LEAD - 1:
                for each, whom in zip(errors, people, strict=True):
                    each.add(record, whom, level.recording.interval_s)
    found, there, _ = np.sum(errors[0].people, axis=0)
    *mm, shared = (f"{1000 * np.concatenate(each.joints).mean():.1f}" for each in errors)
    return f"{' / '.join(mm)}, {100 * found / there:.0f} % ({shared})"


def found_by_all(levels: Sequence[Level], people: Sequence[Reference]) -> list[Reference]:
    """Return the people whom all levels find in half of the slots or more."""
    kept = list(people)
    for level in levels:
        settings = ReplaySettings(policy="all", lead_slots=LEAD, warmup_slots=WARMUP)
        records = list(replay(level.recording, settings))[WARMUP:]
        kept = [person for person in kept if _found_share(person, records) >= 0.5]
    return kept


def _found_share(person: Reference, records: Sequence[SlotRecord]) -> float:
    off = [
        np.min(mean_errors_m(r.poses.joints_m, person.at(r.slot)[None]), initial=np.inf)
        for r in records
    ]
    return float(np.mean(np.array(off) < SAME_M))


def axes_of(person_m: Floats) -> Floats:
    """Return `(num_slots, 3, 3)` axes of a person in COCO-17: to the left, forward, and up."""
    left, right = COCO17.joints.index("left_hip"), COCO17.joints.index("right_hip")
    side = person_m[:, left] - person_m[:, right]
    side[:, 2] = 0.0
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.broadcast_to([0.0, 0.0, 1.0], side.shape)
    return np.stack([side, np.cross(up, side), up], axis=1)


def apart(one: Sequence[Reference], other: Sequence[Reference], slots: int) -> tuple[float, float]:
    """Return in mm how far the same people of two networks are apart, with and without offsets."""
    pairs = []
    for person in one:
        mine = np.stack([person.at(slot) for slot in range(slots)])
        others = [np.stack([each.at(slot) for slot in range(slots)]) for each in other]
        off = [np.nanmean(np.linalg.norm(mine - each, axis=-1)) for each in others]
        if np.nanmin(off) < SAME_M:
            pairs.append((mine, others[int(np.nanargmin(off))]))
    local = list[Floats]()
    for mine, theirs in pairs:
        axes = axes_of(mine)
        local.append(np.einsum("nij,nkj->nki", axes, theirs - mine))
    raw = np.concatenate([np.linalg.norm(each, axis=-1).ravel() for each in local])
    left = []
    for number, each in enumerate(local):
        learned = np.concatenate([o for at, o in enumerate(local) if at != number])
        left.append(np.linalg.norm(each - np.nanmean(learned, axis=0), axis=-1).ravel())
    return 1000 * float(np.nanmean(raw)), 1000 * float(np.nanmean(np.concatenate(left)))


def films(levels: Sequence[Level]) -> None:
    """Print a row per level, and what networks differ by."""
    people = {
        level.network: references(level.recording, load_noise(level.network))
        for level in levels
        if level.scale == MIRRORED
    }
    counts = " | ".join(f"{count:g}" for count in COUNTS)
    print(
        f"| network | scale | input | ms | noise, px | in views, % | {counts} |\n"
        f"|{'---|' * (6 + len(COUNTS))}"
    )
    for level in (each for each in levels if each.scale != MIRRORED):
        mine = people[level.network]
        skeleton = level.recording.skeleton
        whom = [mine] + [
            converted(theirs, _skeleton(levels, name), skeleton)
            for name, theirs in people.items()
            if name != level.network
        ]
        same = [each for each in levels if each.network == level.network and each.scale]
        whom.append(found_by_all(same, mine))
        seen = {
            (slot, camera): view
            for camera in range(len(level.recording.rig))
            for slot in range(level.recording.num_slots)
            if (view := level.recording.view(slot, camera)) is not None
        }
        recall = view_recall(in_views(level.recording, mine), seen, FPS)[0]
        print(
            f"| {level.network} | {level.scale:g} | {level.detector.long_side} | "
            f"{level.look_ms:.1f} | {noise_px(level.recording):.1f} | {100 * recall:.1f} | "
            f"{' | '.join(judged(level, whom, count) for count in COUNTS)} |",
            flush=True,
        )
    named = list(people)
    for at, one in enumerate(named):
        for other in named[at + 1 :]:
            pair = [
                converted(people[name], _skeleton(levels, name), COCO17) for name in (one, other)
            ]
            raw, left = apart(pair[0], pair[1], levels[0].recording.num_slots)
            print(f"\n{one} and {other}: {raw:.0f} mm apart, {left:.0f} mm without offsets")


def _skeleton(levels: Sequence[Level], name: str) -> Skeleton:
    return next(level.recording.skeleton for level in levels if level.network == name)


def pictures(detectors: dict[str, Any]) -> None:
    """Print for each level what it finds in the images of pizza, people who are small in them."""
    import cv2

    shared = Path(os.environ["E3POSE_SHARED"]) / "data" / "pizza"
    recording = load_recording(shared / "recording")
    people = references(recording, load_noise(recording.detector))
    for name, network in detectors.items():
        for scale in SCALES:
            detector, seen, spent_s = Scaled(network, scale), {}, list[float]()
            for camera, folder in enumerate(sorted((shared / "images").iterdir())):
                for path in sorted(folder.glob("frame*_*.jpg")):
                    slot = int(path.stem.removeprefix("frame").partition("_")[0])
                    image = np.asarray(cv2.imread(str(path)))[..., ::-1].copy()
                    begun_s = time.process_time()
                    seen[slot, camera] = detector.detect(image)
                    spent_s.append(time.process_time() - begun_s)
            joints = converted(people, recording.skeleton, detector.skeleton)
            recall = view_recall(in_views(recording, joints), seen, 1.0)[0]
            ms = 1000 * float(np.mean(spent_s[1:]))
            print(f"| {name} | {scale:g} | {ms:.1f} | {100 * recall:.1f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--model", action="append", default=[], help="NAME=FILE of a network")
    parser.add_argument("--networks", default="movenet-multipose,openpose-thin")
    parser.add_argument("--pictures", action="store_true", help="in the images of pizza")
    options = parser.parse_args()
    files = dict(word.partition("=")[::2] for word in options.model)
    detectors = {
        name: make_detector(name, Path(files[name]) if name in files else None, "cpu", 1)
        for name in options.networks.split(",")
    }
    if options.pictures:
        pictures(detectors)
    else:
        films(looked(detectors))


if __name__ == "__main__":
    main()
