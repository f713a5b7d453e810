"""The filter as an estimator: its people, their history, and feet that few cameras show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.cases import each_case
from tests.estimate.filter.room import MODEL, error_m, run, see, standing, step, turn

from e3pose.estimate.base import Estimate
from e3pose.estimate.filter import Noise
from e3pose.estimate.filter.estimator import Filtered
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.pose import Poses2D
from e3pose.recording import Recording, ViewSeries
from e3pose.simulate import SceneSettings, simulate
from e3pose.simulate.feet import with_skeleton


def test_standing_person_is_recovered_from_one_camera_at_a_time() -> None:
    person = standing((0.3, -0.2))
    _, estimates = run(see(person, turn(slot)) for slot in range(30))
    assert len(estimates[-1]) == 1
    assert error_m(estimates[-1], person)[0, 0] < 0.002
    assert estimates[-1].measured.all()


def test_walking_person_is_recovered_from_one_noisy_camera_at_a_time() -> None:
    rng = np.random.default_rng(0)
    paths = [standing((-1.2 + 1.2 * slot / 25, 0.3)) for slot in range(50)]
    _, estimates = run(see(p, turn(i), 2.0, rng) for i, p in enumerate(paths))
    errors = [error_m(e, p)[0, 0] for e, p in zip(estimates[20:], paths[20:], strict=True)]
    assert np.mean(errors) < 0.04
    assert {tuple(e.track_ids.tolist()) for e in estimates[10:]} == {(1,)}


def test_two_cameras_at_once_are_better_than_one() -> None:
    paths = [standing((-1.2 + 1.2 * slot / 25, 0.3)) for slot in range(50)]

    def mean_error(cameras: Callable[[int], tuple[int, ...]]) -> float:
        rng = np.random.default_rng(1)
        _, estimates = run(see(p, cameras(i), 2.0, rng) for i, p in enumerate(paths))
        return float(
            np.mean([error_m(e, p)[0, 0] for e, p in zip(estimates[20:], paths[20:], strict=True)])
        )

    assert mean_error(lambda i: (i % 5, (i + 2) % 5)) < mean_error(turn)


@each_case("fps", [5, 10, 25, 60])
def test_every_frame_rate_follows_a_walk(fps: int) -> None:
    rng = np.random.default_rng(2)
    paths = [standing((-1.0 + 1.0 * slot / fps, 0.0)) for slot in range(2 * fps)]
    cameras = [(2 * i % 5, (2 * i + 2) % 5) for i in range(len(paths))]
    slots = [see(p, c, 2.0, rng) for p, c in zip(paths, cameras, strict=True)]
    _, estimates = run(slots, fps=fps)
    late = range(fps, 2 * fps)
    assert max(error_m(estimates[i], paths[i])[0, 0] for i in late) < 0.08
    assert {tuple(estimates[i].track_ids.tolist()) for i in late} == {(1,)}


def test_only_seen_joints_are_measured() -> None:
    person = standing((0.0, 0.0))
    belief, _ = run(see(person) for _ in range(10))
    views = see(person, (0, 2))
    keypoints, scores = views[0].keypoints_px.copy(), views[0].scores.copy()
    keypoints[:, 9:11], scores[:, 9:11] = np.nan, 0.0
    _, estimates = run([{0: Poses2D(keypoints, scores)}], belief=belief)
    assert np.flatnonzero(~estimates[0].measured[0]).tolist() == [9, 10]


def test_single_view_never_starts_a_person() -> None:
    _, estimates = run(see(standing((0.1, 0.1), (1.0, 0.5)), (3,)) for _ in range(50))
    assert all(len(e) == 0 for e in estimates)


def test_ghost_in_one_view_stays_out_beside_real_people() -> None:
    person, ghost = standing((0.0, 0.0)), standing((1.2, 0.6))
    slots = [see(person, (0, 1, 3, 4)) | see(np.concatenate([person, ghost]), (2,))] * 40
    _, estimates = run(slots)
    assert estimates[-1].track_ids.tolist() == [1]


@each_case("apart_m", [0.3, 0.5, 0.8])
def test_identities_survive_a_crossing(apart_m: float) -> None:
    rng = np.random.default_rng(4)
    slots, paths = [], []
    for slot in range(75):
        x = -1.5 + slot / 25
        paths.append(standing((x, -apart_m / 2), (-x, apart_m / 2)))
        slots.append(see(paths[-1], (slot % 5, (slot + 2) % 5), 2.0, rng))
    _, estimates = run(slots)
    first, last = error_m(estimates[15], paths[15]), error_m(estimates[-1], paths[-1])
    assert first.argmin(axis=1).tolist() == last.argmin(axis=1).tolist()
    assert sorted(last.argmin(axis=1).tolist()) == [0, 1]
    assert estimates[15].track_ids.tolist() == estimates[-1].track_ids.tolist()


def test_left_right_swap_in_one_view_does_little_harm() -> None:
    person = standing((0.0, 0.0))
    swapped = [0, 2, 1, 4, 3, 6, 5, 8, 7, 10, 9, 12, 11, 14, 13, 16, 15]
    belief, _ = run(see(person) for _ in range(20))
    views = see(person)
    views[1] = Poses2D(views[1].keypoints_px[:, swapped], views[1].scores)
    _, estimates = run([views] * 10, belief=belief)
    assert error_m(estimates[-1], person)[0, 0] < 0.02


@settings(max_examples=20)
@given(st.randoms(use_true_random=False))
def test_order_of_views_and_people_does_not_matter(random: object) -> None:
    seed = random.getrandbits(32)  # type: ignore[attr-defined]
    rng, noise = np.random.default_rng(seed), np.random.default_rng(6)
    people = standing((0.0, 0.0), (1.0, 0.3), (-0.7, 0.8))
    plain, mixed = [], []
    for slot in range(12):
        views = see(people, (slot % 5, (slot + 2) % 5), 2.0, noise)
        plain.append(views)
        shuffled = {}
        for camera in rng.permutation(list(views)).tolist():
            order = rng.permutation(3)
            view = views[camera]
            shuffled[camera] = Poses2D(view.keypoints_px[order], view.scores[order])
        mixed.append(shuffled)
    for a, b in zip(run(plain)[1], run(mixed)[1], strict=True):
        assert a.track_ids.tolist() == b.track_ids.tolist()
        np.testing.assert_allclose(a.joints_m, b.joints_m, atol=1e-9)


def test_covariance_covers_independent_errors() -> None:
    rng = np.random.default_rng(7)
    model = replace(MODEL, noise=Noise(np.array([0.5]), np.array([3.0]), 1032))
    person = standing((0.2, 0.1))
    inside = []
    for trial in range(8):
        slots = [see(person, ((i + trial) % 5, (i + trial + 2) % 5), 3.0, rng) for i in range(40)]
        _, estimates = run(slots, model=model)
        off = estimates[-1].joints_m[0] - person[0]
        squared = np.einsum("ja,jab,jb->j", off, np.linalg.inv(estimates[-1].covariance_m2[0]), off)
        inside.extend((squared < 6.25).tolist())  # 90 % of chi-squared with three degrees
    assert 0.80 < np.mean(inside) <= 1.0


SLOTS = 6


def shown(visits: list[tuple[int, int]]) -> list[Estimate]:
    """Show people walking side by side, each from one slot until another."""
    filtered, everybody = Filtered(MODEL, step, SLOTS), []
    memory = filtered.begin()
    for slot in range(90):
        there = [
            (-1.5 + 0.03 * slot, 1.2 * row - 1.2)
            for row, (begin, end) in enumerate(visits)
            if begin <= slot < end
        ]
        cameras = {*turn(slot), *turn(slot + 1), *turn(slot + 2)}
        memory, estimate = filtered.estimate(
            memory, see(standing(*there), cameras), slot / 25, lambda: 0.0
        )
        everybody.append(estimate)
    return everybody


@each_case(
    "visits",
    [
        [(0, 90)],
        [(0, 90), (30, 90)],  # somebody comes
        [(0, 35), (0, 90)],  # somebody leaves, whose row the other takes
        [(0, 90), (25, 60), (40, 90)],
    ],
)
def test_history_is_where_each_person_was_shown(visits: list[tuple[int, int]]) -> None:
    past: list[dict[int, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]] = []
    changes = 0
    for estimate in shown(visits):
        people, history = estimate.people, estimate.history
        ids = people.track_ids.tolist()
        changes += bool(past) and set(past[-1]) != set(ids)
        past.append(dict(zip(ids, people.joints_m, strict=True)))
        assert history.track_ids.tolist() == ids
        assert history.joints_m.shape == (SLOTS, len(ids), 17, 3)
        for person, track_id in enumerate(ids):
            for age, history_m in enumerate(history.joints_m[::-1, person]):
                before = past[-1 - age] if age < len(past) else {}
                expected_m = before.get(track_id, np.full((17, 3), np.nan))
                np.testing.assert_array_equal(history_m, expected_m)
    assert changes >= len(visits)


FEET = ("toe", "heel")


def feet_of(recording: Recording) -> list[int]:
    names = enumerate(recording.skeleton.joints)
    return [joint for joint, name in names if name.endswith(FEET)]


def without_feet(recording: Recording, views: ViewSeries) -> ViewSeries:
    keypoints_px, scores = views.keypoints_px.copy(), views.scores.copy()
    feet = feet_of(recording)
    keypoints_px[:, feet], scores[:, feet] = np.nan, 0.0
    return replace(views, keypoints_px=keypoints_px, scores=scores)


def test_feet_that_one_camera_shows_stay_near_their_ankles() -> None:
    scene = SceneSettings("ring", people=1, seconds=4.0, fps=12.5, cameras=3)
    whole = with_skeleton(simulate(scene, 701), "halpe26", 701)
    recording = replace(
        whole, views=(whole.views[0], *(without_feet(whole, each) for each in whole.views[1:]))
    )
    names = recording.skeleton.joints
    ankles = [names.index("left_ankle"), names.index("right_ankle")]
    feet = feet_of(recording)
    away_m = [
        np.linalg.norm(joints_m[feet][:, None] - joints_m[ankles], axis=-1).min(axis=1)
        for record in replay(recording, ReplaySettings(num_selected=3, policy="round-robin"))
        for joints_m in record.people.joints_m
        if record.slot >= 25
    ]
    assert len(away_m) >= 20
    assert np.median(away_m) < 0.25 and np.max(away_m) < 0.5
