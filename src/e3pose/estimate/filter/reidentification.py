"""Re-identification: identities that outlast a track.

A track that ends leaves behind what tells its person from others: the lengths of the bones and the
place. A newcomer is compared with everybody who left within minutes, and takes an identity over
when the odds are clearly in favour:

    odds = prior * p(lengths | same) / p(lengths | others) * p(place | same) / p(place | others)

The logarithm of a length differs between two tracks of one person by the error of measuring alone;
between two people also by their stature, which all bones share, and by their proportions. Soon
after somebody was lost the place tells most: people are lost behind others and found again near by.
Later it only limits what can be walked; who left by one door may come in by another.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.estimate.filter.proportions import BONE_TEACHERS
from e3pose.estimate.filter.state import APART_M, Belief, Model
from e3pose.model.proportions import KINDS, NOISE_M, SLIDE_M, size_of

DEPARTED_S = 300.0  # timeout: then who left is forgotten
MAX_DEPARTED = 32  # capacity: the newest; among many somebody always looks like a stranger
DECIDE_S = 4.0  # timeout: who was not recognised so long after being shown is somebody new
# tuned: odds | not recorded | half and twice
PRIOR_ODDS = 0.5  # that a newcomer is one who left, against a stranger, before comparing
# tuned: odds, s | not recorded | half and twice
SOON_ODDS, SOON_S = 10.0, 2.0  # on top of that for who was lost just now, which fades
# tuned: odds | lab/experiments/2026-11-21-who-comes-back.md | half and twice
SURE_ODDS = 40.0  # takes an identity over: of 41 such cases one would be wrong

STATURE_SPREAD = 0.055  # physical: of adults: 9.5 cm of 1.72 m
# tuned: share | not recorded | half and twice
PROPORTION_SPREAD = 0.03  # of the bones of people of one stature
MIN_LENGTH_M = 0.05  # numerics
NEVER = -1e3  # numerics: a logarithm of odds

FASTEST_MPS, LEEWAY_M = 2.5, 1.0  # physical: nobody comes back from farther than can be walked
# tuned: m, m/s | not recorded | half and twice
STRAY_M, STRAY_MPS = 0.3, 0.7  # how far from where they were lost people are found again
# tuned: m2 | not recorded | half and twice
ROOM_M2 = 30.0  # the floor on which strangers may appear
# tuned: s | not recorded | half and twice
OVERLAP_S = 0.2  # a track may take a last look when its person has a new one


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """Published or ended tracks, and their shown identities.

    Attributes:
        tracks: `(num_tracks,)` ids of the filter's tracks.
        track_ids: `(num_tracks,)` the identities they are shown with.
        shown_s: `(num_tracks,)` when they were first shown; of those that ended, when a view last
            showed them.
        place_m: `(num_tracks, 2)` where that was, on the floor.
        lengths_m: `(num_tracks, num_kinds)` of bones, learned by earlier tracks of the person; of
            those that ended, by themselves as well.
        taught: `(num_tracks, num_kinds)` slots that taught those.
    """

    tracks: Integers
    track_ids: Integers
    shown_s: Floats
    place_m: Floats
    lengths_m: Floats
    taught: Floats

    def __getitem__(self, rows: Integers | Flags) -> Tracked:
        """Return some of them, by their numbers or flags."""
        return Tracked(*(getattr(self, item.name)[rows] for item in fields(self)))

    def __add__(self, more: Tracked) -> Tracked:
        """Return these and more."""
        pairs = ((getattr(self, item.name), getattr(more, item.name)) for item in fields(self))
        return Tracked(*map(np.concatenate, pairs))


@dataclass(frozen=True, slots=True, eq=False)
class Identities:
    """Present and past identities, the latter oldest first; a value, never changed in place."""

    present: Tracked
    departed: Tracked

    @classmethod
    def none(cls, model: Model) -> Identities:
        """Return the identities before the first slot."""
        ids, times, places = np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 2))
        kinds = np.zeros((0, _kinds(model).shape[1]))
        nobody = Tracked(ids, ids, times, places, kinds, kinds)
        return cls(nobody, nobody)

    def of(self, tracks: Integers) -> Integers:
        """Return the identities `(num_tracks,)` that tracks are shown with, else their own ids."""
        present = self.present
        names = dict(zip(present.tracks.tolist(), present.track_ids.tolist(), strict=True))
        found = [names.get(track, track) for track in tracks.tolist()]
        return np.array(found, dtype=np.int64)


def identify(
    identities: Identities, before: Belief, belief: Belief, shown: Integers, model: Model
) -> Identities:
    """Advance by one slot.

    Args:
        identities: of the slot before; they are not changed.
        before: the belief of the slot before.
        belief: of this slot.
        shown: `(num_shown,)` ids of the tracks that this slot shows, rising.
        model: the skeleton.

    Returns:
        The identities now: unique in the slot, and the same as before for every track but those
        that were recognised in this slot, within `DECIDE_S` of being shown first.
    """
    present, departed = identities.present, identities.departed
    if gone := _not_among(belief.track_ids, present.tracks):
        departed += _left(present[np.array(gone)], before, belief, model)
        present = present[np.delete(np.arange(len(present.tracks)), gone)]
    if new := _not_among(present.tracks, shown):
        present += _shown(shown[new], belief, model)
        present = present[np.argsort(present.tracks)]
    if len(departed.track_ids):
        fresh = departed.shown_s > belief.time_s - DEPARTED_S
        if len(fresh) > MAX_DEPARTED or not fresh.all():
            departed = departed[np.flatnonzero(fresh)[-MAX_DEPARTED:]]
    if len(departed.track_ids):
        undecided = present.shown_s > belief.time_s - DECIDE_S
        (rows,) = (undecided & (present.tracks == present.track_ids)).nonzero()
        if len(rows):
            present, departed = _recognise(present, departed, rows, belief, model)
    return Identities(present, departed)


def _recognise(
    present: Tracked, departed: Tracked, rows: Integers, belief: Belief, model: Model
) -> tuple[Tracked, Tracked]:
    """Give the tracks at `rows` their past identities where these are clear."""
    lengths, taught = _lengths(belief, present.tracks[rows], model)
    gap_s = present.shown_s[rows, None] - departed.shown_s
    telling = place_odds(
        gap_s,
        np.linalg.norm(present.place_m[rows, None] - departed.place_m, axis=-1),
    ) + length_odds(lengths[:, None], taught[:, None], departed.lengths_m, departed.taught)
    prior = PRIOR_ODDS + SOON_ODDS * np.exp(-np.maximum(gap_s, 0.0) / SOON_S)
    odds = prior * np.exp(np.clip(telling, NEVER, 100.0))
    # Against being a stranger, or another one who left; and against another newcomer being this.
    rivals = 1 + np.maximum(odds.sum(axis=1, keepdims=True), odds.sum(axis=0)) - odds
    sure = odds / rivals
    track_ids, kept = present.track_ids.copy(), np.ones(len(departed.track_ids), dtype=bool)
    old_lengths, old_taught = present.lengths_m.copy(), present.taught.copy()
    for row, who in zip(*np.nonzero(sure > SURE_ODDS), strict=True):
        here = rows[row]
        track_ids[here], kept[who] = departed.track_ids[who], False
        old_lengths[here], old_taught[here] = departed.lengths_m[who], departed.taught[who]
    present = replace(present, track_ids=track_ids, lengths_m=old_lengths, taught=old_taught)
    return present, departed[kept]


def place_odds(gap_s: Floats, apart_m: Floats) -> Floats:
    """Return log-odds of a place: a lost person against a new one.

    Args:
        gap_s: `(*batch)` between the last look and being shown again.
        apart_m: `(*batch)` between the two places.
    """
    elapsed = np.maximum(gap_s, 0.0)
    stray = (STRAY_M + STRAY_MPS * elapsed) ** 2
    near = np.log(ROOM_M2 / (2 * np.pi * stray)) - apart_m**2 / (2 * stray)
    possible = (gap_s > -OVERLAP_S) & (apart_m < LEEWAY_M + FASTEST_MPS * elapsed)
    return np.where(possible, np.maximum(near, 0.0), NEVER)


def length_odds(
    lengths_m: Floats, taught: Floats, others_m: Floats, others_taught: Floats
) -> Floats:
    """Return log-odds of bone lengths: the same person against two.

    Args:
        lengths_m: `(*batch, num_kinds)` of bones, metres.
        taught: `(*batch, num_kinds)` slots that taught them.
        others_m: `(*batch, num_kinds)` to compare with.
        others_taught: `(*batch, num_kinds)`.

    Returns:
        `(*batch)`; 0 where nothing can be compared. Lengths are normal in their logarithm.
    """
    known = (np.minimum(taught, others_taught) >= BONE_TEACHERS) & (
        np.minimum(lengths_m, others_m) > MIN_LENGTH_M
    )
    a, b = np.where(known, lengths_m, 1.0), np.where(known, others_m, 1.0)
    off = np.log(a / b)
    errors = [
        (SLIDE_M**2 + NOISE_M**2 / np.maximum(n, 1.0)) / length**2
        for n, length in ((taught, a), (others_taught, b))
    ]
    same = errors[0] + errors[1]
    # Two people: the same, and twice the spread between people; stature is shared by all bones, so
    # that its inverse and determinant follow from those of the diagonal (Sherman and Morrison).
    other = same + 2 * PROPORTION_SPREAD**2
    weight = np.where(known, 1 / other, 0.0)
    shared = 1 + 2 * STATURE_SPREAD**2 * weight.sum(axis=-1)
    pull = (weight * off).sum(axis=-1)
    distance = (off**2 * weight).sum(axis=-1) - 2 * STATURE_SPREAD**2 * pull**2 / shared
    widths = np.where(known, np.log(other / same), 0.0).sum(axis=-1) + np.log(shared)
    return np.asarray((distance + widths - np.where(known, off**2 / same, 0.0).sum(axis=-1)) / 2)


def _left(gone: Tracked, before: Belief, belief: Belief, model: Model) -> Tracked:
    """Return ended tracks, without duplicates of people still present."""
    rows = np.searchsorted(before.track_ids, gone.tracks)
    place = before.state[rows, :, :2].mean(axis=1)
    lengths, taught = _lengths(before, gone.tracks, model)
    total = taught + gone.taught
    pooled = (lengths * taught + gone.lengths_m * gone.taught) / np.maximum(total, 1.0)
    seen_s = before.time_s - before.last_seen_s[rows].min(axis=-1)
    left = Tracked(gone.tracks, gone.track_ids, seen_s, place, pooled, total)
    others = belief.state[belief.confirmed, :, :2].mean(axis=1)
    beside = np.linalg.norm(place[:, None] - others, axis=-1).min(axis=-1, initial=np.inf)
    apart_m = APART_M * size_of(model.skeleton)
    return left[beside >= apart_m]  # else it was a second track of that person


def _shown(tracks: Integers, belief: Belief, model: Model) -> Tracked:
    rows = np.searchsorted(belief.track_ids, tracks)
    place = belief.state[rows, :, :2].mean(axis=1)
    nothing = np.zeros((len(tracks), _kinds(model).shape[1]))
    return Tracked(tracks, tracks, np.full(len(tracks), belief.time_s), place, nothing, nothing)


def _lengths(belief: Belief, tracks: Integers, model: Model) -> tuple[Floats, Floats]:
    """Return `(num_tracks, num_kinds)` lengths and the slots that taught them, left with right."""
    rows, kinds = np.searchsorted(belief.track_ids, tracks), _kinds(model)
    counts = belief.bone_counts[rows]
    total = counts @ kinds
    lengths = (belief.bones_m[rows] * counts) @ kinds / np.maximum(total, 1.0)
    return lengths, total / np.maximum(kinds.sum(axis=0), 1.0)


@lru_cache(maxsize=64)
def _kinds(model: Model) -> Floats:
    """Return `(num_bones, num_kinds)`: 1 where a bone is of a kind, which both sides share.

    One kind, without bones, where there are none.
    """
    of_kind = model.proportions.kinds[:, None] == np.arange(len(KINDS))
    found = of_kind.any(axis=0)
    return np.where(of_kind[:, found if found.any() else [0]], 1.0, 0.0)


def _not_among(known: Integers, tracks: Integers) -> list[int]:
    """Return the rows of unknown ids `(num_tracks,)`."""
    ids = set(known.tolist())
    return [row for row, track in enumerate(tracks.tolist()) if track not in ids]
