"""Who comes back: the odds against plain formulas, and identities over tracks that end."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from e3pose.estimate.filter import Belief, Model
from e3pose.estimate.filter.estimator import Filtered
from e3pose.estimate.filter.reidentification import (
    DECIDE_S,
    DEPARTED_S,
    MAX_DEPARTED,
    NEVER,
    PROPORTION_SPREAD,
    STATURE_SPREAD,
    Identities,
    identify,
    length_odds,
    place_odds,
)
from e3pose.estimate.filter.step import StepKernel
from e3pose.model.noises import load_noise
from e3pose.model.pose import Poses2D
from e3pose.model.proportions import NOISE_M, SLIDE_M
from e3pose.model.skeleton import COCO17
from e3pose.simulate import SceneSettings, simulate

SIMULATED = load_noise("simulated")

SCENE = SceneSettings("crossing", people=1, seconds=8, cameras=3)
MODEL = Model(simulate(replace(SCENE, people=0, seconds=0.1), seed=5).rig, COCO17, SIMULATED)
TALL, SHORT = 1.12, 0.92  # times the same proportions


def belief(
    time_s: float, people: dict[int, tuple[float, float, float]], taught: int = 60
) -> Belief:
    """Return people by track id: where they stand, and how large they are."""
    empty = Belief.empty(MODEL)
    rows: dict[str, NDArray[np.generic]] = {
        item.name: np.zeros((len(people), *column.shape[1:]), dtype=column.dtype)
        for item in fields(empty)
        if (column := empty.columns().get(item.name)) is not None
    }
    state = np.zeros((len(people), len(MODEL.skeleton), 6))
    sizes = [size for _, _, size in people.values()]
    for row, (x, y, _) in enumerate(people.values()):
        state[row, :, :2] = x, y
    lengths = np.linspace(0.2, 0.5, len(MODEL.proportions.bones))
    rows["track_ids"] = np.array(list(people), dtype=np.int64)
    rows["state"] = state
    rows["confirmed"] = np.ones(len(people), dtype=bool)
    rows["bones_m"] = np.array(sizes)[:, None] * lengths
    rows["bone_counts"] = np.full((len(people), len(MODEL.proportions.bones)), float(taught))
    return replace(empty, time_s=time_s, **rows)  # type: ignore[arg-type]


def shown(*slots: Belief) -> list[list[int]]:
    """Return the identities of every slot, all tracks being shown."""
    identities, before, found = Identities.none(MODEL), slots[0], []
    for now in slots:
        identities = identify(identities, before, now, now.track_ids, MODEL)
        found.append(identities.of(now.track_ids).tolist())
        before = now
    return found


def test_length_odds_are_those_of_two_normal_distributions() -> None:
    from scipy.stats import multivariate_normal  # slow to import, for the workers without this test

    rng = np.random.default_rng(0)
    a, b = rng.uniform(0.2, 0.5, (2, 6))
    n, m = rng.integers(5, 100, (2, 6)).astype(np.float64)
    same = (SLIDE_M**2 + NOISE_M**2 / n) / a**2 + (SLIDE_M**2 + NOISE_M**2 / m) / b**2
    other = np.diag(same + 2 * PROPORTION_SPREAD**2) + 2 * STATURE_SPREAD**2 * np.ones((6, 6))
    off = np.log(a / b)
    expected = multivariate_normal.logpdf(off, cov=np.diag(same))
    expected -= multivariate_normal.logpdf(off, cov=other)
    assert length_odds(a, n, b, m) == pytest.approx(expected)
    assert length_odds(b, m, a, n) == pytest.approx(expected)


def test_what_was_not_learned_tells_nothing() -> None:
    a, few = np.full(7, 0.4), np.full(7, 4.0)
    assert length_odds(a, few, 1.2 * a, few) == 0
    assert length_odds(np.zeros(7), np.zeros(7), a, few) == 0


def test_places_tell_soon_and_later_only_how_far_people_walk() -> None:
    gaps = np.array([0.3, 0.3, 60.0, 60.0, 0.3, -1.0])
    apart = np.array([0.1, 1.4, 0.1, 20.0, 3.0, 0.1])
    odds = place_odds(gaps, apart)
    assert odds[0] > 2
    assert odds[1:4].tolist() == [0, 0, 0]
    assert odds[4:].tolist() == [NEVER, NEVER]  # too far to walk; seen while the other was there


def test_who_is_lost_for_a_moment_is_found_again_at_once() -> None:
    ids = shown(belief(0.0, {3: (0, 0, 1)}), belief(0.5, {}), belief(1.0, {7: (0.2, 0, 1)}))
    assert ids == [[3], [], [3]]


def test_somebody_of_another_size_is_somebody_else() -> None:
    ids = shown(belief(0.0, {3: (0, 0, TALL)}), belief(0.5, {}), belief(1, {7: (0.2, 0, SHORT)}))
    assert ids[-1] == [7]


def test_nobody_walks_faster_than_people_do() -> None:
    ids = shown(belief(0.0, {3: (0, 0, 1)}), belief(0.5, {}), belief(1.0, {7: (9.0, 0, 1)}))
    assert ids[-1] == [7]


def test_two_who_look_alike_are_distinguished_by_nothing_and_stay_new() -> None:
    ids = shown(
        belief(0.0, {3: (0, 0, 1), 4: (0.5, 0, 1)}), belief(0.5, {}), belief(1, {7: (0.25, 0, 1)})
    )
    assert ids[-1] == [7]


def test_two_who_come_back_at_once_keep_their_own_and_are_never_one() -> None:
    ids = shown(
        belief(0.0, {3: (0, 0, TALL), 4: (2, 0, SHORT)}),
        belief(0.5, {}),
        belief(1.0, {8: (1.9, 0, SHORT), 9: (0.1, 0, TALL)}),
        belief(1.1, {8: (1.9, 0, SHORT), 9: (0.1, 0, TALL), 10: (1.0, 0, TALL)}),
    )
    assert ids[2:] == [[4, 3], [4, 3, 10]]


def test_identities_last_as_long_as_their_tracks_and_go_on_with_the_next() -> None:
    places = {5: (0.0, 0.0, 1.0)}
    ids = shown(
        belief(0.0, places),
        belief(0.4, {}),
        belief(0.8, {6: (0.1, 0, 1)}),
        belief(9.0, {6: (0.1, 0, 1)}),
        belief(9.4, {}),
        belief(9.8, {8: (0.2, 0, 1)}),
    )
    assert ids == [[5], [], [5], [5], [], [5]]


def test_a_second_track_of_somebody_there_leaves_nothing_behind() -> None:
    ids = shown(
        belief(0.0, {3: (0, 0, 1), 4: (0.2, 0, 1)}),
        belief(0.5, {3: (0, 0, 1)}),
        belief(1.0, {3: (0, 0, 1), 9: (1.0, 0, 1)}),
    )
    assert ids[-1] == [3, 9]


def test_a_decision_is_not_made_late() -> None:
    far, near = belief(0.6, {7: (0.2, 0, 1)}, taught=0), belief(0.7 + DECIDE_S, {7: (0.2, 0, 1)})
    alike = {3: (0.0, 0.0, 1.0), 4: (0.4, 0.0, TALL)}
    assert shown(belief(0.0, alike), belief(0.5, {}), far, near)[-1] == [7]


def test_memory_is_bounded_in_number_and_time() -> None:
    crowd = {i: (3.0 * i, 0.0, 1.0) for i in range(MAX_DEPARTED + 9)}
    before, gone = belief(0.0, crowd), belief(0.5, {})
    identities = identify(Identities.none(MODEL), before, before, before.track_ids, MODEL)
    identities = identify(identities, before, gone, gone.track_ids, MODEL)
    assert len(identities.departed.track_ids) == MAX_DEPARTED
    late = belief(DEPARTED_S + 1, {})
    identities = identify(identities, gone, late, late.track_ids, MODEL)
    assert len(identities.departed.track_ids) == 0


def test_somebody_unseen_for_two_seconds_keeps_the_identity_shown() -> None:
    estimator = Filtered(MODEL, StepKernel())
    memory, ids = estimator.begin(), []
    scene = simulate(SCENE, seed=5)
    for slot in range(scene.num_slots):
        hidden = 60 <= slot < 110
        views: dict[int, Poses2D] = {}
        for camera in range(3):
            view = scene.view(slot, camera)
            if view is not None:
                views[camera] = Poses2D.empty(17) if hidden else view
        memory, estimate = estimator.estimate(memory, views, slot / scene.fps, lambda: 0.0)
        ids.append(estimate.people.track_ids.tolist())
        outlook = estimator.outlook(memory, 0.1)
        assert set(ids[-1]) <= set(outlook.expected.track_ids.tolist())
    assert ids[100] == []
    assert len(ids[50]) == 1
    assert ids[-1] == ids[50]
    assert memory.belief.track_ids.tolist() != ids[50]  # the filter itself has a new track
