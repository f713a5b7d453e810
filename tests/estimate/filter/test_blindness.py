"""What a miss proves: a camera behind a wall says nothing, one in plain sight as much as ever."""

from __future__ import annotations

from functools import cache

import numpy as np
from tests.estimate.filter.room import step
from tests.interpreted import interpreted
from tests.reference import filter_blindness

from e3pose.base.arrays import Floats
from e3pose.estimate.filter import Belief, Model
from e3pose.estimate.filter import blindness as blind
from e3pose.estimate.filter.step import StepKernel
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording
from e3pose.simulate import SceneSettings, simulate

SIMULATED = load_noise("simulated")

RIG = simulate(SceneSettings("crossing", people=0, seconds=0.1), seed=3).rig
MODEL = Model(RIG, COCO17, SIMULATED)
CORNER = blind.corner_m(RIG)
EVERYBODY = np.arange(len(RIG))
PLACE = np.array([[0.4, -0.3]])


def taught(views: float, shown: float, times: int = 1) -> Floats:
    """Return counts after a person at `PLACE` was looked at by camera 1."""
    detection_map = blind.nothing_known(RIG)
    row = np.zeros((1, len(RIG)))
    row[0, 1] = 1.0
    for _ in range(times):
        detection_map = filter_blindness.learn(
            detection_map, PLACE, views * row, shown * row, CORNER
        )
    return detection_map


def at(detection_map: Floats, place_m: Floats = PLACE) -> Floats:
    proofs = filter_blindness.proof(detection_map, EVERYBODY, place_m, CORNER)[:, 0]
    found = [interpreted(blind.proof)(each, place_m[0], CORNER) for each in detection_map]
    np.testing.assert_allclose(found, proofs, atol=1e-12)
    return proofs


def test_unknown_places_are_in_plain_sight() -> None:
    np.testing.assert_allclose(at(blind.nothing_known(RIG)), 1.0)
    np.testing.assert_allclose(at(taught(1, 1, 50)), 1.0)  # nor does showing people prove more


def test_misses_of_people_who_were_there_prove_ever_less_of_that_camera_there_only() -> None:
    proofs = [at(taught(1, 0, times))[1] for times in (0, 2, 5, 20, 100)]
    assert np.all(np.diff(proofs) < 0)
    assert proofs[-1] < 0.05
    detection_map = taught(1, 0, 100)
    np.testing.assert_allclose(np.delete(at(detection_map), 1), 1.0)
    np.testing.assert_allclose(at(detection_map, PLACE + 2 * blind.CELL_M), 1.0)


def test_half_a_chance_is_worth_the_share_of_the_logarithms() -> None:
    # So many views that the prior is a thirtieth: p = (30 + 1.8) / 62 where all weight is.
    cells = np.round((PLACE - CORNER) / blind.CELL_M - 0.5)
    middle = CORNER + (cells + 0.5) * blind.CELL_M
    row = np.zeros((1, len(RIG)))
    row[0, 1] = 60.0
    detection_map = filter_blindness.learn(blind.nothing_known(RIG), middle, row, row / 2, CORNER)
    expected = np.log(1 - 31.8 / 62) / np.log(0.1)
    np.testing.assert_allclose(at(detection_map, middle)[1], expected, rtol=1e-12)


def test_things_get_moved_and_what_was_blind_sees_again() -> None:
    detection_map = taught(1, 0, 1000)
    assert detection_map[..., blind.VIEWS].max() <= blind.MOST_VIEWS
    row = np.zeros((1, len(RIG)))
    row[0, 1] = 1.0
    for _ in range(300):
        detection_map = filter_blindness.learn(detection_map, PLACE, row, row, CORNER)
    assert at(detection_map)[1] > 0.6


def test_learning_changes_nothing_it_was_given_and_far_places_have_a_cell() -> None:
    before = taught(1, 0, 3)
    kept = before.copy()
    row = np.ones((1, len(RIG)))
    after = filter_blindness.learn(before, np.array([[1e6, -1e6]]), row, row, CORNER)
    np.testing.assert_array_equal(before, kept)
    assert after.sum() > before.sum()
    assert np.isfinite(at(after, np.array([[1e6, -1e6]]))).all()


@cache
def clean() -> Recording:
    return simulate(SceneSettings("crossing", people=1, seconds=6), seed=3)


def follow(walled: tuple[int, ...], turns: int) -> list[list[int]]:
    """Return who is shown in each slot when some cameras see the scene, but never the person."""
    kernel, belief, shown = StepKernel(), Belief.empty(MODEL), []
    for slot in range(clean().num_slots):
        views = {}
        for turn in range(turns if slot >= 10 else len(RIG)):
            camera = (slot * turns + turn) % len(RIG)
            view = clean().view(slot, camera)
            views[camera] = Poses2D.empty(17) if camera in walled or view is None else view
        belief, people = kernel(MODEL, belief, views, slot * clean().interval_s)
        shown.append(people.track_ids.tolist())
    return shown


def test_person_whom_three_of_five_cameras_cannot_see_keeps_the_identity() -> None:
    shown = follow(walled=(1, 2, 4), turns=1)
    late = shown[len(shown) // 3 :]
    assert np.mean([len(ids) == 1 for ids in late]) > 0.95
    assert len({i for ids in late for i in ids}) == 1


def test_who_leaves_is_soon_gone_although_some_cameras_were_blind() -> None:
    belief = Belief.empty(MODEL)
    slots = clean().num_slots // 2
    for slot in range(slots):
        views = {
            camera: Poses2D.empty(17) if camera in (1, 2) or view is None else view
            for camera in range(len(RIG))
            if (view := clean().view(slot, camera)) is not None
        }
        belief, people = step(MODEL, belief, views, slot * clean().interval_s)
    assert len(people) == 1
    for slot in range(slots, slots + 15):  # three views of every camera
        belief, people = step(
            MODEL, belief, {slot % 5: Poses2D.empty(17)}, slot * clean().interval_s
        )
    assert len(belief) == 0


def taught_by_all() -> Belief:
    """Return the belief of somebody whom all cameras showed for 20 slots."""
    belief = Belief.empty(MODEL)
    for slot in range(20):
        views = {c: v for c in range(5) if (v := clean().view(slot, c)) is not None}
        belief, _ = step(MODEL, belief, views, slot * clean().interval_s)
    return belief


def test_neither_misses_of_a_track_that_ends_nor_a_long_pause_teach() -> None:
    begun = belief = taught_by_all()
    slot = 19
    while len(belief):
        slot += 1
        views = {c: Poses2D.empty(17) for c in range(5)}
        belief, _ = step(MODEL, belief, views, slot * clean().interval_s)
    np.testing.assert_array_equal(belief.detection_map, begun.detection_map)
    later, _ = step(MODEL, begun, {}, 1000.0)
    assert len(later) == 0
    np.testing.assert_array_equal(later.detection_map, begun.detection_map)


def test_what_one_camera_alone_shows_proves_no_other_camera_blind() -> None:
    belief = taught_by_all()
    before = belief.detection_map[..., blind.VIEWS].sum(axis=(1, 2))
    for slot in range(20, 100):
        views = {c: Poses2D.empty(17) for c in range(5)}
        if (view := clean().view(slot, 0)) is not None and slot < 60:
            views[0] = view
        belief, _ = step(MODEL, belief, views, slot * clean().interval_s)
    gained = belief.detection_map[..., blind.VIEWS].sum(axis=(1, 2)) - before
    assert gained.max() < 1.2 * blind.PROOF_S / clean().interval_s
    assert len(belief) == 0
