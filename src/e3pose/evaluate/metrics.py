"""Accuracy against the truth (docs/reference/metrics.md).

Every function takes poses of one skeleton, slot by slot: `predicted[slot]` is
`(num_persons, num_joints, 3)` and `truth` is `(num_slots, num_actors, num_joints, 3)`, metres, NaN
where missing or not annotated. An actor with no annotated joint in a slot is not there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats, Integers
from e3pose.base.nan_statistics import mean_of_known
from e3pose.evaluate.wrong_limbs import wrong_by_truth

THRESHOLD = 0.5  # of the true limb length
MID_HIP = 14  # an extra joint, the mean of both hips
HEAD_BOTTOM, RIGHT_HIP, LEFT_HIP = 12, 2, 3
# Pairs of Shelf-14 joints, by limb group.
GROUPS: dict[str, tuple[tuple[int, int], ...]] = {
    "head": ((12, 13),),
    "torso": ((MID_HIP, HEAD_BOTTOM),),
    "upper_arms": ((7, 8), (9, 10)),
    "lower_arms": ((6, 7), (10, 11)),
    "upper_legs": ((1, 2), (3, 4)),
    "lower_legs": ((0, 1), (4, 5)),
}
LIMBS = tuple(limb for group in GROUPS.values() for limb in group)
AVERAGED_ACTORS = ("actor1", "actor2", "actor3")


@dataclass(frozen=True, slots=True, eq=False)
class PartCounts:
    """Right and scored limbs, `(num_actors, num_limbs)` each, limbs in the order of `LIMBS`."""

    right: NDArray[np.int64]
    total: NDArray[np.int64]


def count_parts(
    predicted: Sequence[Floats], truth: Floats, skip_missing: bool = False
) -> PartCounts:
    """Count the right limbs of every actor.

    Each labelled actor takes the prediction of smallest mean joint distance, which another actor
    may take too, at any distance. A limb is right if the mean error of its ends is at most half its
    true length; wrong if an end is missing or there is no prediction at all, or not counted with
    `skip_missing`.

    Args:
        predicted: per slot `(num_persons, 14, 3)` Shelf-14 joints in metres, NaN where missing.
        truth: `(num_slots, num_actors, 14, 3)` metres; NaN where not annotated, and a limb with
            such an end is not scored.
        skip_missing: do not count limbs of which an end is not estimated.
    """
    starts, ends = np.array(LIMBS).T
    right = np.zeros((truth.shape[1], len(LIMBS)), dtype=np.int64)
    total = np.zeros_like(right)
    for people, actors in zip(predicted, truth, strict=True):
        wanted = _with_mid_hip(actors)
        length = np.linalg.norm(wanted[:, starts] - wanted[:, ends], axis=-1)
        if len(people) == 0:
            total += np.isfinite(length) & (not skip_missing)
            continue
        nearest = mean_errors_m(people, actors).argmin(axis=0)  # (num_actors,)
        error = np.linalg.norm(_with_mid_hip(people)[nearest] - wanted, axis=-1)
        # Comparisons with NaN are false: a missing end is wrong, an unannotated one not counted.
        mean = (error[:, starts] + error[:, ends]) / 2
        right += mean <= THRESHOLD * length
        total += np.isfinite(mean if skip_missing else length)
    return PartCounts(right, total)


def pcp_percent(counts: PartCounts, actor_ids: Sequence[str]) -> dict[str, float]:
    """Return PCP by actor that has scored limbs, and `average` over actors 1-3 if all three do."""
    return _by_actor(counts.right.sum(axis=1), counts.total.sum(axis=1), actor_ids)


def group_percent(counts: PartCounts, actor_ids: Sequence[str]) -> Mapping[str, dict[str, float]]:
    """Return the same as `pcp_percent` for every limb group."""
    names = np.array([group for group, limbs in GROUPS.items() for _ in limbs])
    tables = {
        group: _by_actor(
            counts.right[:, names == group].sum(axis=1),
            counts.total[:, names == group].sum(axis=1),
            actor_ids,
        )
        for group in GROUPS
    }
    return {group: table for group, table in tables.items() if table}


def _by_actor(
    right: NDArray[np.int64], total: NDArray[np.int64], actor_ids: Sequence[str]
) -> dict[str, float]:
    table = {
        actor: float(100 * good / scored)
        for actor, good, scored in zip(actor_ids, right, total, strict=True)
        if scored > 0
    }
    if set(AVERAGED_ACTORS) <= set(table):
        table["average"] = float(np.mean([table[actor] for actor in AVERAGED_ACTORS]))
    return table


def _with_mid_hip(joints_m: Floats) -> Floats:
    hips = (joints_m[:, RIGHT_HIP] + joints_m[:, LEFT_HIP]) / 2
    return np.concatenate([joints_m, hips[:, None]], axis=1)


MATCH_LIMIT_M = 0.5  # of MPJPE and recall in the Panoptic protocol


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Every prediction beside the truth nearest to it, over all slots, by falling score.

    Attributes:
        errors_m: `(num_predictions,)` mean joint error to that truth; inf if there was none.
        actors: `(num_predictions,)` which labelled actor of which slot, one number; -1 if none.
        coverage: `(num_predictions,)` share of that truth's joints which the prediction has.
        pairs_m: `(num_predictions, 2, num_joints, 3)` the prediction and that truth, NaN where
            missing.
        num_truths: labelled actors over all slots.
    """

    errors_m: Floats
    actors: Integers
    coverage: Floats
    pairs_m: Floats
    num_truths: int


def mean_errors_m(predicted: Floats, truth: Floats) -> Floats:
    """Return `(num_persons, num_actors)` mean distances over the joints both have; inf if none.

    Args:
        predicted: `(num_persons, num_joints, 3)` metres.
        truth: `(num_actors, num_joints, 3)` metres.
    """
    distances = np.linalg.norm(predicted[:, None] - truth[None], axis=-1)
    return mean_of_known(distances, lacking=np.inf)


def candidates(predicted: Sequence[Floats], scores: Sequence[Floats], truth: Floats) -> Candidates:
    """Give each prediction the truth of smallest mean error, as the Panoptic protocol does.

    Not one to one: two predictions may take the same truth. Ties in score keep the order of slots
    and people.

    Args:
        predicted: per slot `(num_persons, num_joints, 3)` metres.
        scores: per slot `(num_persons,)` confidence in the person.
        truth: `(num_slots, num_actors, num_joints, 3)` metres.
    """
    if truth.shape[1] == 0:  # a scene without actors is one with an actor that is never there
        truth = np.full((len(truth), 1, *truth.shape[2:]), np.nan)
    annotated: NDArray[np.bool_] = np.asarray(np.isfinite(truth).all(axis=-1))
    labelled = annotated.any(axis=-1)
    number = np.cumsum(labelled.ravel()).reshape(labelled.shape) - 1
    errors: list[float] = []
    actors: list[int] = []
    coverage: list[float] = []
    pairs_m: list[Floats] = [np.zeros((0, 2, *truth.shape[2:]))]
    for people, actors_m, wanted, numbers in zip(predicted, truth, annotated, number, strict=True):
        distance = mean_errors_m(people, actors_m)
        for person, nearest in enumerate(distance.argmin(axis=1)):
            error = float(distance[person, nearest])
            matched = error < np.inf
            has = np.isfinite(people[person]).all(axis=-1) & wanted[nearest]
            errors.append(error)
            actors.append(int(numbers[nearest]) if matched else -1)
            pairs_m.append(np.stack([people[person], actors_m[nearest]])[None])
            coverage.append(float(has.sum() / wanted[nearest].sum()) if matched else 0.0)
    order = np.argsort(-np.concatenate([*scores, np.zeros(0)]), kind="stable")
    return Candidates(
        np.array(errors, dtype=np.float64)[order],
        np.array(actors, dtype=np.int64)[order],
        np.array(coverage, dtype=np.float64)[order],
        np.concatenate(pairs_m)[order],
        int(labelled.sum()),
    )


def first_matches(found: Candidates, limit_m: float) -> NDArray[np.bool_]:
    """Return `(num_predictions,)`: error below `limit_m` and first by score to take its truth."""
    good = found.errors_m < limit_m
    taken: set[int] = set()
    first = np.zeros(len(good), dtype=bool)
    for index in np.flatnonzero(good):
        actor = int(found.actors[index])
        first[index] = actor not in taken
        taken.add(actor)
    return first


def average_precision(found: Candidates, limit_m: float) -> float | None:
    """Return AP in percent at an error below `limit_m`, or None if there is no truth.

    The precision envelope summed over recall steps. Meaningful only where everybody is annotated.
    """
    if found.num_truths == 0:
        return None
    right = first_matches(found, limit_m)
    if not right.any():
        return 0.0
    recall = np.cumsum(right) / found.num_truths
    precision = np.cumsum(right) / np.arange(1, len(right) + 1)
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float(100 * (np.diff(recall, prepend=0.0) * envelope).sum())


def poses_within(found: Candidates, limit_m: float) -> float | None:
    """Return the percentage of predictions with an error below `limit_m`; None without any.

    What the E3Pose paper calls AP_K: "the percentage of estimated 3D poses whose MPJPE is smaller
    than K". A person who is not found costs nothing. Meaningful only where everybody is annotated.
    """
    if len(found.errors_m) == 0 or found.num_truths == 0:
        return None
    return float(100 * (found.errors_m < limit_m).mean())


def mpjpe_mm(found: Candidates) -> float | None:
    """Return the mean error in mm of first matches below 500 mm, or None if there is none."""
    first = first_matches(found, MATCH_LIMIT_M)
    return float(1000 * found.errors_m[first].mean()) if first.any() else None


def joint_quantile_mm(found: Candidates, share: float) -> float | None:
    """Return the error in mm that so many joints of first matches stay below, or None without any.

    Args:
        found: from `candidates`.
        share: of the joints, [0, 1].
    """
    joints_m, true_m = _matched(found)
    errors_m = np.linalg.norm(joints_m - true_m, axis=-1)
    known = errors_m[np.isfinite(errors_m)]
    return float(1000 * np.quantile(known, share)) if len(known) else None


def wrong_limbs(found: Candidates, names: Sequence[str]) -> Floats:
    """Return `(num_matches, num_joints)` of `wrong_by_truth`, of first matches.

    Args:
        found: from `candidates`.
        names: of the joints.
    """
    joints_m, true_m = _matched(found)
    return wrong_by_truth(joints_m, true_m, names)


def _matched(found: Candidates) -> Floats:
    """Return `(2, num_matches, num_joints, 3)` joints of first matches below 500 mm, and truth."""
    return np.asarray(found.pairs_m[first_matches(found, MATCH_LIMIT_M)].swapaxes(0, 1))


def recall_500mm(found: Candidates) -> float | None:
    """Return the share of labelled actors found within 500 mm, [0, 1], or None without truth."""
    if found.num_truths == 0:
        return None
    return float(first_matches(found, MATCH_LIMIT_M).sum() / found.num_truths)


def precision_500mm(found: Candidates) -> float | None:
    """Return the share of predictions that are first matches within 500 mm, or None without any.

    Meaningful only where everybody is annotated.
    """
    if len(found.errors_m) == 0 or found.num_truths == 0:
        return None
    return float(first_matches(found, MATCH_LIMIT_M).mean())


def joint_coverage(found: Candidates) -> float | None:
    """Return the share of matched actors' joints that were estimated, or None without a match.

    MPJPE averages over estimated joints only; this says how many those are.
    """
    first = first_matches(found, MATCH_LIMIT_M)
    return float(found.coverage[first].mean()) if first.any() else None


def id_switches(
    predicted: Sequence[Floats], track_ids: Sequence[Integers], truth: Floats
) -> int | None:
    """Count how often the track that follows an actor changes, or return None without truth.

    In each slot actors and predictions are paired one to one, at the smallest total of mean errors
    below 500 mm. An actor that is lost and found again under another id counts once.

    Args:
        predicted: per slot `(num_persons, num_joints, 3)` metres.
        track_ids: per slot `(num_persons,)`.
        truth: `(num_slots, num_actors, num_joints, 3)` metres.
    """
    from scipy.optimize import linear_sum_assignment

    if not np.isfinite(truth).all(axis=-1).any():
        return None
    known: dict[int, int] = {}
    switches = 0
    for people, ids, actors in zip(predicted, track_ids, truth, strict=True):
        gain = np.maximum(MATCH_LIMIT_M - mean_errors_m(people, actors), 0.0)
        for person, actor in zip(*linear_sum_assignment(gain, maximize=True), strict=True):
            if gain[person, actor] > 0:
                track = int(ids[person])
                switches += known.get(int(actor), track) != track
                known[int(actor)] = track
    return switches


def acceleration_error_mps2(
    predicted: Sequence[Floats], track_ids: Sequence[Integers], truth: Floats, interval_s: float
) -> float | None:
    """Return how far accelerations are from the true ones, or None without three slots in a row.

    The mean length of the difference of second differences, over all joints of tracks that stay
    with one actor, within 500 mm, for three slots. Rough estimates of an accurate mean show here.

    Args:
        predicted: per slot `(num_persons, num_joints, 3)` metres.
        track_ids: per slot `(num_persons,)`.
        truth: `(num_slots, num_actors, num_joints, 3)` metres.
        interval_s: seconds per slot.
    """
    total, count = 0.0, 0
    recent: list[dict[tuple[int, int], Floats]] = []  # by track and actor, of the last two slots
    for people, ids, actors in zip(predicted, track_ids, truth, strict=True):
        distance = mean_errors_m(people, actors)
        errors = {}
        for person in range(len(people)) if len(actors) else ():
            actor = int(distance[person].argmin())
            if distance[person, actor] < MATCH_LIMIT_M:
                errors[int(ids[person]), actor] = people[person] - actors[actor]
        if len(recent) == 2:
            for pair in errors.keys() & recent[0].keys() & recent[1].keys():
                bend = recent[0][pair] - 2 * recent[1][pair] + errors[pair]
                length = np.linalg.norm(bend, axis=-1) / interval_s**2
                known = np.isfinite(length)
                total, count = total + float(length[known].sum()), count + int(known.sum())
        recent = [*recent, errors][-2:]
    return total / count if count else None
