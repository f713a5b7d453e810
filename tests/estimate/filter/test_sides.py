"""Left and right: detections that exchange them are put right, and tracks that have them wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.cases import each_case
from tests.estimate.filter.room import ALL, BODY, MODEL, NUM_CAMERAS, error_m, run, see, standing

from e3pose.estimate.filter.state import Model
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import BODY25, CMU31, COCO17, COCO18, PANOPTIC19, SHELF14, Skeleton

SIMULATED = load_noise("simulated")

PERSON = standing((0.3, -0.2))
ARMS, LEGS = ([5, 7, 9], [6, 8, 10]), ([11, 13, 15], [12, 14, 16])
STILL = [see(PERSON)] * 25


def exchanged(view: Poses2D, *limbs: tuple[list[int], list[int]]) -> Poses2D:
    """Return a view of which the detector took left for right."""
    keypoints, scores = view.keypoints_px.copy(), view.scores.copy()
    for left, right in limbs:
        keypoints[:, left + right] = keypoints[:, right + left]
        scores[:, left + right] = scores[:, right + left]
    return Poses2D(keypoints, scores)


@each_case(
    "skeleton, pairs",
    [(COCO17, 6), (COCO18, 6), (BODY25, 9), (SHELF14, 6), (PANOPTIC19, 6), (CMU31, 12)],
)
def test_every_skeleton_has_its_sides(skeleton: Skeleton, pairs: int) -> None:
    opposites, limbs = Model(MODEL.rig, skeleton, SIMULATED).sides
    there = limbs > 0
    assert there.sum() == 2 * pairs
    np.testing.assert_array_equal(opposites[opposites], np.arange(len(skeleton)))
    np.testing.assert_array_equal(limbs[opposites], limbs)
    assert (opposites[~there] == np.flatnonzero(~there)).all()
    for joint in np.flatnonzero(there):
        a, b = skeleton.joints[joint], skeleton.joints[opposites[joint]]
        assert {a.split("_")[0], b.split("_")[0]} == {"left", "right"}
        assert a.split("_", 1)[1] == b.split("_", 1)[1]


def test_skeleton_without_sides_has_none() -> None:
    opposites, limbs = Model(
        MODEL.rig, Skeleton("stick", ("head", "foot"), ((0, 1),)), SIMULATED
    ).sides
    assert opposites.tolist() == [0, 1] and limbs.tolist() == [0, 0]


@each_case("limbs", [(ARMS,), (LEGS,), (ARMS, LEGS)])
@each_case("turned", [1, 2])
def test_exchanged_sides_are_put_right(
    limbs: tuple[tuple[list[int], list[int]], ...], turned: int
) -> None:
    views = see(PERSON, (0, 1))
    wrong = {c: exchanged(v, *limbs) if c < turned else v for c, v in views.items()}
    belief, _ = run(STILL)
    _, estimates = run([wrong] * 4, belief=belief)
    assert max(error_m(estimate, PERSON).min() for estimate in estimates) < 0.002


def test_one_camera_that_exchanges_sides_for_long_does_not_mirror_anybody() -> None:
    belief, _ = run(STILL)
    front = {0: exchanged(see(PERSON)[0], ARMS, LEGS)}
    _, estimates = run([front] * 8, belief=belief)
    assert error_m(estimates[-1], PERSON).min() < 0.03


def test_exchanged_sides_do_not_keep_a_person_from_their_detection() -> None:
    wrong = {c: exchanged(v, ARMS, LEGS) if c == 0 else v for c, v in see(PERSON).items()}
    belief, _ = run(STILL)
    belief, _ = run([wrong] * 3, belief=belief)
    assert belief.last_seen_s[0, 0] == 0.0 and len(belief.leftovers) == 0


def test_track_with_wrong_sides_is_turned_round() -> None:
    belief, _ = run(STILL)
    state = belief.state.copy()
    for left, right in (ARMS, LEGS):
        state[:, left + right] = state[:, right + left]
    slots = [{slot % NUM_CAMERAS: see(PERSON)[slot % NUM_CAMERAS]} for slot in range(12)]
    belief, estimates = run(slots, belief=replace(belief, state=state))
    assert error_m(estimates[0], PERSON).min() > 0.1
    assert error_m(estimates[-1], PERSON).min() < 0.05
    assert (belief.mirrored < 0.5).all()


def test_who_turns_round_keeps_their_sides() -> None:
    """Half a turn in 0.8 s, seen by one camera at a time."""
    turns = np.concatenate([np.zeros(25), np.linspace(0, np.pi, 20), np.full(15, np.pi)])
    slots, bodies = [], []
    for slot, turn in enumerate(turns):
        rotation = np.array(
            [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
        )
        bodies.append((BODY @ rotation.T)[None])
        slots.append(see(bodies[-1], ALL if slot < 25 else (slot % NUM_CAMERAS,)))
    _, estimates = run(slots)
    assert error_m(estimates[-1], bodies[-1]).min() < 0.05


def test_arms_that_cross_before_the_chest_stay_crossed() -> None:
    crossed = BODY.copy()
    crossed[[7, 8]] = [[0.2, 0.2, 1.15], [0.2, -0.2, 1.15]]
    crossed[[9, 10]] = [[0.3, -0.15, 1.2], [0.3, 0.15, 1.2]]
    shares = np.concatenate([np.zeros(20), np.linspace(0, 1, 10), np.ones(15)])
    bodies = [((1 - share) * BODY + share * crossed)[None] for share in shares]
    slots = [see(b, ALL if i < 20 else (i % NUM_CAMERAS,)) for i, b in enumerate(bodies)]
    _, estimates = run(slots)
    off = np.linalg.norm(estimates[-1].joints_m[0] - crossed, axis=-1)
    assert off[[7, 8, 9, 10]].max() < 0.05
