"""One slot of the estimator: predict, associate, update, who exists, who is new.

Shapes and units of arguments, here and in the other files, stand with the kernels of their names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from tests.reference import (
    filter_agility,
    filter_bias,
    filter_covariance_inflation,
    filter_learned_noise,
    filter_lone_view,
)
from tests.reference.filter_associate import associate
from tests.reference.filter_births import give_birth
from tests.reference.filter_existence import count_views, end
from tests.reference.filter_sides import order, turn_round
from tests.reference.filter_update import (
    Sightings,
    Still,
    learn_biases,
    learn_bones,
    predict,
    update,
)

from e3pose.base.arrays import Floats, Integers
from e3pose.estimate.filter import bias
from e3pose.estimate.filter.projected import USED_SCORE
from e3pose.estimate.filter.shown import people_of
from e3pose.estimate.filter.state import Belief, Leftovers, Model
from e3pose.estimate.filter.step import LONGEST_S, bounded, check_slot
from e3pose.estimate.filter.unchanged import pace_px
from e3pose.model.people import People
from e3pose.model.pose import MAX_PIXEL, MISSING_SCORE, Poses2D


def step(
    model: Model, belief: Belief, views: Mapping[int, Poses2D], time_s: float
) -> tuple[Belief, People]:
    """Advance to `time_s` with the views that arrived: none, one, all, others than before."""
    check_slot(model, views, time_s)
    first = np.isnan(belief.time_s)
    now = time_s if first else max(time_s, belief.time_s)
    dt = 0.0 if first else now - belief.time_s
    if dt > LONGEST_S:
        belief = belief.without_people()  # places are known as before
    belief = predict(replace(belief, time_s=now), dt, model)
    looks = {camera: view for camera, view in views.items() if view.unchanged_s <= 0}
    still = {camera: view for camera, view in views.items() if view.unchanged_s > 0}
    cameras, keypoints, scores = _sorted(model, looks)
    knots_px = filter_learned_noise.knots_px(model, belief.noise)
    found = [
        associate(belief, k, s, camera, model, knots_px[camera])
        for camera, k, s in zip(cameras, keypoints, scores, strict=True)
    ]
    shape = (len(cameras), len(belief))
    assigned = np.array([rows for rows, _, _ in found], dtype=np.int64).reshape(shape)
    fits = np.array([fit for _, fit, _ in found]).reshape(shape)
    exchanged = np.array([turned for _, _, turned in found], dtype=np.int64).reshape(shape)
    predicted = belief
    stills = _stills(belief, still, knots_px, model)
    belief, exchanged = turn_round(belief, exchanged, assigned >= 0, cameras, dt, model)
    joints = order(exchanged, model)
    seen = _sightings(belief, cameras, keypoints, scores, assigned, joints, dt, model, knots_px)
    belief = filter_covariance_inflation.learn(belief, seen, cameras, dt, model)
    belief = before_look = filter_agility.learn(belief, seen, cameras, dt)
    updated = update(belief, seen, stills, model)
    belief = filter_lone_view.discount(belief, updated, cameras, assigned >= 0, dt, model)
    belief = filter_agility.note(belief, before_look, assigned >= 0)
    belief = learn_bones(belief, model)
    belief = filter_learned_noise.learn(belief, seen, cameras, dt, model)
    belief = learn_biases(belief, seen, cameras, dt, model)
    shares = _information_share(seen, knots_px[cameras])
    belief = count_views(belief, predicted, cameras, fits, assigned >= 0, shares, dt, model)
    fresh = _unexplained(belief, cameras, keypoints, scores, assigned, stills)
    belief = end(give_birth(belief, fresh, cameras, dt, model), model)
    return belief, people_of(belief, model)


def _sorted(
    model: Model, views: Mapping[int, Poses2D]
) -> tuple[Integers, list[Floats], list[Floats]]:
    """Return cameras in rig order and their people, without lenses."""
    cameras = np.array(sorted(views), dtype=np.int64)
    keypoints, scores = [], []
    for camera in cameras.tolist():
        pixels, certainty = bounded(views[camera])
        usable = (certainty >= MISSING_SCORE) & (np.abs(pixels) <= MAX_PIXEL).all(axis=-1)
        pixels = model.rig.cameras[camera].undistort(np.where(usable[..., None], pixels, np.nan))
        usable = (np.abs(pixels) <= MAX_PIXEL).all(axis=-1)
        keypoints.append(np.where(usable[..., None], pixels, np.nan))
        scores.append(np.where(usable, certainty, 0.0))
    return cameras, keypoints, scores


def _stills(
    belief: Belief, views: Mapping[int, Poses2D], knots_px: Floats, model: Model
) -> list[Still]:
    """Return who is seen in the views of unchanged images."""
    found = []
    cameras, *seen = _sorted(model, views)
    for camera, keypoints_px, scores in zip(cameras.tolist(), *seen, strict=True):
        rows, _, exchanged = associate(
            belief, keypoints_px, scores, camera, model, knots_px[camera]
        )
        (shown,), joints = np.nonzero(rows >= 0), order(exchanged[None], model)[0]
        weights = np.zeros(belief.state.shape[:2])
        weights[shown] = scores[rows[shown][:, None], joints[shown]]
        noise = pace_px(views[camera].unchanged_s) * float(model.scales[camera])
        free = ~np.isin(np.arange(len(scores)), rows)
        found.append(Still(camera, weights, noise, keypoints_px[free], scores[free]))
    return found


def _sightings(
    belief: Belief,
    cameras: Integers,
    keypoints: list[Floats],
    scores: list[Floats],
    assigned: Integers,
    joints: Integers,
    dt: float,
    model: Model,
    knots_px: Floats,
) -> Sightings:
    shape = (*assigned.shape, len(model.skeleton))
    all_keypoints, all_scores = np.full((*shape, 2), np.nan), np.zeros(shape)
    for view, row in enumerate(assigned):
        seen = row >= 0
        where = (row[seen][:, None], joints[view, seen])
        all_keypoints[view, seen] = keypoints[view][where]
        all_scores[view, seen] = scores[view][where]
    sigma = np.zeros(shape)
    for view, camera in enumerate(cameras.tolist()):
        sigma[view] = np.interp(all_scores[view], model.noise.scores, knots_px[camera])
    all_keypoints -= np.swapaxes(belief.bias_px[:, cameras], 0, 1)
    terms = bias.memory_terms(model.noise.memory)
    look = np.sqrt(filter_bias.inflation(belief.last_seen_s[:, cameras].T + dt, terms))[..., None]
    return Sightings(model.rig.projections[cameras], all_keypoints, all_scores, sigma, look)


def _information_share(seen: Sightings, knots_px: Floats) -> Floats:
    """Return `(num_views, num_tracks)`: the views' information, as a share of a perfect one's."""
    best = knots_px.min(axis=-1).reshape(-1, 1, 1)
    share = np.where(seen.scores > USED_SCORE, (best / seen.sigma_px) ** 2, 0.0)
    return np.asarray(share.mean(axis=-1))


def _unexplained(
    belief: Belief,
    cameras: Integers,
    keypoints: list[Floats],
    scores: list[Floats],
    assigned: Integers,
    stills: list[Still],
) -> Leftovers:
    free = [~np.isin(np.arange(len(s)), row) for s, row in zip(scores, assigned, strict=True)]
    rows = zip(cameras.tolist(), keypoints, scores, free, strict=True)
    waiting = [(camera, k[f], s[f]) for camera, k, s, f in rows]
    waiting += [(each.camera, each.free_px, each.free_scores) for each in stills]
    waiting.sort(key=lambda row: row[0])
    counts = [len(row[2]) for row in waiting]
    none = belief.leftovers.take(np.zeros(0, dtype=np.int64))
    return Leftovers(
        np.full(sum(counts), belief.time_s),
        np.repeat(np.array([row[0] for row in waiting], dtype=np.int64), counts),
        np.concatenate([none.keypoints_px, *(row[1] for row in waiting)]),
        np.concatenate([none.scores, *(row[2] for row in waiting)]),
    )
