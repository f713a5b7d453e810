"""What adding expected joints to a network's heatmaps does to its detections, by how much is added.

    python lab/benchmarks/expected_heat.py PIZZA openpose_mobilenet_thin.onnx

PIZZA holds a `recording` of 2D keypoints and the `images` of some of its slots. The reference is
the smoother over all cameras of the recording, which another network made; who is expected comes
from the filter over that recording, two slots ahead. So this shows what expectations are worth that
are better than the network; what they are worth when they come from the network itself is
`lab/benchmarks/feedback.py clip`. Joints without ankles, eyes and ears.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from clip_error import Reference, references
from e3pose.base.arrays import Floats
from e3pose.detectors import make_detector, part_affinity
from e3pose.detectors.base import Image
from e3pose.detectors.focus import Part, part_with
from e3pose.estimate.per_slot.fuse import Fuser, FusionSettings
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.expected import ExpectedView
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO18
from e3pose.recording import Recording, load_recording
from feedback import converted

HEATS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5)
LEAD, NEVER_WHOLE = 2, 1000
WITHOUT = ("ankle", "eye", "ear")
NEAR_PX, PERSON_PX = 60.0, 120.0  # of images 1920 pixels wide
NEAR_M, PERSON_M = 0.1, 0.5
JOINTS = [row for row, name in enumerate(COCO18.joints) if not name.endswith(WITHOUT)]


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """One image, and who is expected in it."""

    slot: int
    camera: int
    image: Image
    expected: ExpectedView


def looks(folder: Path, recording: Recording) -> Iterator[Look]:
    """Return the images with who is expected in them, by the filter two slots before."""
    kept: dict[tuple[int, int], ExpectedView] = {}

    def read(slot: int, camera: int, expected: ExpectedView | None) -> Poses2D | None:
        if expected is not None:
            kept[slot, camera] = expected
        return recording.view(slot, camera)

    paths = {
        (int(path.stem.split("_")[0].removeprefix("frame")), camera): path
        for camera, name in enumerate(recording.rig.camera_ids)
        for path in sorted((folder / "images" / name).glob("frame*.jpg"))
    }
    last = max(slot for slot, _ in paths)
    settings = ReplaySettings(policy="all", lead_slots=LEAD, feedback=True, whole_every=NEVER_WHOLE)
    for record in replay(recording, settings, read_view=read):
        if record.slot >= last:
            break
    columns = [recording.skeleton.joints.index(joint) for joint in COCO18.joints]
    for (slot, camera), path in sorted(paths.items()):
        if (slot, camera) in kept:
            pixels: Any = cv2.imread(str(path))
            image = np.ascontiguousarray(pixels[..., ::-1])
            view = kept[slot, camera]
            yield Look(
                slot, camera, image, ExpectedView(view.keypoints_px[:, columns], view.reach_px)
            )


def matched(apart: Floats, limit: float) -> list[tuple[int, int]]:
    """Return pairs of `(num_people, num_found, num_joints)` distances within a mean `limit`."""
    known = np.isfinite(apart)
    mean = np.where(known, apart, 0).sum(axis=-1) / np.maximum(known.sum(axis=-1), 1)
    mean = np.where(known.sum(axis=-1) >= 3, mean, np.inf)
    pairs = zip(*linear_sum_assignment(np.minimum(mean, 10 * limit)), strict=True)
    return [(int(a), int(b)) for a, b in pairs if mean[a, b] <= limit]


def row(
    found: dict[tuple[int, int], Poses2D], recording: Recording, people: Sequence[Reference]
) -> str:
    """Return found joints in percent and their error in pixels, and likewise in 3D in mm."""
    fuser = Fuser(recording.rig, len(COCO18), FusionSettings(refine_steps=0))
    there = near = there_3d = near_3d = strangers = 0
    off_px: list[float] = []
    off_m: list[float] = []
    for slot in sorted({slot for slot, _ in found}):
        truth = np.array([person.at(slot) for person in people])
        truth = truth[np.isfinite(truth).any(axis=(1, 2))]
        views = {camera: view for (s, camera), view in found.items() if s == slot}
        for camera, view in views.items():
            pixels = recording.rig.project(truth)[camera]
            size = recording.rig.cameras[camera].image_size
            inside = ((pixels >= 0) & (pixels < size)).all(axis=-1)[:, JOINTS]
            apart = np.linalg.norm(pixels[:, None] - view.keypoints_px, axis=-1)[..., JOINTS]
            pairs = matched(apart, PERSON_PX)
            there, strangers = there + int(inside.sum()), strangers + len(view) - len(pairs)
            for person, pose in pairs:
                here = apart[person, pose][inside[person] & np.isfinite(apart[person, pose])]
                near, off_px = near + int((here < NEAR_PX).sum()), [*off_px, *here]
        poses = fuser.fuse(views).poses.joints_m
        apart = np.linalg.norm(truth[:, None] - poses[None], axis=-1)[..., JOINTS]
        there_3d += int(np.isfinite(truth[:, JOINTS, 0]).sum())
        for person, pose in matched(apart, PERSON_M):
            here = apart[person, pose][np.isfinite(apart[person, pose])]
            near_3d, off_m = near_3d + int((here < NEAR_M).sum()), [*off_m, *here]
    return (
        f"{100 * near / there:5.1f} | {np.mean(off_px):5.1f} | {strangers:2d} | "
        f"{100 * near_3d / there_3d:5.1f} | {1000 * np.mean(off_m):5.1f}"
    )


def main() -> None:
    """Print a row for every amount of heat, in whole images and in parts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("network", type=Path)
    options = parser.parse_args()
    recording = load_recording(options.folder / "recording")
    people = converted(references(recording, load_noise("openpose")), recording.skeleton, COCO18)
    detector: Any = make_detector("openpose-thin", options.network, "cpu", 1)
    seen = list(looks(options.folder, recording))
    print("in | heat | joints found % | px | strangers | 3D joints within 100 mm % | mm")
    for whole in (True, False):
        for heat in HEATS:
            part_affinity.HEAT = heat
            found = {}
            for look in seen:
                height, width = look.image.shape[:2]
                everything = Part(0, 0, width, height, detector.long_side)
                part = None if whole else part_with(look.expected, (width, height), detector)
                found[look.slot, look.camera] = detector.detect_part(
                    look.image, part or everything, look.expected
                )
            print(f"{'image' if whole else 'part'} | {heat} | {row(found, recording, people)}",
                  flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
