"""Data of the compiled filter: constants of a model, and working memory (made by `allocation`).

Everything is a structure of arrays: one array per quantity, a row per track, detection or leftover.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.estimate.filter.bias import MemoryTerms
from e3pose.estimate.filter.bones import Proportions
from e3pose.model.undistort import Lenses

MAX_LEFTOVERS = 64  # capacity: newest first: a view full of noise must not cost the slot


class Constants(NamedTuple):
    """Constants of a rig, a skeleton and a detector."""

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
    core: Integers  # (num_core,) joints that tell people apart: without fingers and skin
    is_core: Flags  # (num_joints,)
    size: float  # of the skeleton beside a person
    corner_m: Floats  # (2,) of the cells of `Belief.detection_map`
    overlap: Floats  # (num_cameras, num_cameras) share of a camera's view (row) that others see
    wait_s: float  # how long a detection that no track explains waits for a second view
    lenses: Lenses


class Views(NamedTuple):
    """The detections of a slot: as they came, and in rows, ordered by camera."""

    arrived: Flags  # (num_cameras,) of a look
    unchanged: Flags  # (num_cameras,) of no look: the image is that of an earlier one
    pace_px: Floats  # (num_cameras,) how fast people may move in it all the same, px/s
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


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """The belief about people, one row per track.

    Attributes:
        track_ids: `(num_tracks,)` unique within a run, rising.
        state: `(num_tracks, num_joints, 6)` position in metres, velocity in metres per second.
        covariance: `(num_tracks, num_joints, 6, 6)` of `state`.
        shared: `(num_tracks, num_joints, 6, 6)` covariance of each joint's `state` with that of its
            parent in `Model.tree`; 0 at the root.
        unmeasured_s: `(num_tracks, num_joints)` seconds since a joint was measured; inf if never.
        drift_share: `(num_tracks, num_joints)` share of the process noise that is left where a
            predictor foretells the motion (`steer`); 1 where none does.
        existence: `(num_tracks,)` in [0, 1]: recent share of the views that should show the
            person and did.
        hits: `(num_tracks,)` detections so far.
        alone: `(num_tracks,)` looks that showed this track or the one that it overlaps most, since
            one showed both; 0 for those who overlap nobody.
        seen_by: `(num_tracks, num_cameras)` cameras that have shown the person.
        last_seen_s: `(num_tracks, num_cameras)` seconds since each did; inf if never.
        delivered: `(num_tracks, num_cameras)` in [0, 1]: what the recent views of a camera added
            about the person, as a share of what a view with every joint in plain sight would
            (`existence.DELIVERED_PRIOR` before it looked, and again long after).
        missed: `(num_tracks, num_cameras)` looks that missed the person since one did not.
        bias_px: `(num_tracks, num_cameras, num_joints, 2)` how far a view's keypoints of the person
            are off for seconds.
        confirmed: `(num_tracks,)` whether the person is believed to exist, and is shown.
        mirrored: `(num_tracks, 2)` in [0, 1]: recent share of the looks at arms and at legs that
            showed left and right exchanged (`filter.sides`).
        bones_m: `(num_tracks, num_bones)` lengths learned; 0 where none is.
        bone_counts: `(num_tracks, num_bones)` slots that taught them.
        innovations: `(num_tracks, 2)` sums of the last seconds, in metres: how far keypoints were
            from where they were predicted, and how far was expected (`covariance_inflation`).
        agility: `(num_tracks, num_joints)` logarithm of the factor on the process noise that is
            left (`filter.compare`).
        corrected_m: `(num_tracks, num_joints, 3)` by how much the newest look moved each joint.
    """

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


if TYPE_CHECKING:

    class Tracks(Columns):
        """The columns as kernels take them, with room for more tracks."""

        _fields: ClassVar[tuple[str, ...]]

        def __iter__(self) -> Iterator[NDArray[Any]]: ...
        def __len__(self) -> int: ...

else:
    Tracks = namedtuple("Tracks", [item.name for item in fields(Columns)])


class Waiting(NamedTuple):
    """Unexplained detections of this slot and of earlier ones."""

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
    scales: Floats  # (num_cameras,) `Constants.scales` times that factor
    fresh: Floats  # (num_cameras + 1,) keypoints that teach
    steps: Floats  # (num_cameras + 1,) how much they are beyond their median
    sharpness: Floats  # (num_cameras, 2) of the keypoints that teach: sum, number


class Offers(NamedTuple):
    """Workspace for assigning the detections of one view."""

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
    """Workspace for the update of one track; blocks of 6 x 6 are rows of 36 numbers."""

    prior_own: Floats  # (num_joints, 36) information of the prior about each joint
    prior_across: Floats  # (num_joints, 36) about each joint and its parent
    own: Floats  # (num_joints, 36) the same of one pass, and what is made of it
    across: Floats  # (num_joints, 36)
    room: Floats  # (3, 36)
    pull: Floats  # (num_joints, 6)
    moved: Floats  # (num_joints, 6) from the prediction
    places: Floats  # (num_joints, 3)
    seen: Floats  # (num_joints, 18) of keypoints and loose bones: a symmetric 3 x 3, a vector;
    #   the same of velocities
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


class Workspace(NamedTuple):
    """All workspaces, allocated once for a number of tracks, people and leftovers."""

    views: Views
    tracks: Tracks
    waiting: Waiting
    matches: Matches
    detectors: Detectors
    offers: Offers
    passes: Passes
    pairs: Pairs
