"""One slot of the filter: predict, associate, update, end and start tracks.

`predict` has the loops of `filter.motion`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from operator import attrgetter
from typing import Any

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.base.kernel import kernel
from e3pose.base.kernel_arguments import Held
from e3pose.estimate.filter.allocation import held_constants, make_workspace
from e3pose.estimate.filter.associate import associate
from e3pose.estimate.filter.births import give_birth
from e3pose.estimate.filter.blindness import learn_detection_map
from e3pose.estimate.filter.compare import compare_predicted, compare_updated
from e3pose.estimate.filter.existence import count_views, end
from e3pose.estimate.filter.learned_noise import learn_noise, recall_noise
from e3pose.estimate.filter.lone_view import update_by_views
from e3pose.estimate.filter.motion import ACCELERATION_LASTS_S, move
from e3pose.estimate.filter.scratch import (
    MAX_LEFTOVERS,
    Constants,
    Detectors,
    Passes,
    Tracks,
    Views,
    Workspace,
)
from e3pose.estimate.filter.shown import people_of
from e3pose.estimate.filter.sides import turn_round
from e3pose.estimate.filter.state import MAX_TRACKS, Belief, Leftovers, Model
from e3pose.estimate.filter.tree import backward, decompose, forward
from e3pose.estimate.filter.unchanged import pace_px
from e3pose.estimate.filter.update import learn_bones
from e3pose.model.people import People
from e3pose.model.pose import MAX_PIXEL, MISSING_SCORE, Poses2D
from e3pose.model.undistort import undistort_slot

LONGEST_S = 10.0  # timeout: after a longer pause everybody is somewhere else
MAX_PEOPLE = 64  # capacity: in one view; more are noise, and must not cost the slot


def check_slot(model: Model, views: Mapping[int, Poses2D], time_s: float) -> None:
    """Raise `InputError` for views or a time that `step` cannot take."""
    if not math.isfinite(time_s):
        raise InputError(f"time: found {time_s}, expected seconds")
    for camera, view in views.items():
        if not 0 <= camera < len(model.rig):
            raise InputError(f"camera {camera}: expected an index below {len(model.rig)}")
        if view.scores.shape[1] != len(model.skeleton):
            raise InputError(
                f"camera {model.rig.camera_ids[camera]}: keypoints: found {view.scores.shape[1]} "
                f"joints, expected {len(model.skeleton)} ({model.skeleton.name})"
            )


def bounded(view: Poses2D) -> tuple[Floats, Floats]:
    """Return keypoints and scores of at most `MAX_PEOPLE` people, the most certain ones."""
    if len(view) <= MAX_PEOPLE:
        return view.keypoints_px, view.scores
    strongest = np.argsort(-view.scores.sum(axis=1), kind="stable")[:MAX_PEOPLE]
    rows = np.sort(strongest)
    return view.keypoints_px[rows], view.scores[rows]


LEAST_PEOPLE = 16  # capacity: of one view, for whom there is always room
_columns = attrgetter(*Tracks._fields)  # of a belief, as its constructor takes them


class StepKernel:
    """One slot of the filter: belief and views in, new belief and people out.

    It keeps no history, but what is constant about the newest model, and its working memory with
    the newest belief in it; so it must not be shared between threads.
    """

    def __init__(self) -> None:
        self._model: Model | None = None
        self._call: Any = step_slot
        self._newest: tuple[
            Any, ...
        ] = ()  # columns of the newest belief, as the workspace has them

    def __call__(
        self, model: Model, belief: Belief, views: Mapping[int, Poses2D], time_s: float
    ) -> tuple[Belief, People]:
        """Return the new belief and its people.

        Args:
            model: the rig, the skeleton, the noise.
            belief: of the slot before; it is not changed.
            views: camera index to what it saw, in pixels of the real image.
            time_s: when; a view that came late counts as seen now, time never runs backwards.

        Raises:
            InputError: for a camera that the rig does not have, or a time that is not a number.
        """
        check_slot(model, views, time_s)
        first = math.isnan(belief.time_s)
        now = time_s if first else max(time_s, belief.time_s)
        dt = 0.0 if first else now - belief.time_s
        before = belief.without_people() if dt > LONGEST_S else belief
        waiting, num_tracks, num_old = before.leftovers, len(before), len(before.leftovers)
        most = min(max((len(view) for view in views.values()), default=0), MAX_PEOPLE)
        workspace = self._room_for(model, num_tracks + MAX_LEFTOVERS // 2, most, num_old)
        _pack(workspace.views, views, model.scales)
        if num_tracks:
            given_rows = zip(workspace.tracks, _columns(before), self._newest, strict=True)
            for column, given, newest in given_rows:
                if given is not newest:  # beliefs never change: it still has what it made
                    column[:num_tracks] = given
        if num_old:
            workspace.waiting.times_s[:num_old] = waiting.times_s
            workspace.waiting.cameras[:num_old] = waiting.cameras
            workspace.waiting.keypoints_px[:num_old] = waiting.keypoints_px
            workspace.waiting.scores[:num_old] = waiting.scores
        self._newest = (None,) * len(workspace.tracks)  # until the kernel returns
        failed_pairs, detection_map, noise = (
            np.array(of_site, order="C")
            for of_site in (belief.failed_pairs, belief.detection_map, belief.noise)
        )
        num_tracks, num_waiting, next_id = self._call(
            num_tracks,
            num_old,
            now,
            dt,
            belief.next_id,
            self._constants,
            failed_pairs,
            detection_map,
            noise,
            self._held_workspace,
        )
        leftovers = waiting
        if num_old or num_waiting:
            rows = workspace.waiting.order[:num_waiting]
            leftovers = Leftovers(
                workspace.waiting.times_s[rows],
                workspace.waiting.cameras[rows],
                workspace.waiting.keypoints_px[rows],
                workspace.waiting.scores[rows],
            )
        (kept,) = np.nonzero(~workspace.offers.flags[0, :num_tracks])
        if len(kept) == num_tracks:
            newest = self._newest = tuple(column[:num_tracks].copy() for column in workspace.tracks)
        else:
            newest = tuple(column[kept] for column in workspace.tracks)
        site = now, leftovers, failed_pairs, detection_map, noise, next_id
        arrays: tuple[Any, ...] = (*newest, *site)
        belief = Belief(*arrays)
        return belief, people_of(belief, model)

    def _room_for(self, model: Model, tracks: int, people: int, old: int) -> Workspace:
        """Return a workspace for the given numbers of tracks, people in a view and leftovers."""
        if model is not self._model:
            self._model = model
            self._constants = held_constants(model)
            self._room = (0, 0, 0)
        room = self._room
        if tracks > room[0] or people > room[1] or old > room[2]:
            self._room = (
                max(tracks, room[0], MAX_TRACKS),
                max(people, room[1], LEAST_PEOPLE),
                max(old, room[2], MAX_LEFTOVERS),
            )
            self._workspace = make_workspace(model, *self._room)
            self._held_workspace = Held(self._workspace)
            self._newest = (None,) * len(self._workspace.tracks)
        return self._workspace


def _pack(arrays: Views, views: Mapping[int, Poses2D], scales: Floats) -> None:
    arrays.arrived[:] = arrays.unchanged[:] = False
    arrays.counts[:] = 0
    for camera, view in views.items():
        keypoints_px, scores = bounded(view)
        people = len(scores)
        arrays.counts[camera] = people
        arrays.keypoints_px[camera, :people] = keypoints_px
        arrays.scores[camera, :people] = scores
        arrays.arrived[camera] = view.unchanged_s <= 0
        if view.unchanged_s > 0:
            arrays.unchanged[camera] = True
            arrays.pace_px[camera] = scales[camera] * pace_px(view.unchanged_s)


@kernel
def step_slot(
    num_tracks: int,
    num_old: int,
    time_s: float,
    dt: float,
    next_id: int,
    held: Held[Constants],
    failed_pairs: Floats,
    detection_map: Floats,
    noise: Floats,
    room: Held[Workspace],
) -> tuple[int, int, int]:
    """Advance the tracks and leftovers in `room`; return their numbers and the next id.

    The first row of `offers.flags` then says which tracks have ended.
    """
    constants, workspace = held.values, room.values
    views, tracks = workspace.views, workspace.tracks
    predict(num_tracks, dt, constants, tracks, workspace.passes)
    for track in range(num_tracks):
        for axis in range(2):
            workspace.matches.places_m[track, axis] = tracks.state[track, constants.order[0], axis]
    recall_noise(noise, constants, workspace.detectors)
    _prepare(constants, workspace.detectors, views)
    num_views = 0
    for camera in range(len(views.counts)):
        if views.arrived[camera] or views.unchanged[camera]:
            num_views += 1
            associate(
                camera,
                num_tracks,
                constants,
                views,
                tracks.confirmed,
                tracks.state,
                tracks.covariance,
                workspace.matches,
                workspace.offers,
            )
    turn_round(num_tracks, dt, constants, views, workspace.matches, tracks)
    _revise(num_tracks, num_views, dt, constants, workspace)
    learn_noise(noise, workspace.detectors)
    count_views(
        num_tracks,
        dt,
        workspace.detectors.scales,
        workspace.detectors.noise_px,
        views,
        workspace.matches,
        detection_map,
        constants.corner_m,
        constants.core,
        constants.size,
        tracks,
    )
    learn_detection_map(
        num_tracks, dt, constants.corner_m, views.arrived, workspace.matches, detection_map, tracks
    )
    num_tracks, num_waiting, next_id = give_birth(
        num_tracks, num_old, time_s, dt, next_id, constants, workspace, failed_pairs
    )
    ended = workspace.offers.flags[0]
    end(num_tracks, constants.girdles, constants.core, constants.size, tracks, ended)
    return num_tracks, num_waiting, next_id


@kernel
def _revise(
    num_tracks: int, num_views: int, dt: float, constants: Constants, workspace: Workspace
) -> None:
    """Update every track with its detections, and learn noise, biases and bone lengths."""
    views, tracks, passes = workspace.views, workspace.tracks, workspace.passes
    for track in range(num_tracks):
        compare_predicted(track, dt, constants, views, workspace.matches, tracks)
        if num_views:
            update_by_views(track, dt, constants, views, workspace.matches.assigned, tracks, passes)
            compare_updated(
                track, dt, constants, views, workspace.matches, tracks, workspace.detectors
            )
        learn_bones(
            tracks.state[track],
            tracks.covariance[track],
            tracks.unmeasured_s[track],
            constants.body.bones,
            tracks.bones_m[track],
            tracks.bone_counts[track],
            passes.measured,
        )


@kernel
def _prepare(constants: Constants, detectors: Detectors, views: Views) -> None:
    """Undistort keypoints and look up their noise; no detection is explained yet."""
    undistort_slot(
        views.keypoints_px,
        views.scores,
        views.counts,
        constants.lenses.models,
        constants.lenses.numbers,
        constants.lenses.tables,
        views.lanes,
        views.pixels,
    )
    row = 0
    for camera in range(len(views.counts)):
        views.starts[camera] = row
        for person in range(views.counts[camera]):
            views.cameras[row] = camera
            views.free[row] = True
            for joint in range(views.scores.shape[2]):
                u, v = views.pixels[row, joint, 0], views.pixels[row, joint, 1]
                score = views.scores[camera, person, joint]
                if not (score >= MISSING_SCORE and abs(u) <= MAX_PIXEL and abs(v) <= MAX_PIXEL):
                    score = 0.0
                    views.pixels[row, joint, 0] = views.pixels[row, joint, 1] = np.nan
                views.weights[row, joint] = score
                sigma = _noise_px(score, constants.noise_scores, detectors.noise_px)
                sigma *= detectors.scales[camera]
                views.variances[row, joint] = sigma * sigma
            row += 1


@kernel
def _noise_px(score: float, scores: Floats, sigmas: Floats) -> float:
    """Interpolate as `numpy.interp` does."""
    last = len(scores) - 1
    if score <= scores[0]:
        return float(sigmas[0])
    if score >= scores[last]:
        return float(sigmas[last])
    knot = 0
    while scores[knot + 1] < score:
        knot += 1
    slope = (sigmas[knot + 1] - sigmas[knot]) / (scores[knot + 1] - scores[knot])
    return float(sigmas[knot] + slope * (score - scores[knot]))


@kernel
def predict(
    num_tracks: int, dt: float, constants: Constants, tracks: Tracks, passes: Passes
) -> None:
    """Move the first `num_tracks` tracks on by `dt` seconds, in place."""
    bias_fade = math.exp(-dt / constants.memory.lasting_s)
    num_joints = len(constants.order)
    for track in range(num_tracks):
        _advance(
            dt,
            constants,
            tracks.state[track],
            tracks.covariance[track].reshape(num_joints, 36),
            tracks.shared[track].reshape(num_joints, 36),
            tracks.drift_share[track],
            passes,
        )
        for joint in range(num_joints):
            tracks.unmeasured_s[track, joint] += dt
            for camera in range(tracks.bias_px.shape[1]):
                tracks.bias_px[track, camera, joint, 0] *= bias_fade
                tracks.bias_px[track, camera, joint, 1] *= bias_fade


@kernel
def _advance(
    dt: float,
    constants: Constants,
    state: Floats,
    covariance: Floats,
    shared: Floats,
    drift_share: Floats,
    passes: Passes,
) -> None:
    """Move one track on, in place; blocks are rows of 36.

    `before` is the covariance of a joint now with the same joint then.
    """
    moved, spread, with_parent = passes.moved, passes.own, passes.across
    before, factors = passes.prior_own, passes.prior_across
    move(dt, constants.order, constants.parents, constants.lasts_s, state, moved)
    for place in range(len(constants.order)):
        joint = constants.order[place]
        parent = constants.parents[joint]
        tau = constants.lasts_s[joint]
        fade = math.exp(-dt / tau)
        reach = tau * (1.0 - fade)
        if parent < 0:
            lean = passes.room[1]
            for entry in range(36):
                lean[entry] = covariance[joint, entry]
                with_parent[joint, entry] = 0.0
            _from_right(lean, reach, fade)
            for entry in range(36):
                before[joint, entry] = lean[entry]
                spread[joint, entry] = lean[entry]
            _from_left(spread[joint], reach, fade)
        else:
            _advance_child(joint, parent, reach, fade, covariance, shared, passes)
        gone = 1.0 - fade
        density = ACCELERATION_LASTS_S * constants.drift_m2ps4[joint] * drift_share[joint]
        pp = density * tau**2 * (dt - 2 * tau * gone + tau / 2 * (1 - fade * fade))
        pv = density * tau**2 * gone * gone / 2
        vv = density * tau / 2 * (1 - fade * fade)
        for a in range(3):
            spread[joint, 7 * a] += pp
            spread[joint, 7 * a + 3] += pv
            spread[joint, 7 * a + 18] += pv
            spread[joint, 7 * a + 21] += vv
        for entry in range(36):
            factors[joint, entry] = covariance[joint, entry]
        decompose(factors[joint])
    for joint in range(len(constants.order)):
        for entry in range(36):
            covariance[joint, entry] = spread[joint, entry]
            shared[joint, entry] = with_parent[joint, entry]
        for a in range(6):
            state[joint, a] = moved[joint, a]


@kernel
def _advance_child(
    joint: int,
    parent: int,
    reach: float,
    fade: float,
    covariance: Floats,
    shared: Floats,
    passes: Passes,
) -> None:
    """Advance the blocks of a child joint, after its parent's.

    What it has beyond its parent, x_j - x_p, fades; the parent goes its own way.
    """
    spread, with_parent = passes.own, passes.across
    before, factors = passes.prior_own, passes.prior_across
    gains, lean = passes.room[0], passes.room[1]
    for a in range(6):
        for b in range(6):
            gains[6 * a + b] = shared[joint, 6 * b + a]
    forward(factors[parent], gains)
    backward(factors[parent], gains)  # G'
    for a in range(6):
        for b in range(6):
            total = 0.0
            for k in range(6):
                total += gains[6 * k + a] * before[parent, 6 * k + b]
            # Of x_j with x_p then; of x_j - x_p, it is less by that of x_p.
            lean[6 * a + b] = total - before[parent, 6 * a + b]
            before[joint, 6 * a + b] = total
            spread[joint, 6 * a + b] = (
                covariance[joint, 6 * a + b]
                - shared[joint, 6 * a + b]
                - shared[joint, 6 * b + a]
                + covariance[parent, 6 * a + b]
            )
            with_parent[joint, 6 * a + b] = covariance[joint, 6 * a + b] - shared[joint, 6 * a + b]
    _from_right(with_parent[joint], reach, fade)
    for entry in range(36):
        before[joint, entry] += with_parent[joint, entry]
    _from_left(lean, reach, fade)
    _from_left(spread[joint], reach, fade)
    _from_right(spread[joint], reach, fade)
    for a in range(6):
        for b in range(6):
            spread[joint, 6 * a + b] += (
                lean[6 * a + b] + lean[6 * b + a] + spread[parent, 6 * a + b]
            )
            with_parent[joint, 6 * a + b] = lean[6 * a + b] + spread[parent, 6 * a + b]


@kernel
def _from_left(block: Floats, reach: float, fade: float) -> None:
    """Replace M by R M."""
    for a in range(18):
        block[a] += reach * block[a + 18]
        block[a + 18] *= fade


@kernel
def _from_right(block: Floats, reach: float, fade: float) -> None:
    """Replace M by M R'."""
    for a in range(6):
        for b in range(3):
            block[6 * a + b] += reach * block[6 * a + b + 3]
            block[6 * a + b + 3] *= fade
