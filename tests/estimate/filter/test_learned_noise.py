"""The noise of detectors, learned while the filter runs, against noise that is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.room import (
    ALL,
    MODEL,
    NUM_CAMERAS,
    RIG,
    Views,
    run,
    standing,
    step,
    turn,
)
from tests.interpreted import interpreted
from tests.reference.filter_learned_noise import knots_px

from e3pose.base.arrays import Floats
from e3pose.estimate.filter import Belief, Model, Noise, outlook
from e3pose.estimate.filter.covariance_inflation import MEMORY_S
from e3pose.estimate.filter.learned_noise import CAUTION, MOST, SHARPNESS, find_logs, found
from e3pose.estimate.filter.outliers import LEAST_KNOWN, MEMORY
from e3pose.model.noise import ASSUMED_WEIGHT, KNOWN_WEIGHT
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.simulate.noise import correlated

FPS = 12.5
SCORES = (0.5, 0.9)  # half of the keypoints each
PLACES = ((0.0, 0.0), (1.2, 0.6), (-0.8, 1.0))


def walking(
    seconds: float,
    factor: Floats,
    cameras_of_slot: str = "all",
    wild: float = 0.0,
    radius_m: float = 0.5,
) -> list[Views]:
    """Return views of three people who walk in circles, with noise that lasts."""
    rng = np.random.default_rng(1)
    times = np.arange(round(seconds * FPS)) / FPS
    circle = radius_m * np.stack([np.cos(1.5 * times), np.sin(1.5 * times)], axis=-1)
    people = np.repeat(standing(*PLACES)[None], len(times), axis=0)
    people[..., :2] += circle[:, None, None]
    scores = np.where(rng.uniform(size=people.shape[:-1]) < 0.5, *SCORES)
    sigma = MODEL.noise.of(scores)[..., None]
    slots: list[dict[int, Poses2D]] = [{} for _ in times]
    for camera in range(NUM_CAMERAS):
        pixels = RIG.cameras[camera].project(people)
        errors = correlated(rng, pixels.shape, 1 / FPS, MODEL.noise.memory.parts)
        pixels = pixels + factor[camera] * sigma * errors
        lost = rng.uniform(size=pixels.shape[:-1]) < wild
        pixels = np.where(lost[..., None], pixels + rng.normal(scale=80, size=pixels.shape), pixels)
        for slot, px in enumerate(pixels):
            if camera in (ALL if cameras_of_slot == "all" else turn(slot)):
                slots[slot][camera] = Poses2D(px, scores[slot])
    return list(slots)


def stated(times: float, weight: float = KNOWN_WEIGHT) -> Model:
    """Return the model of a noise file whose sigma is so many times the right one."""
    noise = MODEL.noise
    wrong = Noise(noise.scores, times * noise.sigma_px, noise.image_px, weight)
    return Model(RIG, COCO17, wrong)


def learned(model: Model, slots: list[Views]) -> Floats:
    belief, _ = run(slots, fps=FPS, model=model)
    return found(belief.noise, model.noise.weight)


@each_case("times", [0.25, 0.5, 1.0, 2.0, 4.0])
def test_noise_that_is_stated_wrongly_is_found_within_a_quarter(times: float) -> None:
    factor = learned(stated(times), walking(8.0, np.ones(NUM_CAMERAS)))
    assert factor * times == pytest.approx(np.ones(NUM_CAMERAS), rel=0.25)


@each_case("times", [0.5, 1.0, 2.0])
def test_it_is_found_with_one_camera_a_slot(times: float) -> None:
    slots = walking(2.0, np.ones(NUM_CAMERAS)) + walking(32.0, np.ones(NUM_CAMERAS), "turn")[25:]
    factor = learned(stated(times), slots)
    assert np.median(factor * times) == pytest.approx(1.0, rel=0.3)


def test_camera_that_is_twice_as_noisy_is_found() -> None:
    factor = np.array([1.0, 1.0, 2.0, 1.0, 1.0])
    found_of = learned(stated(1.0), walking(8.0, factor))
    assert found_of[2] / np.delete(found_of, 2) == pytest.approx(np.full(4, 2.0), rel=0.25)


def test_what_a_score_is_worth_is_found() -> None:
    flat = Noise(np.array([0.4, 0.95]), np.array([5.0, 5.0]), MODEL.noise.image_px)
    model = Model(RIG, COCO17, flat)
    belief, _ = run(walking(12.0, np.ones(NUM_CAMERAS)), fps=FPS, model=model)
    low, high = knots_px(model, belief.noise).mean(axis=0) / CAUTION
    true = MODEL.noise.of(np.array([0.45, 0.95]))
    wrong = low / high / (true[0] / true[1])  # a quarter, as the file states it
    assert 1 / 1.5 < wrong < 1.5


def test_wild_joints_do_not_inflate_it() -> None:
    quiet = learned(stated(1.0), walking(8.0, np.ones(NUM_CAMERAS)))
    wild = learned(stated(1.0), walking(8.0, np.ones(NUM_CAMERAS), wild=0.1))
    assert (wild / quiet < 1.25).all()


def test_assumed_noise_is_given_up_faster_than_measured() -> None:
    noise = np.tile(
        [np.log(3.0), 30.0, 1.0], (NUM_CAMERAS + 1, 1)
    )  # little is seen, three times as noisy
    assumed, known = (factors(noise, weight)[0] for weight in (ASSUMED_WEIGHT, KNOWN_WEIGHT))
    assert 1.0 < 1.2 * known < assumed < 3.0


def test_bounds_hold_whatever_is_seen() -> None:
    exact = walking(16.0, np.zeros(NUM_CAMERAS))
    belief, _ = run(exact, fps=FPS, model=stated(1.0))
    factor = factors(belief.noise, KNOWN_WEIGHT)
    assert (factor >= 1 / MOST).all()
    assert (factor < 0.4).all()
    assert (belief.noise[:, 1] <= MEMORY).all()


def test_nothing_is_reported_before_much_is_seen() -> None:
    belief = Belief.empty(MODEL)
    assert np.isnan(found(belief.noise, KNOWN_WEIGHT)).all()
    assert (factors(belief.noise, KNOWN_WEIGHT) == 1).all()
    belief = replace(belief, noise=np.full((NUM_CAMERAS + 1, 3), LEAST_KNOWN))
    assert np.isfinite(found(belief.noise, KNOWN_WEIGHT)).all()


def test_camera_that_never_looked_is_taken_for_like_the_others() -> None:
    belief, _ = run(walking(8.0, np.ones(NUM_CAMERAS)), fps=FPS, model=stated(4.0))
    noise = belief.noise.copy()
    noise[3] = 0.0
    factor = factors(noise, KNOWN_WEIGHT)
    assert factor[3] < 0.8  # of 1, which the file states
    assert factor[3] > np.delete(factor, 3).min()
    assert np.isnan(found(noise, KNOWN_WEIGHT)[3])


def test_foresight_expects_the_mean_of_the_noise_that_was_learned() -> None:
    model = stated(2.0)
    belief, _ = run(walking(8.0, np.array([1.0, 0.5, 1.0, 1.0, 2.0])), fps=FPS, model=model)
    least = knots_px(model, belief.noise).min(axis=1)
    assert least.max() > 2 * least.min()
    sigma = outlook(model, belief, 0.04).expected.sigma_px
    assert sigma / model.scales == pytest.approx(np.exp(np.log(least / model.scales).mean()))
    assert (sigma < 0.9 * model.noise.sigma_px.min() * model.scales).all()


def test_what_a_camera_says_of_its_own_noise_brings_it_no_selection() -> None:
    """A camera sure of all it sees counts like one that is not, one that shows less for less."""
    half = np.arange(17) % 2 == 0
    slots: list[Views] = []
    for views in walking(8.0, np.ones(NUM_CAMERAS)):
        sure, partial = views[0], views[1]
        hidden_px = np.where(half[:, None], partial.keypoints_px, np.nan)
        slots.append(
            {
                **views,
                0: Poses2D(sure.keypoints_px, np.where(sure.scores > 0, 1.0, 0.0)),
                1: Poses2D(hidden_px, np.where(half, partial.scores, 0.0)),
            }
        )
    belief, _ = run(slots, fps=FPS, model=stated(1.0))
    assert (belief.delivered[:, 0] > 1.3 * belief.delivered[:, 2:].max()).all()
    worth = outlook(stated(1.0), belief, 0.04).expected.delivered / belief.delivered
    others = belief.noise[2:-1, SHARPNESS].mean()
    assert worth[:, 0] / worth[:, 2:].mean() == pytest.approx(np.full(3, others), rel=0.05)
    assert worth[:, 1] / worth[:, 2:].mean() == pytest.approx(np.ones(3), rel=0.05)


def test_it_outlasts_people_and_pauses() -> None:
    belief, _ = run(walking(4.0, np.ones(NUM_CAMERAS)), fps=FPS, model=stated(2.0))
    later, _ = step(stated(2.0), belief, {}, belief.time_s + 60)
    assert len(later) == 0
    np.testing.assert_array_equal(later.noise, belief.noise)


def test_ghosts_of_one_camera_teach_nothing() -> None:
    belief, _ = run(walking(4.0, np.ones(NUM_CAMERAS)), fps=FPS, model=stated(1.0))
    alone = [{0: slot[0]} for slot in walking(8.0, np.ones(NUM_CAMERAS))[50:]]
    late, _ = run(alone[:13], fps=FPS, model=stated(1.0), belief=belief)
    after, _ = run(alone[13:], fps=FPS, model=stated(1.0), belief=late)
    np.testing.assert_array_equal(after.noise, late.noise)
    assert set(late.track_ids) == set(after.track_ids)
    left = np.exp(-(after.time_s - late.time_s) / MEMORY_S)
    np.testing.assert_allclose(after.innovations, left * late.innovations)


def factors(noise: Floats, weight: float) -> Floats:
    """`(num_cameras,)` factors on the sigma of the noise file."""
    logs = np.empty(len(noise))
    interpreted(find_logs)(noise, weight, logs)
    return np.asarray(np.exp(logs[:-1]))
