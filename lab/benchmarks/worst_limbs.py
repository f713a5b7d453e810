"""The worst limbs of a replay, as a page of pictures to look at.

    E3POSE_SHARED=... python lab/benchmarks/worst_limbs.py pizza --out worst-pizza
    E3POSE_SHARED=... python lab/benchmarks/worst_limbs.py motion --out worst-motion
    python lab/benchmarks/worst_limbs.py FOLDER --cameras 2 --rates 12.5 --out worst

Takes a recording, the first half of `pizza`, or `motion` (motion capture before a ring of cameras).
Limbs are judged by the truth, without one by an offline smoother over every view of all cameras,
which shares their errors: a picture may show that it is the reference that is wrong. Of each limb
the worst moment of half a second counts. Prints the share of wrong limbs, and how many of the worst
moments have each likely cause:

    association     the trunk is off as well
    not seen        no look had the joint for 0.3 s
    left and right  most keypoints of these looks are nearer to the joint of the other side
    detector        half of them or more are more than 100 mm off, across their rays
    one view only   one camera gave all of them, and the error is along its rays
    motion          they are right, and the joint has moved by more than 150 mm
    filter          they are right, and it has not

In the pictures: keypoints thin and white, the reference green, the estimate blue, the limb red. A
camera whose name has a star looked in that slot. Lead 4.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from clip_error import references
from e3pose.base.arrays import Floats
from e3pose.base.nan_statistics import median_of_known
from e3pose.camera.provenance import load_provenance
from e3pose.camera.slots import SlotReader
from e3pose.evaluate.faults import downsampled
from e3pose.evaluate.metrics import mean_errors_m
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.wrong_limbs import LIMBS, wrong_by_truth
from e3pose.model.camera import Camera
from e3pose.model.noises import detector_of, load_noise
from e3pose.model.pose import Poses2D
from e3pose.output.report.overlay.draw import Image, draw_poses
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording, load_recording
from e3pose.simulate import DetectorSettings, Guessing
from e3pose_lab.datasets import shared_folder
from e3pose_lab.noise.residuals import Observed, assign_detections
from filter_terms import SAME_M, half
from predictor_in_the_loop import captured, seen

LEAD, WARMUP = 4, 10
APART_S = 0.5  # moments of one limb
LATE_S, OFF_M, MOVED_M, TRUNK_M = 0.3, 0.1, 0.15, 0.2
TRUNK = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
SIDE_PX = 340
WHITE, GREEN, BLUE, RED = (235, 235, 235), (0, 210, 90), (70, 150, 255), (255, 40, 40)
PAGE = "<!doctype html><meta charset=utf-8><title>Worst limbs</title><h1>{}</h1>\n{}"
FIGURE = '<figure><img src="{}" width="100%"><figcaption>{}</figcaption></figure>\n'


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One wrong limb.

    Attributes:
        slot: of the worst estimate.
        person: number of who it is of.
        limb: numbers of the joints at its ends.
        joints_m: `(num_joints, 3)` as estimated.
        true_m: `(num_joints, 3)`.
        looks: of the joint at the end in the last `LATE_S`: slot, camera, score, mm across the ray
            from the reference, whether nearer to that of the other side.
        moved_m: how far the end has moved in the last `LATE_S`.
    """

    slot: int
    person: int
    limb: tuple[int, int]
    joints_m: Floats
    true_m: Floats
    looks: list[tuple[int, int, float, float, bool]]
    moved_m: float

    @property
    def off_m(self) -> float:
        """How far off the end of the limb is."""
        return float(np.linalg.norm((self.joints_m - self.true_m)[self.limb[1]]))

    def cause(self, recording: Recording) -> str:
        """Return the likely cause."""
        names = recording.skeleton.joints
        trunk = [names.index(name) for name in TRUNK if name in names]
        off_m = np.linalg.norm((self.joints_m - self.true_m)[trunk], axis=-1)
        if median_of_known(off_m, lacking=0.0) > TRUNK_M:
            return "association"
        if not self.looks:
            return "not seen"
        if np.mean([mirrored for *_, mirrored in self.looks]) >= 0.5:
            return "left and right"
        if np.mean([off_mm > 1000 * OFF_M for *_, off_mm, _ in self.looks]) >= 0.5:
            return "detector"
        cameras = {camera for _, camera, *_ in self.looks}
        if len(cameras) == 1:
            camera = recording.rig.cameras[cameras.pop()]
            across = across_mm(camera, self.joints_m, self.true_m)[self.limb[1]]
            if across < 500 * self.off_m:
                return "one view only"
        return "motion" if self.moved_m > MOVED_M else "filter"


def across_mm(camera: Camera, joints_m: Floats, true_m: Floats) -> Floats:
    """Return `(num_joints,)` millimetres between joints across the rays of a camera."""
    off_px = np.linalg.norm(camera.project(joints_m) - camera.project(true_m), axis=-1)
    focal_px = np.sqrt(camera.K[0, 0] * camera.K[1, 1])
    return np.asarray(1000 * off_px * (true_m @ camera.R[2] + camera.t[2]) / focal_px)


def known_people(recording: Recording) -> list[tuple[Floats, Observed]]:
    """Return paths `(num_slots, num_joints, 3)` of everybody, and what all cameras saw of them."""
    slots = np.arange(recording.num_slots)
    if recording.truth is not None:
        paths = [path for path in recording.truth.joints_m.swapaxes(0, 1)]
    else:
        noise = load_noise(detector_of(recording))
        found = references(recording, noise)
        paths = [np.stack([one.at(float(slot)) for slot in slots]) for one in found]
    tracks = []
    for path in paths:
        there = np.isfinite(path).all(axis=-1).any(axis=-1)
        tracks.append((slots[there], path[there]))
    return list(zip(paths, assign_detections(recording, tracks, recording.num_slots), strict=True))


def wrong_moments(
    recording: Recording, people: Sequence[tuple[Floats, Observed]], records: Sequence[SlotRecord]
) -> tuple[list[Moment], float]:
    """Return every wrong limb of a replay, and the share of limbs that are wrong, in percent."""
    names = recording.skeleton.joints
    late = max(1, round(LATE_S * recording.fps))
    found: list[Moment] = []
    limbs = 0
    for record in records[WARMUP + LEAD :]:
        slot = record.slot
        true_m = np.stack([path[slot] for path, _ in people])
        apart = np.minimum(mean_errors_m(record.people.joints_m, true_m), 2 * SAME_M)
        for row, person in zip(*linear_sum_assignment(apart), strict=True):
            if apart[row, person] >= SAME_M:
                continue
            joints_m = np.asarray(record.people.joints_m[row], dtype=np.float64)
            wrong = wrong_by_truth(joints_m, true_m[person], names)
            limbs += int(np.isfinite(wrong).sum())
            path, views = people[person]
            for joint in np.flatnonzero(wrong == 1).tolist():
                start = next(names.index(a) for a, b in LIMBS if b == names[joint])
                moved_m = path[slot, joint] - path[max(slot - late, 0), joint]
                looks = list(_looks(recording, views, path, joint, records[slot - late : slot + 1]))
                limb, far_m = (start, joint), float(np.linalg.norm(moved_m))
                found.append(Moment(slot, person, limb, joints_m, path[slot], looks, far_m))
    return found, 100 * len(found) / max(limbs, 1)


def _looks(
    recording: Recording, views: Observed, path: Floats, joint: int, records: Sequence[SlotRecord]
) -> Iterator[tuple[int, int, float, float, bool]]:
    names = recording.skeleton.joints
    side, part = names[joint].split("_")
    other = names.index(f"{'right' if side == 'left' else 'left'}_{part}")
    for record in records:
        row = record.slot - views.first_slot
        if not 0 <= row < len(views.scores):
            continue
        for number in np.flatnonzero(record.arrived).tolist():
            score = float(views.scores[row, number, joint])
            if score > 0:
                camera = recording.rig.cameras[number]
                both_m = path[record.slot, [joint, other]]
                focal_px = np.sqrt(camera.K[0, 0] * camera.K[1, 1])
                m_per_px = (both_m @ camera.R[2] + camera.t[2]) / focal_px
                seen_px = camera.undistort(camera.project(both_m))
                off_px = np.linalg.norm(views.keypoints_px[row, number, joint] - seen_px, axis=-1)
                off_mm = 1000 * off_px * m_per_px
                mirrored = bool(off_mm[0] > 1000 * OFF_M and off_mm[1] < off_mm[0] / 2)
                yield record.slot, number, score, float(off_mm[0]), mirrored


def worst(moments: Sequence[Moment], fps: float, most: int) -> list[Moment]:
    """Return the worst moments; those of one limb of a person are at least `APART_S` apart."""
    chosen: list[Moment] = []
    for one in sorted(moments, key=lambda moment: -moment.off_m):
        near = [
            other
            for other in chosen
            if other.person == one.person
            and set(other.limb) & set(one.limb)
            and abs(other.slot - one.slot) < APART_S * fps
        ]
        if not near:
            chosen.append(one)
    return chosen[:most]


def picture(recording: Recording, moment: Moment, record: SlotRecord, images: Any) -> Image:
    """Return what all cameras see of a moment, side by side, RGB."""

    panels = []
    both_m = np.concatenate([moment.joints_m, moment.true_m])
    for number, camera in enumerate(recording.rig.cameras):
        shown = camera.project(both_m)
        if not camera.sees(both_m).any():
            continue
        low, high = np.nanmin(shown, axis=0), np.nanmax(shown, axis=0)
        side = 1.3 * max(*(high - low), 40.0)
        scale, origin = SIDE_PX / side, (low + high - side) / 2
        panel = np.full((SIDE_PX, SIDE_PX, 3), 45, dtype=np.uint8)
        if (image := images(moment.slot, number)) is not None:
            onto = np.array([[scale, 0, 0], [0, scale, 0]])
            onto[:, 2] = -scale * origin
            panel = cv2.warpAffine(image, onto, (SIDE_PX, SIDE_PX))
        view = recording.view(moment.slot, number)
        layers = [(np.stack([camera.project(moment.true_m)]), GREEN, 1)]
        if view is not None and len(view):
            layers.insert(0, (view.keypoints_px, WHITE, 1))
        layers.append((np.stack([camera.project(moment.joints_m)]), BLUE, 2))
        for pixels, color, width in layers:
            placed = (pixels - origin) * scale
            placed[~(np.abs(placed) < 5000).all(axis=-1)] = np.nan
            scores = np.isfinite(placed).all(axis=-1).astype(np.float64)
            poses = Poses2D(placed, scores)
            panel = draw_poses(panel, poses, recording.skeleton, [color] * len(placed), width)
        ends = np.nan_to_num((camera.project(moment.joints_m[list(moment.limb)]) - origin) * scale)
        first, second = (tuple(end) for end in ends.round().clip(-5000, 5000).astype(int).tolist())
        cv2.line(panel, first, second, RED, 4, cv2.LINE_AA)
        word = camera.camera_id + ("*" if record.arrived[number] else "")
        cv2.putText(panel, word, (6, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (255, 255, 0), 1)
        panels.append(panel)
    return np.hstack(panels)


def caption(recording: Recording, moment: Moment) -> str:
    """Return what is known of a moment."""
    names, ids = recording.skeleton.joints, recording.rig.camera_ids
    looks = ", ".join(
        f"{ids[camera]} {(moment.slot - slot) / recording.fps:.2f} s ago {off_mm:.0f} mm"
        f" at {score:.2f}{' (other side)' if mirrored else ''}"
        for slot, camera, score, off_mm, mirrored in moment.looks
    )
    return escape(
        f"{moment.cause(recording)}: slot {moment.slot}, person {moment.person}, limb to "
        f"{names[moment.limb[1]]}, {1000 * moment.off_m:.0f} mm off, moved by "
        f"{1000 * moment.moved_m:.0f} mm; "
        f"keypoints: {looks or 'none'}"
    )


def sources(name: str) -> list[tuple[Recording, Any]]:
    """Return recordings, and what returns their images."""

    def none(slot: int, camera: int) -> None:
        return None

    if name == "pizza":
        return [(half(load_recording(shared_folder() / "data/pizza/recording"), False), none)]
    if name == "motion":
        detector = DetectorSettings(guessing=Guessing())
        return [(seen(path, 30.0, detector), none) for _, path in captured(shared_folder())]
    recording = load_recording(Path(name))
    if not recording.videos:
        return [(recording, none)]
    provenance = load_provenance(Path(name))

    def image(slot: int, camera: int) -> Any:
        return SlotReader(recording, camera, Path(name), provenance, slot).image(slot)

    return [(recording, image)]


def main() -> None:
    """Replay, write the pages and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("recording", help="a folder, pizza or motion")
    parser.add_argument("--cameras", type=float, default=2.0, help="per slot")
    parser.add_argument("--policy", default="information")
    parser.add_argument("--rates", help="slots per second, with commas; all of them if not given")
    parser.add_argument("--most", type=int, default=30, help="moments on the page")
    parser.add_argument("--out", type=Path, help="folder of the page; none if not given")
    options = parser.parse_args()
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
    for rate in map(float, options.rates.split(",")) if options.rates else [np.inf]:
        chosen, shares = [], []
        for whole, images in sources(options.recording):
            recording = downsampled(whole, rate) if rate < whole.fps else whole
            settings = ReplaySettings(
                policy=options.policy, num_selected=options.cameras,
                lead_slots=LEAD, warmup_slots=WARMUP,
            )  # fmt: skip
            records = list(replay(recording, settings))
            moments, share = wrong_moments(recording, known_people(recording), records)
            shares.append(share)
            found = worst(moments, recording.fps, options.most)
            chosen += [(moment, recording, records[moment.slot], images) for moment in found]
        chosen = sorted(chosen, key=lambda row: -row[0].off_m)[: options.most]
        causes = Counter(moment.cause(recording) for moment, recording, *_ in chosen)
        title = (
            f"{options.recording}, {options.cameras:g} cameras by {options.policy}, "
            f"{recording.fps:g} per second: {np.mean(shares):.2f} % of limbs are wrong; worst: "
            + ", ".join(f"{cause} {count}" for cause, count in causes.most_common())
        )
        print(title)
        if options.out is None:
            continue
        figures = []
        for number, (moment, recording, record, images) in enumerate(chosen):
            name = f"{recording.fps:g}-{number:02}.jpg"
            image = picture(recording, moment, record, images)
            cv2.imwrite(str(options.out / name), image[..., ::-1])
            figures.append(FIGURE.format(name, caption(recording, moment)))
        page = options.out / f"{recording.fps:g}.html"
        page.write_text(PAGE.format(escape(title), "".join(figures)), encoding="utf-8")


if __name__ == "__main__":
    main()
