"""Constants and workspace of the compiled filter."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from e3pose.base.kernel import LANES
from e3pose.base.kernel_arguments import Held
from e3pose.estimate.filter.bias import memory_terms
from e3pose.estimate.filter.scratch import (
    MAX_LEFTOVERS,
    Constants,
    Detectors,
    Matches,
    Offers,
    Pairs,
    Passes,
    Tracks,
    Views,
    Waiting,
    Workspace,
)
from e3pose.estimate.filter.state import Belief, Model
from e3pose.model.overlap import overlap
from e3pose.model.proportions import KINDS, size_of
from e3pose.model.undistort import make_lenses


def make_constants(model: Model) -> Constants:
    """Collect the constants of a model."""
    tree = model.tree
    body = model.proportions
    loose = np.ones(len(body.bones), bool)
    loose[body.links[body.links >= 0]] = False
    depths = np.zeros(len(model.skeleton), np.int64)
    for depth, joints in enumerate(tree.levels):
        depths[joints] = depth
    return Constants(
        np.ascontiguousarray(model.rig.projections),
        np.ascontiguousarray(model.rig.centers_m),
        np.ascontiguousarray(model.rig.image_sizes),
        np.ascontiguousarray(model.scales),
        np.array(model.noise.scores),
        np.array(model.noise.sigma_px),
        float(model.noise.weight),
        memory_terms(model.noise.memory),
        body,
        loose,
        np.ascontiguousarray(model.girdles),
        np.ascontiguousarray(tree.parents),
        np.concatenate(tree.levels),
        depths,
        np.ascontiguousarray(tree.drift_m2ps4),
        np.ascontiguousarray(tree.lasts_s),
        np.ascontiguousarray(tree.usual_m),
        *model.sides,
        model.core,
        np.isin(np.arange(len(model.skeleton)), model.core),
        size_of(model.skeleton),
        np.ascontiguousarray(model.corner_m),
        np.ascontiguousarray(overlap(model.rig)),
        float(model.wait_s),
        make_lenses(model.rig),
    )


@lru_cache(maxsize=64)
def held_constants(model: Model) -> Held[Constants]:
    """Return the constants of a model as kernels take them."""
    return Held(make_constants(model))


def make_workspace(model: Model, num_tracks: int, num_people: int, num_waiting: int) -> Workspace:
    """Allocate a workspace for tracks, people per view, and leftovers from earlier slots."""
    cameras, joints = len(model.rig), len(model.skeleton)
    waiting = MAX_LEFTOVERS + num_waiting
    return Workspace(
        _views(cameras, num_people, joints),
        _tracks(model, num_tracks),
        _waiting(waiting, joints),
        _matches(cameras, num_tracks),
        _detectors(cameras, len(model.noise.scores)),
        _offers(num_tracks, num_people, joints),
        _passes(joints, len(model.proportions.bones)),
        _pairs(waiting, joints, len(model.proportions.bones)),
    )


def _views(cameras: int, people: int, joints: int) -> Views:
    rows = cameras * people
    return Views(
        arrived=np.zeros(cameras, bool),
        unchanged=np.zeros(cameras, bool),
        pace_px=np.zeros(cameras),
        counts=np.zeros(cameras, np.int64),
        keypoints_px=np.zeros((cameras, people, joints, 2)),
        scores=np.zeros((cameras, people, joints)),
        starts=np.zeros(cameras, np.int64),
        cameras=np.zeros(rows, np.int64),
        free=np.zeros(rows, bool),
        strength=np.zeros(rows),
        ranks=np.zeros(rows, np.int64),
        pixels=np.zeros((rows, joints, 2)),
        weights=np.zeros((rows, joints)),
        variances=np.zeros((rows, joints)),
        lanes=np.zeros(6 * LANES),
    )


def _tracks(model: Model, tracks: int) -> Tracks:
    return Tracks(
        **{
            name: np.zeros((tracks, *column.shape[1:]), column.dtype)
            for name, column in Belief.empty(model).columns().items()
        }
    )


def _waiting(waiting: int, joints: int) -> Waiting:
    return Waiting(
        times_s=np.zeros(waiting),
        cameras=np.zeros(waiting, np.int64),
        keypoints_px=np.zeros((waiting, joints, 2)),
        scores=np.zeros((waiting, joints)),
        strength=np.zeros(waiting),
        order=np.zeros(waiting, np.int64),
    )


def _matches(cameras: int, tracks: int) -> Matches:
    return Matches(
        assigned=np.zeros((cameras, tracks), np.int64),
        fits=np.zeros((cameras, tracks)),
        inside=np.zeros((cameras, tracks), bool),
        places_m=np.zeros((tracks, 2)),
        taught=np.zeros(tracks, bool),
        exchanged=np.zeros((cameras, tracks), np.int64),
    )


def _detectors(cameras: int, knots: int) -> Detectors:
    return Detectors(
        noise_px=np.zeros(knots),
        logs=np.zeros(cameras + 1),
        scales=np.zeros(cameras),
        fresh=np.zeros(cameras + 1),
        steps=np.zeros(cameras + 1),
        sharpness=np.zeros((cameras, 2)),
    )


def _offers(tracks: int, people: int, joints: int) -> Offers:
    most = max(tracks, people)
    return Offers(
        projected=np.zeros((4, joints)),
        cost=np.zeros((tracks, people)),
        vagueness=np.zeros((tracks, people)),
        exchanged=np.zeros((tracks, people), np.int64),
        offered=np.zeros((tracks, people)),
        choosers=np.zeros(tracks, np.int64),
        people=np.zeros(people, np.int64),
        reals=np.zeros((3, most)),
        integers=np.zeros((5, most), np.int64),
        flags=np.zeros((2, most), bool),
    )


def _passes(joints: int, bones: int) -> Passes:
    return Passes(
        prior_own=np.zeros((joints, 36)),
        prior_across=np.zeros((joints, 36)),
        own=np.zeros((joints, 36)),
        across=np.zeros((joints, 36)),
        room=np.zeros((3, 36)),
        pull=np.zeros((joints, 6)),
        moved=np.zeros((joints, 6)),
        places=np.zeros((joints, 3)),
        seen=np.zeros((joints, 18)),
        measured=np.zeros(joints, bool),
        kinds=np.zeros((4, len(KINDS))),
        lengths_m=np.zeros(bones),
        variances=np.zeros(bones),
        slacks_m=np.zeros(bones),
    )


def _pairs(waiting: int, joints: int, bones: int) -> Pairs:
    pairs = MAX_LEFTOVERS * (MAX_LEFTOVERS - 1) // 2
    return Pairs(
        fits=np.zeros(pairs),
        ends=np.zeros((pairs, 2), np.int64),
        joints_m=np.zeros((pairs, joints, 3)),
        taken=np.zeros(waiting, bool),
        px=np.zeros((2, joints, 2)),
        scores=np.zeros((2, joints)),
        cameras=np.zeros(2, np.int64),
        rows=np.arange(2),
        small=np.zeros((4, 4, 4)),
        middle=np.zeros(3),
        sorted=np.zeros(joints),
        logs=np.zeros(bones),
    )
