"""Goals of a rest plan: known people, newcomers, and the permitted cost of rests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.model.camera import Rig
from e3pose.select.expected_information import Foresight
from e3pose.select.floor import seen_floor, showing, sights
from e3pose.select.policies.base import Situation
from e3pose.select.rest_plan import Needs, risen

# Until how long errors last is learned, nobody rests while people are there.
# tuned: share | simulated and the first half of pizza: a first rest after a third of a second costs
#   7 % on pizza | not measured
LEAST_FILLED = 0.3  # of the memory of the stated error: 3 s
# tuned: nats | simulated `ring`, seeds 702 and 703: 1 finds newcomers so late that recall is 3
#   points less, 3 loses none | not measured
FLOOR_NATS = 3.0  # of all of the floor watched by two cameras
# tuned: people | first guess: not started yet, cameras look as if somebody were there | not
#   measured
NEWCOMERS = 0.3
# tuned: m | simulated, `two-rooms` and `one-sided`, seeds 702, 704, 719, 720, 722: with 2 m and
#   less those who walk through a door are lost, 4 m draws 2 % more | not measured
REACH_M = 3.0  # who is here may be so far away before a camera wakes


def needs_of(rig: Rig, situation: Situation, later: Sequence[Foresight], asleep: Flags) -> Needs:
    """Return the goals of a plan, now and `later`.

    Args:
        rig: the cameras.
        situation: of the slot that is decided.
        later: what cameras would add in some seconds.
        asleep: `(num_cameras,)` who is, and could be awake.

    Raises:
        ValueError: of a situation without a foresight.
    """
    foresight = situation.foresight
    if foresight is None:
        raise ValueError("a plan of rests needs a foresight")
    everybody = situation.online | asleep
    settled = [each.over_seconds() for each in (foresight, *later)]
    sight, near = sights(rig, foresight.outlook.detection_map), _around(rig, foresight)
    likely = np.full(sight.shape[1], 1 / max(sight.shape[1], 1))

    def worth(sets: Flags) -> Floats:
        nats = np.mean([each.information(sets) for each in settled], axis=0)
        nats += foresight.entrants.starts(sets)
        one, two = showing(sight, sets)
        return np.asarray(nats + FLOOR_NATS * 0.5 * (one + two) @ likely)

    def rise(sets: Flags) -> Floats:
        if situation.stated.filled < LEAST_FILLED and foresight.people.confirmed.any():
            return np.full(len(sets), np.inf)
        pairs = np.concatenate([everybody[None], sets])
        errors_m = np.stack([each.expected_error_m(pairs) for each in settled])
        stated_m = situation.stated.mean_m
        return np.asarray(risen(errors_m[:, 1:], errors_m[:, :1], stated_m).max(axis=0))

    def blind(sets: Flags, weights: Floats) -> Floats:
        """Return `(num_sets,)` weighted share of places that all cameras see and these do not."""
        _, two = showing(sight, np.concatenate([everybody[None], sets]))
        found = two @ weights
        return np.asarray(1 - found[1:] / max(float(found[0]), 1e-9))

    return Needs(
        people=len(foresight.people.track_ids),
        worth=worth,
        error_m=foresight.expected_error_m,
        rise=rise,
        strays=lambda sets: blind(sets, near),
        misses=lambda sets: blind(sets, likely),
        newcomers=bool(foresight.entrants.weights.sum() > NEWCOMERS),
    )


def _around(rig: Rig, foresight: Foresight) -> Floats:
    """Return `(num_cells,)` how likely people go to a cell of the floor, up to a factor."""
    cells_m, _ = seen_floor(rig)
    away_m = np.linalg.norm(
        cells_m - foresight.people.joints_m[..., :2].mean(axis=1)[:, None], axis=-1
    )
    return np.asarray(np.exp(-away_m / REACH_M).sum(axis=0))
