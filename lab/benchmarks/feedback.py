"""What semantic feedback does to the cost of a look, to people who enter, and to the error.

    python lab/benchmarks/feedback.py simulated
    python lab/benchmarks/feedback.py clip FOLDER --model movenet-multipose=FILE.onnx

`simulated` has no pixels: a camera with feedback sees of what was detected only the keypoints
inside its part of the image, or inside one of its crops, and a look costs the pixels of the
network's input. `clip` looks at the demo's four real videos with both shipped networks; FOLDER
keeps what was detected. With `--whole`, the network whose heatmaps take expected joints looks at
whole images alone, as Bultmann and Behnke (RSS 2021) do.
Milliseconds are of this machine, one thread, with and without feedback in turn. Joules are
modelled: the power of an active `xavier-nx` beyond that of an idle one, times those milliseconds.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from clip_error import Errors, Reference, references
from e3pose.base.arrays import Floats
from e3pose.camera.detect import DetectSettings, detect_videos
from e3pose.detectors import make_detector, movenet, openpose
from e3pose.detectors.focus import InputSize, look_at, look_pixels
from e3pose.detectors.mosaic import Mosaic
from e3pose.detectors.topology import OPENPOSE_THIN
from e3pose.energy.profiles import load_profile
from e3pose.evaluate.detect_again import PixelViews
from e3pose.evaluate.metrics import mean_errors_m
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import accuracy
from e3pose.model.expected import ExpectedView
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton, convert
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording, load_recording
from e3pose.recording.calibration import load_rig
from e3pose.settings.loop import MAX_WHOLE_EVERY, WHOLE_EVERY
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.demo.clip import find_clip
from e3pose_lab.reproduce.clip_feedback import WholeImages

SCENES = ("ring", "pillar", "one-sided", "two-rooms")
SEEDS = (701, 702, 703)
SECONDS = 20.0
NEWCOMER_S = 1.0  # of which it is counted who of the newcomers was found
FOUND_M = 0.5
FEWEST = 4  # keypoints of a person whom a cropped look still shows
FPS = 20.0
WARMUP = 10
CLIP_WARMUP = 4  # of 34 slots


@dataclass
class Sizes:
    """The input of a network, without the network; see `InputSize`."""

    person_px: float
    long_side: int
    multiple: int
    free_input: bool = True


NETWORKS: dict[str, InputSize] = {
    movenet.NAME: Sizes(movenet.PERSON_PX, movenet.LONG_SIDE, movenet.MULTIPLE),
    "openpose-thin": Sizes(openpose.PERSON_PX, OPENPOSE_THIN.long_side, OPENPOSE_THIN.multiple),
}


@dataclass
class Cropped:
    """What the cameras of a recording see of its detections in the parts that they look at."""

    recording: Recording
    network: InputSize
    costs: list[float] = field(default_factory=list)  # input pixels over those of a whole look
    cut: list[int] = field(default_factory=list)  # keypoints outside the part
    seen: list[int] = field(default_factory=list)

    def __call__(self, slot: int, camera: int, expected: ExpectedView | None) -> Poses2D | None:
        size = self.recording.rig.cameras[camera].image_size
        look = None if expected is None else look_at(expected, size, self.network)
        if slot >= WARMUP:
            whole = look_pixels(None, size, self.network)
            self.costs.append(look_pixels(look, size, self.network) / whole)
        view = self.recording.view(slot, camera)
        if view is None or look is None:
            return view
        tiles = look.tiles if isinstance(look, Mosaic) else [look]
        boxes = np.array([tile.box for tile in tiles])[:, None, None]
        places = view.keypoints_px
        with np.errstate(invalid="ignore"):
            inside = (places >= boxes[..., :2]) & (places < boxes[..., 2:])
        held = inside.all(axis=-1) & (view.scores > 0)  # (num_tiles, num_persons, num_joints)
        kept = held[held.sum(axis=-1).argmax(axis=0), np.arange(len(view))]
        self.seen.append(int((view.scores > 0).sum()))
        self.cut.append(self.seen[-1] - int(kept.sum()))
        people = kept.sum(axis=1) >= FEWEST
        keypoints_px = np.where(kept[..., None], view.keypoints_px, np.nan)
        return Poses2D(keypoints_px[people], np.where(kept, view.scores, 0.0)[people])


def _policies(names: str) -> list[tuple[str, float | None]]:
    """Return policies and their cameras per slot; those that choose wake two."""
    return [(name, None if name == "all" else 2.0) for name in names.split(",")]


def newcomers_found(recording: Recording, records: Sequence[SlotRecord]) -> tuple[int, int]:
    """Return in how many person-slots of newcomers' first second they were found, of how many.

    A newcomer's time begins in the slot in which half of the joints are inside the images of two
    cameras, as far as walls allow, after a second without.
    """
    assert recording.truth is not None
    joints_m = recording.truth.joints_m
    pixels = recording.rig.project(joints_m)  # (num_cameras, num_slots, num_persons, num_joints, 2)
    sizes = recording.rig.image_sizes[:, None, None, None]
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= 0) & (pixels < sizes)).all(axis=-1).mean(axis=-1) >= 0.5
    seen = inside.sum(axis=0) >= 2  # (num_slots, num_persons)
    span = round(NEWCOMER_S * recording.fps)
    found = counted = 0
    for slot, person in np.argwhere(seen).tolist():
        if slot < WARMUP + span or seen[slot - span : slot, person].any():
            continue
        for record in records[slot : slot + span]:
            apart = mean_errors_m(record.poses.joints_m, joints_m[record.slot, person][None])
            found += bool(apart.min(initial=np.inf) < FOUND_M)
            counted += 1
    return found, counted


def simulated(options: argparse.Namespace) -> None:
    """Print a row per policy, lead and k."""
    recordings = [
        simulate(SceneSettings(scene=scene, seconds=options.seconds), seed)
        for scene in options.scenes.split(",")
        for seed in options.seeds
    ]
    print("policy        C lead  k   cost    cut %  mm  recall  newcomers (1 s)")
    for policy, cameras in _policies(options.policies):
        for lead in options.leads:
            base = ReplaySettings(policy=policy, num_selected=cameras, lead_slots=lead)
            for every in (0, *options.every):
                mm, recall, found, counted = [], [], 0, 0
                looks = [Cropped(r, NETWORKS[options.network]) for r in recordings]
                for recording, read_view in zip(recordings, looks, strict=True):
                    asked = replace(base, feedback=every > 0, whole_every=max(every, 1))
                    records = list(replay(recording, asked, read_view=read_view))
                    figures = accuracy(recording, records)
                    mm.append(figures.mpjpe_mm or np.nan)
                    recall.append(figures.recall_500mm or 0.0)
                    here = newcomers_found(recording, records)
                    found, counted = found + here[0], counted + here[1]
                cost = np.mean(np.concatenate([look.costs for look in looks]))
                cut, seen = (sum(sum(getattr(x, n)) for x in looks) for n in ("cut", "seen"))
                print(
                    f"{policy:12} {cameras or 0:2g} {lead:4d} {every:2d} {cost:6.3f} "
                    f"{100 * cut / max(seen, 1):6.2f} {np.mean(mm):6.1f} {np.mean(recall):7.4f} "
                    f"{found / max(counted, 1):.3f} of {counted}",
                    flush=True,
                )


@dataclass
class Watched:
    """Looks at videos and keeps what was seen."""

    views: PixelViews
    seen: dict[tuple[int, int], Poses2D] = field(default_factory=dict)

    def __call__(self, slot: int, camera: int, expected: ExpectedView | None) -> Poses2D | None:
        found = self.views(slot, camera, expected)
        if found is not None:
            self.seen[slot, camera] = found
        return found


def in_views(recording: Recording, people: Sequence[Reference]) -> Floats:
    """Return `(num_slots, num_people, num_cameras, num_joints, 2)` pixels, NaN outside images."""
    joints_m = np.array([[p.at(slot) for p in people] for slot in range(recording.num_slots)])
    pixels = np.moveaxis(recording.rig.project(joints_m), 0, 2)
    sizes = recording.rig.image_sizes[:, None]
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= 0) & (pixels < sizes)).all(axis=-1, keepdims=True)
    return np.where(inside, pixels, np.nan)


def view_recall(pixels: Floats, seen: dict[tuple[int, int], Poses2D], fps: float) -> list[float]:
    """Return the share of people in looks who were found: of all, and of those just come into view.

    Somebody is found by a detection within a fifth of their size, the mean over keypoints.
    """
    there = np.isfinite(pixels[..., 0]).mean(axis=-1) >= 0.5  # (num_slots, num_people, num_cameras)
    span = round(NEWCOMER_S * fps)
    hits: list[list[bool]] = [[], []]
    for (slot, camera), poses in seen.items():
        for person in np.flatnonzero(there[slot, :, camera]):
            points = pixels[slot, person, camera]
            size = np.nanmax(np.nanmax(points, axis=0) - np.nanmin(points, axis=0))
            off = np.linalg.norm(poses.keypoints_px - points, axis=-1)
            known = np.isfinite(off)
            mean = np.where(known, off, 0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
            hit = bool((mean[known.sum(axis=1) >= FEWEST] < size / 5).any())
            hits[0].append(hit)
            if slot > span and not there[slot - span : slot, person, camera].all():
                hits[1].append(hit)
    return [float(np.mean(h)) if h else np.nan for h in hits] + [len(hits[1])]


def converted(people: Sequence[Reference], source: Skeleton, target: Skeleton) -> list[Reference]:
    """Return references in another skeleton."""
    found = []
    for person in people:
        joints_m, _ = convert(person.joints_m, np.ones(person.joints_m.shape[:2]), source, target)
        found.append(Reference(person.first_slot, joints_m))
    return found


def clip(options: argparse.Namespace) -> None:
    """Print a row per network, policy and k."""
    found = find_clip()
    assert found is not None, "the demo fetches it"
    rig = load_rig(found.calibration)
    videos = [f"{c}={v}" for c, v in zip(rig.camera_ids, found.videos, strict=True)]
    models = dict(word.partition("=")[::2] for word in options.model)
    detectors = {
        name: make_detector(name, Path(models[name]) if name in models else None, "cpu", 1)
        for name in options.networks.split(",")
    }
    recordings, people = {}, {}
    for name, detector in detectors.items():
        folder = options.folder / name
        if not folder.exists():
            detect_videos(videos, rig, detector, folder, DetectSettings(fps=FPS), name)
        recordings[name] = load_recording(folder)
        people[name] = references(recordings[name], load_noise(name))
    profile = load_profile("xavier-nx")
    watts = profile.watts("active") - profile.watts("power-saving")
    print(
        "network            policy        C lead  k  looks  ms per look  ratio   J per look   "
        "mm own  mm other  recall  newcomers in view"
    )
    for name, detector in detectors.items():
        recording = recordings[name]
        pixels = in_views(recording, people[name])
        other = next((n for n in detectors if n != name), name)
        cross = converted(people[other], recordings[other].skeleton, recording.skeleton)
        for policy, cameras in _policies(options.policies):
            base = ReplaySettings(
                policy=policy,
                num_selected=cameras,
                lead_slots=options.lead,
                warmup_slots=CLIP_WARMUP,
            )
            usual_ms = 0.0
            whole = options.whole and isinstance(detector, openpose.OpenPose)
            for every in (0, *options.every, *[MAX_WHOLE_EVERY] * whole):
                asked = replace(base, feedback=every > 0, whole_every=max(every, 1))
                looking = WholeImages(detector) if every == MAX_WHOLE_EVERY else detector
                read_view = Watched(PixelViews(recording, looking, clock=time.process_time))
                own, others = Errors(), Errors()
                for record in replay(recording, asked, read_view=read_view):
                    if record.slot >= CLIP_WARMUP + options.lead - 1:
                        own.add(record, people[name], recording.interval_s)
                        others.add(record, cross, recording.interval_s)
                looks = [s for slot, _, _, s in read_view.views.detections_s if slot >= CLIP_WARMUP]
                mean_ms = 1000 * float(np.mean(looks))
                usual_ms = usual_ms or mean_ms
                recall = view_recall(pixels, read_view.seen, recording.fps)
                errors = [1000 * np.concatenate(e.joints).mean() for e in (own, others)]
                print(
                    f"{name:18} {policy:12} {cameras or len(rig):2g} {options.lead:4d} {every:2d} "
                    f"{len(looks):6d} {mean_ms:10.1f} {mean_ms / usual_ms:6.2f} "
                    f"{watts * mean_ms / 1000:10.3f} {errors[0]:8.1f} {errors[1]:9.1f} "
                    f"{recall[0]:7.3f} {recall[1]:6.3f} of {recall[2]:g}",
                    flush=True,
                )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    verbs = parser.add_subparsers(required=True)
    scenes = verbs.add_parser("simulated")
    scenes.set_defaults(run=simulated)
    scenes.add_argument("--scenes", default=",".join(SCENES))
    scenes.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS))
    scenes.add_argument("--seconds", type=float, default=SECONDS)
    scenes.add_argument("--leads", type=int, nargs="+", default=[1, 2, 4, 6])
    scenes.add_argument("--every", type=int, nargs="+", default=[2, 3, 5, 8, 12])
    scenes.add_argument("--network", choices=NETWORKS, default=movenet.NAME)
    films = verbs.add_parser("clip")
    films.set_defaults(run=clip)
    films.add_argument("folder", type=Path)
    films.add_argument("--model", action="append", default=[], help="NAME=FILE of a network")
    films.add_argument("--networks", default=",".join(NETWORKS))
    films.add_argument("--lead", type=int, default=2)
    films.add_argument("--every", type=int, nargs="+", default=[WHOLE_EVERY])
    films.add_argument(
        "--whole", action="store_true", help="expected joints in whole images, k = 1000"
    )
    for verb in (scenes, films):
        verb.add_argument("--policies", default="all,information")
    options = parser.parse_args()
    options.run(options)


if __name__ == "__main__":
    main()
