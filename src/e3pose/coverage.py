"""What each camera shows of people at each place of the floor, learned while the system runs.

A rig's geometry says which places lie inside an image, but not what stands between: walls, shelves,
a curtain, dirt on a lens. Whether a camera's views told what they should have of somebody who was
there - who stood in plain sight of others at that time - is counted per camera and place, and kept
longer than any track: somebody new, or somebody who comes round a corner, is not expected of a
camera that showed nobody there before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from e3pose.camera import Rig
from e3pose.filter.existence import DELIVERED_LASTS_S, DELIVERED_PRIOR, DELIVERED_RATE
from e3pose.filter.outlook import Outlook

Floats = NDArray[np.float64]

CELL_M = 0.75  # people's own size, and the reach of a door
NUM_CELLS = 40  # along each side of the square around the cameras
PRIOR_VIEWS = 2.0  # that the prior counts for
MOST_VIEWS = 60.0  # per place that are remembered, a few seconds of somebody: things get moved
# A view in plain sight knows a joint to about 2 cm, an unseen one may be off by 20 cm: a view adds
# 100 times the information there was. Simulated: 100 against an unchanged share takes the mean
# error in `one-sided`, misses counted, from 216 to 151 mm and leaves other scenes as they are.
INFORMATION_RATIO = 100.0
KNOWN_S = 0.5  # people whom no camera showed for so long may be gone: misses say nothing then


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """What every camera showed at every place so far.

    Attributes:
        corner_m: `(2,)` of the first cell.
        told: `(num_cameras, NUM_CELLS, NUM_CELLS)` shares of what plain sight tells, summed.
        views: `(num_cameras, NUM_CELLS, NUM_CELLS)` how many views that sums up.
        track_ids: `(num_tracks,)` people of the newest slot.
        delivered: `(num_tracks, num_cameras)` what was remembered of their views then.
    """

    corner_m: Floats
    told: Floats
    views: Floats
    track_ids: NDArray[np.int64]
    delivered: Floats

    @classmethod
    def none(cls, rig: Rig) -> Coverage:
        """Return the state before the first slot: nothing is known."""
        middle = rig.centers_m[:, :2].mean(axis=0)
        empty = np.zeros((len(rig), NUM_CELLS, NUM_CELLS))
        return cls(
            middle - NUM_CELLS * CELL_M / 2,
            empty,
            empty,
            np.zeros(0, dtype=np.int64),
            np.zeros((0, len(rig))),
        )

    def share(self, places_m: Floats) -> Floats:
        """Return `(num_places, num_cameras)` of plain sight that cameras showed at `(*, 2)`."""
        cells, weights = _around(places_m - self.corner_m)
        x, y = cells[..., 0], cells[..., 1]
        told = (self.told[:, x, y] * weights).sum(axis=-1)
        views = (self.views[:, x, y] * weights).sum(axis=-1)
        return np.asarray(((told + PRIOR_VIEWS * DELIVERED_PRIOR) / (views + PRIOR_VIEWS)).T)


def learn(coverage: Coverage, now: Outlook, interval_s: float) -> Coverage:
    """Count what the views of a slot told about everybody.

    Args:
        coverage: until the slot before.
        now: of the newest slot, after its views.
        interval_s: seconds a slot.
    """
    _, new, old = np.intersect1d(now.track_ids, coverage.track_ids, return_indices=True)
    faded = np.exp(-interval_s / DELIVERED_LASTS_S)
    before = DELIVERED_PRIOR + faded * (coverage.delivered[old] - DELIVERED_PRIOR)
    change = now.delivered[new] - before
    known = now.last_seen_s[new].min(axis=1, initial=np.inf) < KNOWN_S
    looked = (np.abs(change) > 1e-9) & known[:, None]  # without a view there is only fading
    told = np.clip(before + change / DELIVERED_RATE, 0.0, 1.0)
    cells, weights = _around(_places(now)[new] - coverage.corner_m)
    sums, views = coverage.told.copy(), coverage.views.copy()
    people, cameras = np.nonzero(looked)
    where = (cameras[:, None], cells[people, :, 0], cells[people, :, 1])
    np.add.at(sums, where, weights[people] * told[people, cameras][:, None])
    np.add.at(views, where, weights[people])
    kept = np.minimum(MOST_VIEWS / np.maximum(views[where], 1e-12), 1.0)
    sums[where], views[where] = sums[where] * kept, views[where] * kept
    return Coverage(coverage.corner_m, sums, views, now.track_ids, now.delivered)


def with_coverage(outlook: Outlook, coverage: Coverage) -> Outlook:
    """Expect less of cameras that showed less than usual where people will be.

    A camera that shows somebody with probability p and otherwise nothing is worth p log(1 + W) nats
    where one that always shows W times what is known is worth log(1 + W): as much as one that
    always shows ((1 + W)^p - 1) / W of that.
    """
    share = coverage.share(_places(outlook))
    usual = np.minimum(share / DELIVERED_PRIOR, 1.0)
    worth = ((1 + INFORMATION_RATIO) ** usual - 1) / INFORMATION_RATIO
    return replace(outlook, delivered=outlook.delivered * worth)


def _places(outlook: Outlook) -> Floats:
    """Return `(num_tracks, 2)`: where on the floor everybody is."""
    return np.asarray(np.median(outlook.joints_m[..., :2], axis=1))


def _around(offset_m: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the four cells `(num_places, 4, 2)` nearest to each place, and their weights."""
    position = np.clip(offset_m / CELL_M - 0.5, 0.0, NUM_CELLS - 1.001)
    low = np.floor(position).astype(np.int64)
    part = position - low
    corners = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    weights = np.where(corners, part[:, None], 1 - part[:, None]).prod(axis=-1)
    return low[:, None] + corners, weights
