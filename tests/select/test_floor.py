"""The floor that cameras watch: where they see, and what hides people from them."""

from __future__ import annotations

import numpy as np
from tests.five_cameras import RIG

from e3pose.estimate.filter import blindness
from e3pose.select.awake import seen_floor, showing, sights

N = len(RIG)


def test_every_cell_is_seen_by_two_cameras_from_where_a_person_stands() -> None:
    cells_m, seen = seen_floor(RIG)
    assert len(cells_m) == seen.shape[1] > 10 and (seen.sum(axis=0) >= 2).all()
    middle = np.hypot(*cells_m.T).argmin()
    assert seen[:, middle].all()  # all five look at the middle of the ring


def test_more_cameras_never_show_less() -> None:
    sets = np.tri(N + 1, N, -1, dtype=bool)  # none, the first, the first two and so on
    one, two = showing(sights(RIG, None), sets)
    assert (one[0] == 0).all() and (two[:2] < 1e-9).all()  # one camera alone estimates nobody
    assert (np.diff(one, axis=0) >= -1e-12).all() and (np.diff(two, axis=0) >= -1e-12).all()
    assert (one >= two - 1e-12).all() and one[-1].min() > two[-1].min() > 0.1


def test_two_cameras_show_somebody_where_both_do() -> None:
    sight = np.array([[0.5], [0.8], [0.3]])
    one, two = showing(sight, np.array([[1, 1, 0], [1, 1, 1]], dtype=bool))
    np.testing.assert_allclose(one[:, 0], [1 - 0.5 * 0.2, 1 - 0.5 * 0.2 * 0.7])
    exactly_one = 0.5 * 0.2 * 0.7 + 0.5 * 0.8 * 0.7 + 0.5 * 0.2 * 0.3
    np.testing.assert_allclose(two[:, 0], [0.5 * 0.8, 1 - 0.5 * 0.2 * 0.7 - exactly_one])


def test_near_cells_are_likelier_free_than_far_ones() -> None:
    cells_m, seen = seen_floor(RIG)
    for camera, sight in enumerate(sights(RIG, blindness.nothing_known(RIG))):
        far_m = np.linalg.norm(cells_m - RIG.centers_m[camera, :2], axis=-1)
        near = np.argsort(far_m)
        assert (np.diff(sight[near][seen[camera][near] > 0]) <= 1e-12).all()
        assert (sight[seen[camera] == 0] == 0).all()


def test_a_camera_shows_people_where_it_did_and_not_where_it_did_not() -> None:
    detection_map = blindness.nothing_known(RIG)
    detection_map[0, ..., blindness.VIEWS] = 60.0
    detection_map[1, ..., :] = 60.0
    _, seen = seen_floor(RIG)
    sight = sights(RIG, detection_map)
    assert sight[0].max() < 0.05 and sight[1][seen[1] > 0].min() > 0.95
    np.testing.assert_allclose(sight[2:], sights(RIG, None)[2:])
