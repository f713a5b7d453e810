"""Three readings of the protocol of Shelf."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import accuracy
from e3pose_lab.datasets.shelf import import_shelf
from e3pose_lab.reproduce.replays import pcp_readings

SHARED = os.environ.get("E3POSE_SHARED")


@pytest.mark.shared
@pytest.mark.parity
@pytest.mark.skipif(not SHARED, reason="E3POSE_SHARED is not set")
def test_readings_of_the_table_are_in_order_and_one_is_what_is_shown() -> None:
    shelf = import_shelf(Path(SHARED or "") / "data" / "shelf" / "shelf.npz")
    settings = ReplaySettings(pipeline="paper", policy="random", num_selected=3)
    records = list(replay(shelf, settings))
    readings = pcp_readings(shelf, records)
    estimated, shown, skipped = (
        readings[name]["average"] for name in ("estimated", "shown", "skipped")
    )
    assert estimated + 3 < shown < skipped
    pcp = accuracy(shelf, records).pcp
    assert pcp is not None and pcp.actors == readings["shown"]
    bare = list(replay(shelf, replace(settings, fill=False)))
    plain = accuracy(shelf, bare).pcp
    assert plain is not None and plain.actors["average"] == pytest.approx(estimated)
