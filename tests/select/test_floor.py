"""The floor that cameras watch: one notices a newcomer, two estimate."""

from __future__ import annotations

import numpy as np
from tests.five_cameras import RIG

from e3pose.select.floor import seen_floor, watches


def test_every_cell_is_seen_by_two_cameras_from_where_a_person_stands() -> None:
    cells_m, seen = seen_floor(RIG)
    assert len(cells_m) == seen.shape[1] > 10 and (seen.sum(axis=0) >= 2).all()
    middle = np.hypot(*cells_m.T).argmin()
    assert seen[:, middle].all()  # all five look at the middle of the ring


def test_more_cameras_never_watch_less_and_all_watch_everything() -> None:
    cells_m, _ = seen_floor(RIG)
    likely = np.full(len(cells_m), 1 / len(cells_m))
    sets = np.tri(6, 5, -1, dtype=bool)  # none, the first, the first two and so on
    found = watches(RIG, sets, likely)
    assert found[0] == 0 and (np.diff(found) >= 0).all()
    np.testing.assert_allclose(found[-1], 1.0)
    assert found[1] <= 0.5  # one camera alone estimates nobody
