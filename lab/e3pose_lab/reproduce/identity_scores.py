"""Identity metrics: IDF1 by motmetrics, HOTA by its definition, changes by cause."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from e3pose.base.arrays import Floats, Integers
from e3pose.model.slot_record import SlotRecord
from e3pose.recording import Recording
from e3pose_lab.reproduce.replays import Asked, recording_of, records_of
from e3pose_lab.reproduce.sources import Sources

ALPHAS = np.arange(0.05, 0.99, 0.05)  # similarities from which a pair counts as found


FOUND_M = 0.5
KINDS = RETURNED, SWAPPED, LOST = "returned", "swapped", "lost"


def changes(recording: Recording, records: Sequence[SlotRecord]) -> Counter[str]:
    """Return how many changes of identity there are of each kind."""
    assert recording.truth is not None, "identities need a truth"
    found: Counter[str] = Counter()
    last: dict[int, int] = {}  # which number a person was shown with
    seen: dict[int, int] = {}  # in which slot
    away: dict[int, int] = {}  # in which slot a person was last not there
    owner: dict[int, int] = {}  # who was last shown with a number
    for slot, record in enumerate(records):
        truth = recording.truth.joints_m[slot]
        there = np.isfinite(truth).all(axis=(1, 2))
        away.update(dict.fromkeys(np.flatnonzero(~there).tolist(), slot))
        people = np.flatnonzero(there)
        apart = np.linalg.norm(record.people.joints_m[:, None] - truth[people][None], axis=-1)
        if apart.size == 0:
            continue
        apart = np.nanmean(apart, axis=-1)
        rows, columns = linear_sum_assignment(np.minimum(apart, 2.0))
        near = apart[rows, columns] < FOUND_M
        for row, column in zip(rows[near], columns[near], strict=True):
            who, number = int(people[column]), int(record.people.track_ids[row])
            if last.get(who, number) != number:
                if away.get(who, -1) >= seen[who]:
                    found[RETURNED] += 1
                else:
                    found[SWAPPED if owner.get(number, who) != who else LOST] += 1
            last[who], seen[who], owner[number] = number, slot, who
    return found


@dataclass(frozen=True, slots=True)
class IdentitiesAsked:
    """Which replay."""

    replay: Asked


@dataclass(frozen=True, slots=True)
class IdentityFigures:
    """Scores in [0, 1], and how often a person's number changed, by kind."""

    idf1: float
    hota: float
    returned: int
    swapped: int
    lost: int


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """People of one slot.

    Attributes:
        actors: `(num_actors,)` numbers of the people who are there.
        tracks: `(num_tracks,)` numbers of those who are shown.
        similarity: `(num_actors, num_tracks)` 1 at the same place, 0 from `FOUND_M` on.
    """

    actors: Integers
    tracks: Integers
    similarity: Floats


def identity_figures(sources: Sources, asked: IdentitiesAsked) -> IdentityFigures:
    """Replay and score the identities."""
    recording = recording_of(sources, asked.replay)
    records = records_of(recording, asked.replay)
    frames = frames_of(recording, records)
    kinds = changes(recording, records)
    return IdentityFigures(idf1(frames), hota(frames), kinds[RETURNED], kinds[SWAPPED], kinds[LOST])


def frames_of(recording: Recording, records: Sequence[SlotRecord]) -> list[Frame]:
    """Return the true and the shown people of each slot."""
    truth = recording.truth
    assert truth is not None, "identities need a truth"
    frames = []
    for slot, record in enumerate(records):
        there = np.flatnonzero(np.isfinite(truth.joints_m[slot]).all(axis=(1, 2)))
        joints = record.people.joints_m
        apart = np.linalg.norm(joints[None] - truth.joints_m[slot, there][:, None], axis=-1)
        known = np.isfinite(apart)
        mean = np.where(known, apart, 0.0).sum(axis=-1) / np.maximum(known.sum(axis=-1), 1)
        mean = np.where(known.any(axis=-1), mean, np.inf)
        similarity = np.maximum(1 - mean / FOUND_M, 0.0)
        frames.append(Frame(there, np.asarray(record.people.track_ids, dtype=np.int64), similarity))
    return frames


def idf1(frames: Sequence[Frame]) -> float:
    """Return IDF1 (Ristani et al. 2016), by motmetrics; pairs may be up to `FOUND_M` apart."""
    import motmetrics

    kept = motmetrics.MOTAccumulator(auto_id=True)
    for frame in frames:
        apart = np.where(frame.similarity > 0, 1 - frame.similarity, np.nan)
        kept.update(frame.actors.tolist(), frame.tracks.tolist(), apart)
    found = motmetrics.metrics.create().compute(
        kept, metrics=["idf1"], return_dataframe=False, return_cached=False
    )
    return float(found["idf1"])


def hota(frames: Sequence[Frame]) -> float:
    """Return HOTA (Luiten et al. 2021, eqs. (6) to (8)): mean over `ALPHAS` of sqrt(DetA AssA).

    Pairs of a slot are chosen by how well their tracks fit over all slots, times their similarity.
    """
    actors = 1 + max((int(f.actors.max(initial=-1)) for f in frames), default=-1)
    names = np.unique(np.concatenate([np.zeros(0, np.int64), *(f.tracks for f in frames)]))
    if actors == 0 or len(names) == 0:
        return 0.0
    fits = np.zeros((actors, len(names)))
    actor_slots, track_slots = np.zeros(actors), np.zeros(len(names))
    placed = [np.searchsorted(names, frame.tracks) for frame in frames]
    for frame, tracks in zip(frames, placed, strict=True):
        s = frame.similarity
        union = s.sum(axis=0)[None] + s.sum(axis=1)[:, None] - s
        fits[np.ix_(frame.actors, tracks)] += s / np.where(union > 0, union, 1.0)
        actor_slots[frame.actors] += 1
        track_slots[tracks] += 1
    aligned = fits / (actor_slots[:, None] + track_slots[None] - fits)
    matches = np.zeros((len(ALPHAS), actors, len(names)))
    for frame, tracks in zip(frames, placed, strict=True):
        score = aligned[np.ix_(frame.actors, tracks)] * frame.similarity
        rows, columns = linear_sum_assignment(score, maximize=True)
        similar = frame.similarity[rows, columns] >= ALPHAS[:, None] - np.finfo(float).eps
        matches[:, frame.actors[rows], tracks[columns]] += similar
    right = matches.sum(axis=(1, 2))
    detection = right / (actor_slots.sum() + track_slots.sum() - right)
    either = actor_slots[:, None] + track_slots[None] - matches
    association = (matches * matches / np.maximum(either, 1)).sum(axis=(1, 2))
    association = association / np.maximum(right, 1)
    return float(np.sqrt(detection * association).mean())
