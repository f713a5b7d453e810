"""What cameras would add: the textbook formula, newcomers, and the aim of what is stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case
from tests.interpreted import interpreted
from tests.reference.filter_bias import inflation, worth_inflation
from tests.rigs import looking
from tests.select.outlooks import known, standing

from e3pose.base.arrays import Floats
from e3pose.estimate.base import Outlook
from e3pose.estimate.filter import Belief, Model
from e3pose.estimate.filter import outlook as filter_outlook
from e3pose.estimate.filter.bias import memory_terms
from e3pose.estimate.filter.blindness import PLAIN, chance
from e3pose.estimate.filter.step import StepKernel
from e3pose.model.camera import Rig
from e3pose.model.noise import ErrorMemory
from e3pose.model.noises import load_noise
from e3pose.model.overlap import overlap
from e3pose.model.pose import Poses2D
from e3pose.model.projection import project
from e3pose.model.uncertainty import expected_distance_m
from e3pose.select.expected_information import (
    FIRST_VIEW,
    Entrants,
    Foresight,
    expected_entrants,
    foresee,
)
from e3pose.select.kernels import foresight
from e3pose.select.kernels.foresight import BEHIND_SHARE, INFORMATION_RATIO
from e3pose.select.stated_error import CORRECTION, MEMORY_S, MOST, StatedError, stated_error_m
from e3pose.simulate import SceneSettings, simulate

RIG = looking((4, 0), (0, 4), (-4, 0), (3, 3))
worth = interpreted(foresight.worth)

SLOT_S = 0.04
TERMS = memory_terms(ErrorMemory())


def outlook(joints_m: Floats, rig: Rig = RIG, sigma_m: float = 0.1) -> Outlook:
    return standing(joints_m, len(rig), sigma_m)


def person(x: float, y: float) -> Floats:
    return np.array([[x, y, 0.2], [x, y, 1.0], [x + 0.2, y, 1.0], [x, y + 0.2, 1.6]])


def subsets(num_cameras: int) -> NDArray[np.bool_]:
    numbers = np.arange(2**num_cameras)
    return np.asarray((numbers[:, None] >> np.arange(num_cameras)) & 1 == 1)


def random_foresight(seed: int, num_cameras: int = 6) -> Foresight:
    rng = np.random.default_rng(seed)
    people = np.stack([person(*rng.uniform(-1.5, 1.5, 2)) for _ in range(3)])
    angles = rng.uniform(0, 2 * np.pi, num_cameras)
    rig = looking(*((4 * np.cos(a), 4 * np.sin(a)) for a in angles))
    seen = outlook(people, rig)
    return foresee(
        rig,
        known(
            seen,
            delivered=rng.uniform(0, 1, seen.expected.delivered.shape),
            last_seen_s=rng.exponential(0.5, seen.expected.delivered.shape),
        ),
        SLOT_S,
    )


def test_it_is_the_textbook_formula() -> None:
    people = np.stack([person(0, 0), person(1, -0.5)])
    rng = np.random.default_rng(0)
    delivered, shows = rng.uniform(0.3, 1, (2, 2, 4))
    seen = known(outlook(people), delivered=delivered, shows=shows)
    foresight = foresee(RIG, seen, SLOT_S)
    assert foresight.views.shape == (4, 2, 4, 6)
    expected = delivered * np.vectorize(worth)(shows)
    np.testing.assert_allclose(foresight.weights, expected.max(axis=1))
    chosen = np.array([True, False, False, True])
    jacobian = project(people, RIG.projections)[2]
    # A view that comes long after the one before counts for more than a usual one.
    never = np.array(np.inf)
    looks = sum(
        np.swapaxes(jacobian[c], -1, -2) @ jacobian[c] * expected[:, c, None, None, None] / 9
        for c in (0, 3)
    )
    information = np.eye(3) / 0.1**2 + looks / worth_inflation(never, TERMS)
    gain = 0.5 * (np.linalg.slogdet(information)[1] - np.log(0.1**-6)).mean(axis=1)
    # Nobody hides anybody but in camera 3, where the second person stands beside the first.
    mean = np.average(gain, weights=foresight.weights)
    assert foresight.information(chosen[None])[0] == pytest.approx(mean, rel=1e-9)
    information = np.eye(3) / 0.1**2 + looks / inflation(never, TERMS)
    error = expected_distance_m(np.linalg.inv(information))
    assert foresight.expected_error_m(chosen[None])[0] == pytest.approx(error.mean(), rel=1e-9)
    first = foresee(RIG, known(seen, confirmed=np.array([True, False])), SLOT_S)
    assert first.expected_error_m(chosen[None])[0] == pytest.approx(error[0].mean(), rel=1e-9)


def test_a_camera_gains_what_sets_with_it_have_more() -> None:
    foresight, sets = random_foresight(1, 4), subsets(4)
    nats = foresight.information(sets)
    for chosen in sets:
        gains = [
            nats[(sets == (chosen | one)).all(axis=1)] - nats[(sets == (chosen & ~one)).all(axis=1)]
            for one in np.eye(4, dtype=bool)
        ]
        np.testing.assert_allclose(foresight.gains_nats(chosen), np.ravel(gains), atol=1e-12)
    many = replace(
        foresight,
        prior=np.tile(foresight.prior, (1, 60, 1)),
        views=np.tile(foresight.views, (1, 1, 60, 1)),
    )
    np.testing.assert_allclose(many.information(sets), nats)  # hundreds of joints do not overflow


@each_case("seed", range(5))
def test_more_cameras_tell_more_and_each_less_than_before(seed: int) -> None:
    foresight = random_foresight(seed)
    every = subsets(6)
    gained, error = foresight.information(every), foresight.expected_error_m(every)
    assert gained[0] == pytest.approx(0)
    assert error[0] == pytest.approx(0.1 * 1.595769, rel=1e-5)
    for small in range(64):
        for camera in range(6):
            if small >> camera & 1:
                continue
            gain = gained[small | 1 << camera] - gained[small]
            assert gain >= -1e-12
            assert error[small | 1 << camera] <= error[small] + 1e-12
            for other in set(range(6)) - {camera}:
                larger = small | 1 << other
                assert gained[larger | 1 << camera] - gained[larger] <= gain + 1e-9


def test_a_view_from_the_same_side_is_worth_less() -> None:
    rig = looking((4, 0), (4, 0.2), (0, 4))
    foresight = foresee(rig, outlook(person(0, 0)[None], rig), SLOT_S)
    beside, across = foresight.information(np.array([[1, 1, 0], [1, 0, 1]], dtype=bool))
    assert across > beside + 0.3


def test_outside_the_image_or_behind_the_camera_nothing_is_reported() -> None:
    up = np.array([0.0, 0.0, 30.0])
    people = np.stack([person(0, 30), person(30, 0), person(0, 0) + up, person(0, 0) - up])
    assert (foresee(RIG, outlook(people), SLOT_S).views[0] == 0).all()
    away = looking((4, 0), away=True)
    assert (foresee(away, outlook(person(0, 0)[None], away), SLOT_S).views == 0).all()


def test_somebody_behind_another_tells_less() -> None:
    alone = foresee(RIG, outlook(person(-1, 0)[None]), SLOT_S)
    hidden = foresee(RIG, outlook(np.stack([person(-1, 0), person(1, -0.1)])), SLOT_S)
    # Camera 0 looks along -x: the first person's trunk lies within the box of the second.
    assert hidden.views[0, 0, 1] == pytest.approx(BEHIND_SHARE * alone.views[0, 0, 1])
    np.testing.assert_allclose(hidden.views[2, 0], alone.views[2, 0])  # from the other side
    np.testing.assert_allclose(hidden.views[1, 0], alone.views[1, 0])  # from beside


def test_fresh_errors_tell_more_than_old_ones_again() -> None:
    seen = known(outlook(person(0, 0)[None]), last_seen_s=np.array([[0.04, np.inf, 1.0, np.inf]]))
    gains = foresee(RIG, seen, SLOT_S).information(np.eye(4, dtype=bool))
    assert gains[0] < gains[2] < gains[1]


def test_what_is_ordered_already_need_not_be_ordered_again() -> None:
    seen = outlook(person(0, 0)[None])
    first = np.array([True, False, False, False])
    free = foresee(RIG, seen, SLOT_S)
    after = foresee(RIG, seen, SLOT_S, first[None])
    each = np.eye(4, dtype=bool)
    assert after.expected_error_m(each)[1] < free.expected_error_m(each)[1]
    assert after.information(each)[0] < 0.3 * free.information(each)[0]
    assert after.information(each)[1] > 0.3 * free.information(each)[1]


@each_case("camera", range(4))
def test_a_camera_ordered_twice_in_flight_adds_less_the_second_time(camera: int) -> None:
    seen = drifting(outlook(person(0, 0)[None]))
    orders = np.zeros((3, 3, 4), dtype=bool)
    orders[1:, 0, camera] = True
    orders[2, 1, camera] = True
    nobody = np.zeros((1, 4), dtype=bool)
    none, once, twice = (
        float(foresee(RIG, seen, SLOT_S, order).expected_error_m(nobody)[0]) for order in orders
    )
    assert none - once > 2 * (once - twice) > 0


def drifting(seen: Outlook, accelerates_mps2: float = 5.0) -> Outlook:
    """Let people move: velocities are known to 0.3 m/s and change by chance."""
    covariance = seen.expected.covariance.copy()
    covariance[..., 3:, 3:] = 0.3**2 * np.eye(3)
    drift = np.full(seen.expected.drift_m2ps3.shape, accelerates_mps2**2 / 25)
    return known(seen, covariance=covariance, drift_m2ps3=drift)


@each_case("num_ordered", [0, 1, 3, 5])
def test_what_is_known_is_carried_as_a_kalman_filter_would(num_ordered: int) -> None:
    rng = np.random.default_rng(num_ordered)
    looked_s = np.array([[0.1, np.inf, 0.5, 2.0]])
    seen = known(drifting(outlook(person(0.3, -0.2)[None], sigma_m=0.05)), last_seen_s=looked_s)
    ordered = rng.random((num_ordered, 4)) < 0.6
    found = foresee(RIG, seen, SLOT_S, ordered)
    jacobian = project(seen.expected.joints_m, RIG.projections)[2]
    fade = np.exp(-SLOT_S / 0.8)
    F = np.kron([[1, 0.8 * (1 - fade)], [0, fade]], np.eye(3))
    middle = 0.8**2 * (1 - fade) ** 2 / 2
    far = 0.8**2 * (SLOT_S - 1.6 * (1 - fade) + 0.4 * (1 - fade**2))
    Q = np.kron([[far, middle], [middle, 0.4 * (1 - fade**2)]], np.eye(3))
    covariance = np.tile(seen.expected.covariance[0, 0], (4, 1, 1))
    since_s = looked_s[0].copy()
    for cameras in [*ordered, np.zeros(4, dtype=bool)]:
        covariance = F @ covariance @ F.T + 1.0 * Q
        since_s += SLOT_S
        for camera in np.flatnonzero(cameras):
            for joint in range(4):
                J = np.hstack([jacobian[camera, 0, joint], np.zeros((2, 3))])
                noise = 9 * inflation(since_s[camera], TERMS) * np.eye(2)
                gain = covariance[joint] @ J.T @ np.linalg.inv(J @ covariance[joint] @ J.T + noise)
                covariance[joint] = (np.eye(6) - gain @ J) @ covariance[joint]
            since_s[camera] = 0.0
    expected = np.linalg.inv(covariance[:, :3, :3])[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    np.testing.assert_allclose(found.prior[0], expected, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.counted[:, 0], 1 / inflation(since_s, TERMS))
    np.testing.assert_allclose(found.new[:, 0], 1 / worth_inflation(since_s, TERMS))


def test_without_a_memory_views_in_flight_tell_nothing_of_a_later_slot() -> None:
    seen = replace(outlook(person(0, 0)[None]), has_memory=False)
    every = np.ones((4, 4), dtype=bool)
    found = foresee(RIG, seen, SLOT_S, every)
    np.testing.assert_allclose(found.prior, foresee(RIG, seen, SLOT_S).prior)


def test_somebody_whom_no_camera_shows_does_not_decide() -> None:
    seen = outlook(np.stack([person(0, 0), person(0.5, 0.5)]))
    lost = known(
        seen, covariance=seen.expected.covariance * np.array([1, 100])[:, None, None, None]
    )
    delivered = np.array([[0.5] * 4, [0.01] * 4])
    alone = foresee(RIG, known(outlook(person(0, 0)[None]), delivered=np.full((1, 4), 0.5)), SLOT_S)
    each = np.eye(4, dtype=bool)
    shown = foresee(RIG, known(lost, delivered=delivered), SLOT_S).information(each)
    np.testing.assert_allclose(shown, alone.information(each), rtol=0.3)


def test_nobody_is_normal() -> None:
    foresight = foresee(RIG, outlook(np.zeros((0, 4, 3))), SLOT_S)
    assert foresight.information(subsets(4)).tolist() == [0.0] * 16
    assert np.isnan(foresight.expected_error_m(subsets(4))).all()


WAIT_S, ENTRY_SLOT_S = 0.14, 0.08
EACH = np.eye(3, dtype=bool)

ENTRANCE = looking((4, 0), (0, 4), (3, 3))


def entrants(*ordered: list[int], people: int = 1, age_s: float = 0.0) -> Entrants:
    """Camera 0 saw somebody new `age_s` ago; the cameras of the next slots are `ordered`."""
    flight = np.array([np.isin(range(3), cameras) for cameras in ordered], dtype=bool)
    return expected_entrants(
        ENTRANCE,
        np.array([people, 0, 0]),
        np.array([age_s + (len(ordered) + 1) * ENTRY_SLOT_S, np.inf, np.inf]),
        WAIT_S,
        ENTRY_SLOT_S,
        flight.reshape(-1, 3),
    )


def sets(*cameras: list[int]) -> NDArray[np.bool_]:
    return np.array([np.isin(range(3), each) for each in cameras])


def test_cameras_overlook_what_others_see_as_far_as_they_face_it() -> None:
    shares = overlap(looking((4, 0), (3, 3), (-30, 0)))
    assert shares[0, 1] > 0.3
    assert (np.diag(shares) == 0).all()
    assert (overlap(looking((4, 0), (-4, 0), away=True)) == 0).all()


def test_nobody_to_start_is_normal() -> None:
    nobody = expected_entrants(
        ENTRANCE,
        np.zeros(3, np.int64),
        np.full(3, np.inf),
        WAIT_S,
        ENTRY_SLOT_S,
        np.zeros((2, 3), bool),
    )
    assert nobody.starts(EACH).tolist() == [0.0] * 3


def test_while_the_detection_waits_another_camera_completes_the_pair() -> None:
    alone, other = entrants().starts(sets([0], [1]))
    assert other == pytest.approx(overlap(ENTRANCE)[0, 1])
    assert alone == pytest.approx(FIRST_VIEW)


def test_once_it_has_waited_too_long_two_cameras_in_one_slot_start_the_person() -> None:
    found = entrants([], [], [])
    one, two, both = found.starts(sets([1], [2], [0, 1]))
    assert both == pytest.approx(overlap(ENTRANCE)[0, 1])
    assert one == pytest.approx(FIRST_VIEW * overlap(ENTRANCE)[0, 1])
    assert two == pytest.approx(FIRST_VIEW * overlap(ENTRANCE)[0, 2])


def test_a_look_in_flight_is_a_partner_for_another_camera_and_not_for_itself() -> None:
    free, found = entrants([], []), entrants([], [1])
    np.testing.assert_allclose(found.weights, free.weights)
    assert found.starts(sets([0]))[0] > free.starts(sets([0]))[0]
    assert found.starts(sets([1]))[0] == pytest.approx(free.starts(sets([1]))[0])


@each_case("ordered", [([1], []), ([], [0, 1]), ([], [1], [0])])
def test_an_entrant_is_paid_once(ordered: tuple[list[int], ...]) -> None:
    free = entrants(*([] for _ in ordered))
    paid = entrants(*ordered)
    met = overlap(ENTRANCE)[0, 1]
    assert paid.weights[0] == pytest.approx((1 - met) * free.weights[0])
    subsets = sets([0], [1], [2], [0, 1], [0, 2], [0, 1, 2])
    assert (paid.starts(subsets)[3:] < free.starts(subsets)[3:]).all()


def test_looks_too_far_apart_start_nobody() -> None:
    assert entrants([], [1], [], [0], []).weights[0] == 1.0


def test_everybody_new_counts() -> None:
    one, three = entrants(), entrants(people=3)
    np.testing.assert_allclose(three.starts(EACH), 3 * one.starts(EACH))


TARGET_M = 0.04
STATED_SLOT_S = 0.1
FULL = 1 - 1e-9


def spheres(sigma_m: float, people: int = 2) -> NDArray[np.float64]:
    return np.tile(np.eye(3) * sigma_m**2, (people, 17, 1, 1))


def error_m(sigma_m: float) -> float:
    return float(expected_distance_m(spheres(sigma_m)[0, 0]))


def after(stated: StatedError, sigma_m: float, seconds: float) -> StatedError:
    for _ in range(round(seconds / STATED_SLOT_S)):
        stated = stated.after(stated_error_m(spheres(sigma_m)), STATED_SLOT_S)
    return stated


def test_the_mean_is_the_plain_one_at_first_and_forgets_with_its_memory() -> None:
    stated = after(after(StatedError(), 0.02, STATED_SLOT_S), 0.01, STATED_SLOT_S)
    middle_m = (error_m(0.02) + error_m(0.01)) / 2
    assert stated.mean_m == pytest.approx(middle_m, rel=0.01)
    stated = after(StatedError(error_m(0.02), FULL), 0.01, MEMORY_S)
    expected_m = error_m(0.01) + (error_m(0.02) - error_m(0.01)) / np.e
    assert stated.mean_m == pytest.approx(expected_m, rel=1e-6)
    assert after(StatedError(), 0.02, MEMORY_S).filled == pytest.approx(1 - 1 / np.e)


def test_nobody_and_unknown_joints_change_nothing() -> None:
    stated = after(StatedError(), 0.03, 1.0)
    assert stated.after(stated_error_m(spheres(0.02, 0)), STATED_SLOT_S) == stated
    assert stated.after(stated_error_m(np.full((1, 17, 3, 3), np.nan)), STATED_SLOT_S) == stated
    some = spheres(0.02).copy()
    some[:, 5:] = np.nan
    assert stated.after(stated_error_m(some), STATED_SLOT_S).mean_m == pytest.approx(
        stated.after(stated_error_m(spheres(0.02)), STATED_SLOT_S).mean_m, rel=1e-12
    )


def test_the_aim_is_the_target_where_that_is_stated_and_else_goes_the_other_way() -> None:
    assert StatedError(TARGET_M, FULL).aim_m(TARGET_M) == pytest.approx(TARGET_M)
    assert StatedError().aim_m(TARGET_M) == TARGET_M
    low, high = (StatedError(times * TARGET_M, FULL).aim_m(TARGET_M) for times in (0.9, 1.1))
    assert low > TARGET_M > high
    assert StatedError(1e-6, FULL).aim_m(TARGET_M) == MOST * TARGET_M
    assert StatedError(10.0, FULL).aim_m(TARGET_M) == TARGET_M / MOST


def test_the_certainty_that_the_warm_up_leaves_is_hardly_made_up_for() -> None:
    """Half a second after all cameras looked, errors are far below any target."""
    stated = after(StatedError(), 0.25 * TARGET_M, 0.5)
    assert stated.mean_m < TARGET_M / 2
    assert stated.aim_m(TARGET_M) < 1.4 * TARGET_M
    assert StatedError(stated.mean_m, FULL).aim_m(TARGET_M) == MOST * TARGET_M


@pytest.mark.parametrize("stated_over_expected", [0.9, 1.1])
def test_a_sixth_of_what_is_missed_is_left(stated_over_expected: float) -> None:
    stated_m = TARGET_M
    for _ in range(1000):
        aim_m = StatedError(stated_m, FULL).aim_m(TARGET_M)
        stated_m += 0.02 * (stated_over_expected * aim_m - stated_m)
    left = stated_over_expected ** (1 / (1 + CORRECTION))
    assert stated_m == pytest.approx(left * TARGET_M, rel=1e-3)


def test_a_chance_is_worth_the_mean_of_the_logarithms() -> None:
    assert worth(1.0) == pytest.approx(1.0) and worth(0.0) == 0.0
    for p in (0.1, 0.5, 0.9):
        nats = np.log(1 + INFORMATION_RATIO * worth(p))
        assert nats == pytest.approx(p * np.log(1 + INFORMATION_RATIO))


def test_a_camera_that_never_showed_the_person_is_expected_to_show_nobody_there() -> None:
    recording = simulate(SceneSettings("crossing", people=1, seconds=6), seed=3)
    model = Model(recording.rig, recording.skeleton, load_noise("simulated"))
    kernel, belief = StepKernel(), Belief.empty(model)
    assert filter_outlook(model, belief, 0.1).expected.shows.shape == (0, 5)
    for slot in range(recording.num_slots):
        views = {c: v for c in range(5) if (v := recording.view(slot, c)) is not None}
        views[2] = Poses2D.empty(17)
        belief, _ = kernel(model, belief, views, slot * recording.interval_s)
    shows = filter_outlook(model, belief, 0.0).expected.shows[0]
    assert shows[2] < 0.35 and np.delete(shows, 2).min() > 0.8
    # Nobody was ever where the person is said to be in an hour.
    far_m = np.array([14.0, 14.0])
    found = [
        interpreted(chance)(known_of, far_m, model.corner_m) for known_of in belief.detection_map
    ]
    np.testing.assert_allclose(found, PLAIN)
