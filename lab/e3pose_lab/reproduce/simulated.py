"""Simulated detections of real motion: people of Panoptic in Panoptic's cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.model.rigs import watched_area
from e3pose.model.skeleton import COCO17, PANOPTIC19, convert
from e3pose.recording import Recording, Truth
from e3pose.simulate.detections import detect_people
from e3pose.simulate.guesses import OUTPUTS
from e3pose.simulate.place import Habits, Scene
from e3pose.simulate.scenes import GUESSES
from e3pose.simulate.situations import draw_fields

HIPS = [11, 12]  # of COCO-17
# The same joint of the other side; the nose has an eye for it.
OTHER_SIDE = (1, 2, 1, 4, 3, 6, 5, 8, 7, 10, 9, 12, 11, 14, 13, 16, 15)
PEOPLE = 4
PLACE_M = 1.1  # of each person from the middle; the dome is 5 m wide
APART_SLOTS = 1200  # between the parts of the sequence that the people take


def with_detections(recording: Recording, seed: int) -> Recording:
    """Return a recording of known people with simulated detections, which suffer from occlusion.

    The detectors guess what is hidden, as real ones do (docs/reference/simulation.md).

    Args:
        recording: its truth is in Panoptic-19. Joints that it lacks are put where they were beside
            the hips in the nearest slot, or where those of the other side are; they hide and are
            detected, and are not scored.
        seed: of the detectors' errors.
    """
    truth = recording.truth
    assert truth is not None, "Panoptic has a truth"
    found_m, _ = convert(truth.joints_m, truth.annotated.astype(np.float64), truth.skeleton, COCO17)
    joints_m = completed(found_m)
    _, area_m = watched_area(recording.rig)
    scene = Scene("Panoptic Studio", truth.joints_m.shape[1], area_m, Habits())
    seeds = np.random.SeedSequence(seed).spawn(len(recording.rig))
    fields = draw_fields(np.random.default_rng(seed), joints_m.shape[1], OUTPUTS)
    views = tuple(
        detect_people(
            camera, joints_m, np.zeros(3), scene, _focus_m(recording, index), recording.fps,
            GUESSES, child, fields,
        )
        for index, (camera, child) in enumerate(zip(recording.rig.cameras, seeds, strict=True))
    )  # fmt: skip
    return replace(
        recording,
        name=f"{recording.name}, simulated detections",
        skeleton=COCO17,
        views=views,
        detector="simulated",
        source=f"{recording.source} 2D keypoints are simulated, seed {seed}.",
    )


def completed(joints_m: Floats) -> Floats:
    """Return joints without gaps, for people of whom both hips are known.

    Args:
        joints_m: `(num_slots, num_persons, 17, 3)` metres, COCO-17, NaN where unknown; in slots in
            which a hip is unknown a person stays away.
    """
    hips = joints_m[:, :, HIPS].mean(axis=2, keepdims=True)
    beside = joints_m - hips
    slots = np.arange(len(joints_m))
    for person in range(joints_m.shape[1]):
        for joint in (*range(len(COCO17)), *range(len(COCO17))):  # twice: sides fill each other
            known = np.flatnonzero(np.isfinite(beside[:, person, joint]).all(axis=-1))
            if len(known) == 0:
                beside[:, person, joint] = beside[:, person, OTHER_SIDE[joint]]
                continue
            nearest = known[np.abs(slots[:, None] - known).argmin(axis=1)]
            beside[:, person, joint] = beside[nearest, person, joint]
    return np.asarray(hips + beside)


def gathered(motion: Recording, first: int, num_slots: int, people: int = PEOPLE) -> Recording:
    """Return several people at once: parts of one person's motion, set down around the middle.

    Args:
        motion: one person, for at least `first + (people - 1) * APART_SLOTS + num_slots` slots.
        first: where the first person's part begins.
        num_slots: length of every part.
        people: how many.
    """
    truth = motion.truth
    assert truth is not None and truth.skeleton == PANOPTIC19, "motion is Panoptic's"
    parts = []
    for person in range(people):
        begin = first + person * APART_SLOTS
        part = truth.joints_m[begin : begin + num_slots, 0]
        middle = np.nanmean(part[..., :2], axis=(0, 1))
        angle = 2 * np.pi * person / people
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        moved = part.copy()
        moved[..., :2] = (part[..., :2] - middle) @ turn.T
        moved[..., :2] += PLACE_M * np.array([np.cos(angle), np.sin(angle)])
        parts.append(moved)
    joints_m = np.stack(parts, axis=1)
    return replace(
        motion,
        name=f"Panoptic motion, {people} people",
        num_slots=num_slots,
        truth=Truth(PANOPTIC19, tuple(f"person{i + 1}" for i in range(people)), joints_m),
        views=motion.views,
    )


def _focus_m(recording: Recording, camera: int) -> float:
    centre, _ = watched_area(recording.rig)
    return float(max(np.hypot(*(recording.rig.centers_m[camera, :2] - centre)), 1.0))
