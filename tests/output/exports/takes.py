"""A take whose every number is known: two people of rigid limbs who walk and wave."""

from __future__ import annotations

import numpy as np
from tests.estimate.filter.room import BODY

from e3pose.base.arrays import Floats
from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.model.slot_record import SlotRecord
from e3pose.model.take import MEASURED, PREDICTED, Motion, Take, motions_of

FPS = 25.0
NUM_FRAMES = 40
STARTED_NS = 1_700_000_000_000_000_000
MISSING_FRAMES, MISSING_JOINT = slice(10, 14), 9  # the left wrist of the first one


def turned(points: Floats, angle: float, axis: int) -> Floats:
    """Return points turned about an axis of the world."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    result: Floats = points.copy()
    result[..., a] = np.cos(angle) * points[..., a] - np.sin(angle) * points[..., b]
    result[..., b] = np.sin(angle) * points[..., a] + np.cos(angle) * points[..., b]
    return result


def walking(phase: float = 0.0) -> Floats:
    """Return `(NUM_FRAMES, 17, 3)`: somebody who turns, swings arms and legs, and lifts a hand."""
    frames = []
    for frame in range(NUM_FRAMES):
        swing = 0.5 * np.sin(2 * np.pi * frame / 25 + phase)
        body = BODY.copy()
        for sign, shoulder, elbow, wrist in ((1, 5, 7, 9), (-1, 6, 8, 10)):
            arm = turned(body[[elbow, wrist]] - body[shoulder], sign * swing, 1) + body[shoulder]
            body[elbow] = arm[0]
            body[wrist] = turned(arm[1] - arm[0], -0.02 * frame, 1) + arm[0]
        for sign, hip, knee, ankle in ((-1, 11, 13, 15), (1, 12, 14, 16)):
            leg = turned(body[[knee, ankle]] - body[hip], sign * swing, 1) + body[hip]
            body[knee], body[ankle] = leg
        frames.append(turned(body, 0.05 * frame + phase, 2) + [0.02 * frame, 0.5 * phase, 0.0])
    return np.array(frames)


def take() -> Take:
    """Return the take: track 3 from frame 0, without a wrist for a while, track 7 from frame 6."""
    joints = [walking(), walking(1.0)[: NUM_FRAMES - 6]]
    joints[0][MISSING_FRAMES, MISSING_JOINT] = np.nan
    motions: list[Motion] = []
    for track_id, first, places in ((3, 0, joints[0]), (7, 6, joints[1])):
        shape = places.shape[:2]
        measured = np.ones(shape, dtype=bool)
        measured[20:25] = False
        slots = first + np.arange(len(places), dtype=np.int64)
        ids = np.full(len(places), track_id)
        sigma, scores = np.full(shape, 0.012), np.full(shape, 0.8)
        motions += motions_of(slots, People(ids, places, scores, measured, sigma))
    assert (motions[0].origin[20:25] == PREDICTED).all()
    return Take("walk", COCO17, 1 / FPS, tuple(motions), STARTED_NS)


def records() -> list[SlotRecord]:
    """Return the take as the records of a loop."""
    people = take().motions
    found, none = [], np.zeros(2, dtype=bool)
    for slot in range(40):
        there = [m for m in people if 0 <= slot - m.first < len(m)]
        rows = [(m, slot - m.first) for m in there]
        found.append(
            SlotRecord(
                slot, slot / 25, none, none,
                People(
                    np.array([m.track_id for m in there], dtype=np.int64),
                    np.array([m.joints_m[r] for m, r in rows]),
                    np.array([m.scores[r] for m, r in rows]),
                    np.array([m.origin[r] == MEASURED for m, r in rows]),
                    np.array([m.sigma_m[r] for m, r in rows]),
                ),
                np.zeros(2), np.zeros(2), none,
            )
        )  # fmt: skip
    return found
