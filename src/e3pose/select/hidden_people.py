"""Hidden people: tracked but not published, and the views that would confirm them.

The estimator hides somebody new until a third camera has seen the person, and somebody who walks
when one camera alone has shown the person for long. Of such people a set S of cameras is expected
to have shown

    sum over people  prod_{c in F} (1 - p_c) (1 - prod_{c in S} (1 - p_c)),    c among those needed

with F the looks that are already ordered and p_c how likely camera c shows a person who is present:
a coverage, which grows with diminishing returns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Flags, Floats
from e3pose.select.kernels import people as kernels


@dataclass(frozen=True, slots=True, eq=False)
class HiddenPeople:
    """People who are hidden in a slot unless a camera shows them.

    Attributes:
        hidden: `(num_tracks,)` in [0, 1]: how likely none of the looks that are ordered has the
            person shown.
        shown: `(num_cameras, num_tracks)` in [0, 1]: how likely a look of each camera has the
            person shown; 0 for those of no use, and of people who are shown anyway.
    """

    hidden: Floats
    shown: Floats

    @classmethod
    def nobody(cls, num_cameras: int) -> HiddenPeople:
        """Return the value for when every person is published."""
        return cls(np.zeros(0), np.zeros((num_cameras, 0)))

    def reveals(self, subsets: Flags) -> Floats:
        """Return `(num_subsets,)` people whom sets of cameras are expected to have shown.

        Args:
            subsets: `(num_subsets, num_cameras)`.
        """
        people = np.empty(len(subsets))
        kernels.revealed(self.hidden, self.shown, subsets, people)
        return people
