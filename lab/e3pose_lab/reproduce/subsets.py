"""Oracle: the accuracy of all subsets of cameras, slot by slot.

Only the evaluation may know this: it reads the truth and the views of all cameras.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from e3pose.estimate.per_slot.fuse import Fuser
from e3pose.evaluate import metrics
from e3pose.evaluate.metrics import AVERAGED_ACTORS, count_parts
from e3pose.evaluate.replay import selected_views
from e3pose.model.skeleton import convert
from e3pose.settings.parts import PAPER_FUSION
from e3pose_lab.reproduce.replays import Asked, recording_of, seen_occlusion
from e3pose_lab.reproduce.sources import Sources


@dataclass(frozen=True, slots=True)
class SubsetsAsked:
    """Which slots.

    Attributes:
        recording: of `replays.Asked`.
        first: slot.
        stop: the slot after the last.
        stride: slots from one to the next.
        seconds: length of what is simulated.
        seed: of what is simulated.
    """

    recording: str
    first: int
    stop: int
    stride: int = 1
    seconds: float = 0.0
    seed: int = 0


@dataclass(frozen=True, slots=True)
class SubsetFigures:
    """Every subset of every slot.

    Attributes:
        subsets: cameras of each subset.
        slots: which slots.
        right: right parts, by slot, subset, actor; actors 1-3 of Shelf, none without PCP.
        total: scored parts, by slot and actor.
        error_m: by slot and subset, summed over matched actors, metres.
        matched: by slot and subset, how many actors have a prediction within 500 mm.
        actors: by slot, how many are labelled.
        occlusion: by slot and subset, eq. (4) summed over its cameras.
    """

    subsets: list[list[int]]
    slots: list[int]
    right: list[list[list[int]]]
    total: list[list[int]]
    error_m: list[list[float]]
    matched: list[list[int]]
    actors: list[int]
    occlusion: list[list[float]]


def subset_figures(sources: Sources, asked: SubsetsAsked) -> SubsetFigures:
    """Fuse every subset of the cameras in some slots, each slot on its own."""
    place = Asked(asked.recording, "all", seconds=asked.seconds, seed=asked.seed)
    recording = recording_of(sources, place)
    truth = recording.truth
    assert truth is not None, "labelled recordings only"
    fuser = Fuser(recording.rig, len(recording.skeleton), PAPER_FUSION)
    count = len(recording.rig)
    subsets = [list(c) for size in range(1, count + 1) for c in combinations(range(count), size)]
    hidden = seen_occlusion(recording)
    counted = [i for i, name in enumerate(truth.person_ids) if name in AVERAGED_ACTORS]
    found = SubsetFigures(subsets, [], [], [], [], [], [], [])
    for slot in range(asked.first, min(asked.stop, recording.num_slots), asked.stride):
        wanted = truth.joints_m[slot]
        labelled = np.isfinite(wanted).any(axis=(1, 2))
        if not labelled.any():
            continue
        rights, errors, matches = [], [], []
        totals = np.zeros(0, dtype=np.int64)
        for subset in subsets:
            chosen = np.isin(np.arange(count), subset)
            poses = fuser.fuse(selected_views(recording, slot, chosen)).people
            joints, _ = convert(poses.joints_m, poses.scores, recording.skeleton, truth.skeleton)
            if counted:
                parts = count_parts([joints], wanted[None, counted])
                rights.append(parts.right.sum(axis=1).tolist())
                totals = parts.total.sum(axis=1)
            apart = np.full(len(wanted), np.inf)
            if len(joints):
                apart = metrics.mean_errors_m(joints, wanted).min(axis=0)
            near = labelled & (apart < metrics.MATCH_LIMIT_M)
            errors.append(float(apart[near].sum()))
            matches.append(int(near.sum()))
        found.slots.append(slot)
        found.right.append(rights)
        found.total.append(totals.tolist())
        found.error_m.append(errors)
        found.matched.append(matches)
        found.actors.append(int(labelled.sum()))
        found.occlusion.append([float(hidden[slot, subset].sum()) for subset in subsets])
    return found


def joined(parts: list[SubsetFigures]) -> SubsetFigures:
    """Return the figures of consecutive slots as one."""
    lists = {
        name: [value for part in parts for value in getattr(part, name)]
        for name in ("slots", "right", "total", "error_m", "matched", "actors", "occlusion")
    }
    return SubsetFigures(subsets=parts[0].subsets, **lists)
