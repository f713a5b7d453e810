"""People followed in one view, where they are seen now and then."""

from __future__ import annotations

import numpy as np
import pytest
from tests.calibrate.people_scenes import walk

from e3pose.calibrate.tracklets import find_tracklets
from e3pose.recording.record import ViewSeries


@pytest.mark.parametrize("share", [1.0, 0.25])
def test_people_are_followed_through_the_gaps_of_a_seldom_active_camera(share: float) -> None:
    calm = walk(701, people=2)
    series = seldom(calm.views[2], share)
    found = find_tracklets(2, series, calm.fps)
    assert sum(map(len, found)) > 0.7 * len(series.scores)


def seldom(series: ViewSeries, share: float) -> ViewSeries:
    """Return a share of what a camera saw, each view at its own time."""
    kept = np.random.default_rng(0).random(len(series.slots)) < share
    slots, times_s = series.slots[kept].tolist(), series.times_s[kept].tolist()
    views = [view for view in map(series.view, slots) if view is not None]
    return ViewSeries.from_views(views, slots, times_s, 17)
