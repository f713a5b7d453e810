"""Identities over time, on people whose paths are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.estimate.per_slot.estimator import END_AFTER_S, Tracks, filled, update_tracks
from e3pose.model.people import People

INTERVAL_S = 0.04
BODY = np.random.default_rng(0).normal(scale=0.3, size=(17, 3)) + [0, 0, 1]


def people(*positions: tuple[float, float]) -> People:
    joints = np.array([BODY + [x, y, 0] for x, y in positions]).reshape(-1, 17, 3)
    return People(np.arange(len(joints)), joints)


def follow(slots: list[People]) -> tuple[Tracks, list[list[int]]]:
    tracks, ids = Tracks.empty(5, 17), []
    for poses in slots:
        tracks, slot_ids = update_tracks(tracks, poses, INTERVAL_S)
        ids.append(slot_ids.tolist())
    return tracks, ids


def test_identity_follows_the_person_not_the_order() -> None:
    _, ids = follow([people((0, 0), (2, 0)), people((2.05, 0), (0.05, 0))])
    assert ids == [[1, 2], [2, 1]]


def test_people_passing_a_metre_apart_keep_their_identities() -> None:
    slots = [people((0.05 * i, 0), (4 - 0.05 * i, 1)) for i in range(80)]
    assert follow(slots)[1] == [[1, 2]] * 80


def test_newcomer_gets_a_new_identity_and_nobody_inherits_an_old_one() -> None:
    gone = int(END_AFTER_S / INTERVAL_S) + 2
    slots = [people((0, 0))] + [people()] * gone + [people((0, 0))]
    assert follow(slots)[1][-1] == [2]


def test_short_gap_keeps_the_identity() -> None:
    assert follow([people((0, 0)), people(), people(), people((0.1, 0))])[1][-1] == [1]


def test_somebody_far_away_is_somebody_else() -> None:
    assert follow([people((0, 0)), people((3, 0))])[1] == [[1], [2]]


def test_history_is_newest_last_and_missing_where_unseen() -> None:
    tracks, _ = follow([people((0, 0)), people(), people((0.1, 0))])
    seen = np.isfinite(tracks.history.joints_m[:, 0]).all(axis=(1, 2))
    assert seen.tolist() == [False, False, True, False, True]
    np.testing.assert_allclose(tracks.history.joints_m[-1, 0], BODY + [0.1, 0, 0])


def test_poses_without_a_shared_joint_are_reported_by_their_centre() -> None:
    first, second = people((0, 0), (3, 0)), people((3, 0), (0, 0))
    upper, lower = np.arange(17) < 8, np.arange(17) >= 8
    a = replace(first, scores=first.scores * upper)
    b = replace(second, scores=second.scores * lower)
    assert follow([a, b])[1] == [[1, 2], [2, 1]]


def test_nobody_at_all_is_normal() -> None:
    tracks, ids = follow([people(), people()])
    assert len(tracks) == 0 and ids == [[], []]


def test_missing_joint_keeps_its_last_offset_from_the_nearest_that_is_there() -> None:
    first, moved = people((0, 0)), people((0.3, 0.1))
    lacks = moved.joints_m.copy()
    lacks[:, [3, 7]] = np.nan
    second = People(moved.track_ids, lacks)
    turned = lacks + [0.2, 0.0, 0.0]  # again without them: the offset is carried on
    third = replace(second, joints_m=turned)
    tracks, _ = follow([first, second, third])
    np.testing.assert_allclose(tracks.filled_m[0], BODY + [0.5, 0.1, 0], atol=1e-12)


def test_joint_moves_with_its_neighbour_and_not_with_the_body() -> None:
    before = BODY.copy()
    before[4] = before[5] + [0.0, 0.0, 0.01]  # an elbow beside a wrist
    now = before.copy()
    now[5] += [0.0, 0.0, 0.4]
    now[4] = np.nan
    shown = filled(before[None], now[None])[0]
    np.testing.assert_allclose(shown[4], before[4] + [0.0, 0.0, 0.4])
    np.testing.assert_array_equal(np.delete(shown, 4, axis=0), np.delete(now, 4, axis=0))


def test_nothing_is_filled_that_was_never_seen() -> None:
    before = np.full((1, 17, 3), np.nan)
    now = BODY[None].copy()
    now[0, 2] = np.nan
    np.testing.assert_array_equal(filled(before, now), now)
    before[0, 2] = BODY[2]  # known, but beside nothing that is there now
    np.testing.assert_array_equal(filled(before, now), now)
