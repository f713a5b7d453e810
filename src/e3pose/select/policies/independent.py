"""The paper's Independent Decision (ID): every camera decides for itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.select.policies.base import Selection, Situation

DEFICIT_LIMIT = (
    1.0 + 1e-9
)  # definition: one active slot ahead of the budget, the least that lets a camera start


@dataclass(frozen=True, slots=True)
class Independent:
    """Wake every camera that predicts little occlusion in its own view.

    Nobody counts the cameras, so that a slot may have none. A camera that has not looked for
    `refresh_s` seconds looks again, since the boxes it carries on have become meaningless.

    Attributes:
        occlusion_limit: eq. (4) above which a camera sleeps.
        refresh_s: the longest a camera trusts its motion vectors.
        queue: also keep every camera within its energy budget, by the queue of the other policies.
            The paper's ID has none.

    The paper states neither limit. Both are those that find most on simulated scenes and motion
    capture with as many cameras awake on average as in the paper's other rows, three of five.
    """

    occlusion_limit: float
    refresh_s: float = 0.25
    queue: bool = False

    def select(self, situation: Situation) -> Selection:
        """See `Policy.select`."""
        clear = np.nan_to_num(situation.own_occlusion, nan=0.0) <= self.occlusion_limit
        stale = situation.unseen_slots * situation.interval_s >= self.refresh_s
        affordable = situation.deficit <= (DEFICIT_LIMIT if self.queue else np.inf)
        return np.asarray(situation.online & (clear | stale) & affordable)
