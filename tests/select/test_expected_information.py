"""What cameras are expected to tell: against plain matrices, and its laws."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case
from tests.reference.filter_bias import inflation, worth_inflation
from tests.rigs import looking
from tests.select.outlooks import known, standing

from e3pose.base.arrays import Floats
from e3pose.estimate.base import Outlook
from e3pose.estimate.filter.bias import memory_terms
from e3pose.model.camera import Rig
from e3pose.model.noise import ErrorMemory
from e3pose.model.projection import project
from e3pose.model.uncertainty import expected_distance_m
from e3pose.select.expected_information import Foresight, foresee
from e3pose.select.kernels.foresight import BEHIND_SHARE

RIG = looking((4, 0), (0, 4), (-4, 0), (3, 3))


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
    foresight = foresee(RIG, known(outlook(people), delivered=np.full((2, 4), 0.7)), SLOT_S)
    assert foresight.views.shape == (4, 2, 4, 6)
    chosen = np.array([True, False, False, True])
    jacobian = project(people, RIG.projections)[2]
    # A view that comes long after the one before counts for more than a usual one.
    never = np.array(np.inf)
    looks = sum(np.swapaxes(jacobian[c], -1, -2) @ jacobian[c] for c in (0, 3)) * 0.7 / 9
    information = np.eye(3) / 0.1**2 + looks / worth_inflation(never, TERMS)
    gain = 0.5 * (np.linalg.slogdet(information)[1] - np.log(0.1**-6)).mean()
    # Nobody hides anybody but in camera 3, where the second person stands beside the first.
    assert foresight.information(chosen[None])[0] == pytest.approx(gain, rel=1e-9)
    information = np.eye(3) / 0.1**2 + looks / inflation(never, TERMS)
    error = expected_distance_m(np.linalg.inv(information)).mean()
    assert foresight.expected_error_m(chosen[None])[0] == pytest.approx(error, rel=1e-9)


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


@each_case("seed", range(5))
@each_case("count", [1, 2, 3, 4])
def test_greedy_is_within_its_guarantee_of_the_best(seed: int, count: int) -> None:
    foresight = random_foresight(seed)
    chosen = np.zeros(6, dtype=bool)
    for _ in range(count):
        free = np.flatnonzero(~chosen)
        tried = chosen | np.eye(6, dtype=bool)[free]
        chosen = tried[int(np.argmax(foresight.information(tried)))]
    sets = np.zeros((0, 6), dtype=bool)
    for each in combinations(range(6), count):
        sets = np.vstack([sets, np.isin(np.arange(6), each)])
    best = foresight.information(sets).max()
    assert foresight.information(chosen[None])[0] >= (1 - 1 / np.e) * best


def test_a_view_from_the_same_side_is_worth_less() -> None:
    rig = looking((4, 0), (4, 0.2), (0, 4))
    foresight = foresee(rig, outlook(person(0, 0)[None], rig), SLOT_S)
    beside, across = foresight.information(np.array([[1, 1, 0], [1, 0, 1]], dtype=bool))
    assert across > beside + 0.3


def test_outside_the_image_or_behind_the_camera_nothing_is_reported() -> None:
    seen = foresee(RIG, outlook(np.stack([person(0, 30), person(30, 0)])), SLOT_S)
    assert (seen.views[0] == 0).all()
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
    seen = drifting(outlook(person(0.3, -0.2)[None], sigma_m=0.05))
    ordered = rng.random((num_ordered, 4)) < 0.6
    found = foresee(RIG, seen, SLOT_S, ordered)
    jacobian = project(seen.expected.joints_m, RIG.projections)[2]
    fade = np.exp(-SLOT_S / 0.8)
    F = np.kron([[1, 0.8 * (1 - fade)], [0, fade]], np.eye(3))
    middle = 0.8**2 * (1 - fade) ** 2 / 2
    far = 0.8**2 * (SLOT_S - 1.6 * (1 - fade) + 0.4 * (1 - fade**2))
    Q = np.kron([[far, middle], [middle, 0.4 * (1 - fade**2)]], np.eye(3))
    covariance = np.tile(seen.expected.covariance[0, 0], (4, 1, 1))
    since_s = np.full(4, np.inf)
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
