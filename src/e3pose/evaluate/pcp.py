"""PCP, the percentage of correct parts of the Shelf data set (docs/reference/metrics.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.evaluate.metrics import mean_errors_m

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
