"""Data of the compiled filter: constants of a model, and working memory.

Everything is a structure of arrays: one array per quantity, a row per track, detection or leftover.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from e3pose.estimate.filter.bias import MemoryTerms, memory_terms
from e3pose.estimate.filter.proportions import Proportions
from e3pose.estimate.filter.state import MAX_LEFTOVERS, Belief, Model
from e3pose.geometry.overlap import overlap
from e3pose.geometry.undistort import Lenses, make_lenses
from e3pose.model.proportions import KINDS
from e3pose.runtime.held import Held, hold
from e3pose.runtime.kernel import LANES

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Site(NamedTuple):
    """What is constant about a rig, a skeleton and a detector."""

    projections: Floats  # (num_cameras, 3, 4)
    centers_m: Floats  # (num_cameras, 3)
    sizes: Floats  # (num_cameras, 2)
    scales: Floats  # (num_cameras,)
    noise_scores: Floats  # (num_knots,)
    noise_px: Floats  # (num_knots,)
    noise_weight: float
    memory: MemoryTerms  # of the detector's errors
    body: Proportions  # its bones
    loose: Flags  # (num_bones,) not between a joint and its parent
    girdles: Integers  # (num_girdles, 2) left and right shoulder, left and right hip
    parents: Integers  # (num_joints,) -1 at the root
    order: Integers  # (num_joints,) the root first, each joint after its parent
    depths: Integers  # (num_joints,) steps from the root
    drift_m2ps4: Floats  # (num_joints,)
    lasts_s: Floats  # (num_joints,)
    usual_m: Floats  # (num_joints,) distance from the parent; 0 where none is known
    opposites: Integers  # (num_joints,) the joint of the other side, or itself
    limbs: Integers  # (num_joints,) of arms 1, of legs 2, else 0
    corner_m: Floats  # (2,) of the cells of `Belief.detection_map`
    overlap: Floats  # (num_cameras, num_cameras) share of a camera's view (row) that others see
    wait_s: float  # how long a detection that no track explains waits for a second view
    lenses: Lenses


def make_site(model: Model) -> Site:
    """Collect the constants of a model."""
    tree = model.tree
    body = model.proportions
    loose = np.ones(len(body.bones), bool)
    loose[body.links[body.links >= 0]] = False
    depths = np.zeros(len(model.skeleton), np.int64)
    for depth, joints in enumerate(tree.levels):
        depths[joints] = depth
    return Site(
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
        np.ascontiguousarray(model.corner_m),
        np.ascontiguousarray(overlap(model.rig)),
        float(model.wait_s),
        make_lenses(model.rig),
    )


@lru_cache(maxsize=8)
def held_site(model: Model) -> Held[Site]:
    """Return the constants of a model as kernels take them."""
    return hold(make_site(model))


class Views(NamedTuple):
    """The detections of a slot: as they came, and in rows, ordered by camera."""

    arrived: Flags  # (num_cameras,)
    counts: Integers  # (num_cameras,)
    keypoints_px: Floats  # (num_cameras, max_people, num_joints, 2) in the real images
    scores: Floats  # (num_cameras, max_people, num_joints)
    starts: Integers  # (num_cameras,) the row of a camera's first detection
    cameras: Integers  # (num_rows,)
    free: Flags  # (num_rows,) no track explains it
    strength: Floats  # (num_rows,) sum of scores
    ranks: Integers  # (num_rows,) how many of the same camera are surer
    pixels: Floats  # (num_rows, num_joints, 2) undistorted
    weights: Floats  # (num_rows, num_joints) scores
    variances: Floats  # (num_rows, num_joints) of either coordinate, px^2
    lanes: Floats


class Tracks(NamedTuple):
    """The columns of `filter.Belief`, in its order, with room for more tracks."""

    track_ids: Integers
    state: Floats
    covariance: Floats
    shared: Floats
    unmeasured_s: Floats
    drift_share: Floats
    existence: Floats
    hits: Integers
    alone: Floats
    seen_by: Flags
    last_seen_s: Floats
    delivered: Floats
    missed: Floats
    bias_px: Floats
    confirmed: Flags
    mirrored: Floats
    bones_m: Floats
    bone_counts: Floats
    innovations: Floats
    agility: Floats
    corrected_m: Floats


class Waiting(NamedTuple):
    """Detections that nobody explains, of this slot and of earlier ones."""

    times_s: Floats
    cameras: Integers
    keypoints_px: Floats
    scores: Floats
    strength: Floats  # sum of scores
    order: Integers  # the rows that stay, in order


class Matches(NamedTuple):
    """The detection of each track in each view."""

    assigned: Integers  # (num_cameras, num_tracks) row within the view, -1 for none
    fits: Floats  # (num_cameras, num_tracks)
    inside: Flags  # (num_cameras, num_tracks) the view should show the track
    places_m: Floats  # (num_tracks, 2) on the floor, as predicted
    taught: Flags  # (num_tracks,) somebody of whom it is learned what cameras show
    exchanged: Integers  # (num_cameras, num_tracks) limbs whose sides it exchanged (`sides`)


class Detectors(NamedTuple):
    """Keypoint noise of the cameras, and the evidence of a slot."""

    noise_px: Floats  # (num_knots,) of the noise file, with the tilt by score
    logs: Floats  # (num_cameras + 1,) logarithm of the factor on the noise file; the tilt
    scales: Floats  # (num_cameras,) `Site.scales` times that factor
    fresh: Floats  # (num_cameras + 1,) keypoints that teach
    steps: Floats  # (num_cameras + 1,) how much they are beyond their median
    shifts_px: Floats  # (num_cameras, 2) what is taken off all keypoints
    residuals: Floats  # (num_cameras, 3) weighted sums of what is left, right and down; weights


class Offers(NamedTuple):
    """Room for assigning the detections of one view."""

    projected: Floats  # (4, num_joints) one track in the view: u, v, variance, in front
    cost: Floats  # (num_tracks, max_people)
    vagueness: Floats  # (num_tracks, max_people)
    exchanged: Integers  # (num_tracks, max_people) limbs whose sides it would have exchanged
    offered: Floats  # (num_tracks, max_people) their sum, of those who choose
    choosers: Integers  # (num_tracks,)
    people: Integers  # (max_people,)
    reals: Floats  # (3, tracks or people) for `assign`
    integers: Integers  # (5, tracks or people) likewise
    flags: Flags  # (2, tracks or people) likewise


class Passes(NamedTuple):
    """Room for the passes of one track's update; blocks of 6 x 6 are rows of 36 numbers."""

    prior_own: Floats  # (num_joints, 36) information of the prior about each joint
    prior_across: Floats  # (num_joints, 36) about each joint and its parent
    own: Floats  # (num_joints, 36) the same of one pass, and what is made of it
    across: Floats  # (num_joints, 36)
    room: Floats  # (3, 36)
    pull: Floats  # (num_joints, 6)
    moved: Floats  # (num_joints, 6) from the prediction
    places: Floats  # (num_joints, 3)
    seen: Floats  # (num_joints, 9) of keypoints and loose bones: a symmetric 3 x 3, a vector
    measured: Flags  # (num_joints,)
    kinds: Floats  # (4, num_kinds) for `proportions`
    lengths_m: Floats  # (num_bones,) expected
    variances: Floats  # (num_bones,) of their logarithms
    slacks_m: Floats  # (num_bones,) how far they stray; 0 for bones of unknown length


class Pairs(NamedTuple):
    """Room for the pairs of leftovers that may be one person."""

    fits: Floats  # (num_pairs,)
    ends: Integers  # (num_pairs, 2)
    joints_m: Floats  # (num_pairs, num_joints, 3)
    taken: Flags  # (num_waiting,)
    px: Floats  # (2, num_joints, 2) of one pair
    scores: Floats  # (2, num_joints)
    cameras: Integers  # (2,)
    rows: Integers  # (2,) 0, 1
    small: Floats  # (4, 4, 4)
    middle: Floats  # (3,)
    sorted: Floats  # (num_joints,)
    logs: Floats  # (num_bones,)


class Memory(NamedTuple):
    """All of it, allocated once for as many tracks, people and leftovers."""

    views: Views
    tracks: Tracks
    waiting: Waiting
    matches: Matches
    detectors: Detectors
    offers: Offers
    passes: Passes
    pairs: Pairs


def make_memory(model: Model, num_tracks: int, num_people: int, num_waiting: int) -> Memory:
    """Allocate room for so many tracks, people in one view, and leftovers from earlier slots."""
    cameras, joints = len(model.rig), len(model.skeleton)
    waiting = MAX_LEFTOVERS + num_waiting
    return Memory(
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
        shifts_px=np.zeros((cameras, 2)),
        residuals=np.zeros((cameras, 3)),
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
        seen=np.zeros((joints, 9)),
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
