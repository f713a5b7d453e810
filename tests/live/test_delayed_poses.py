"""Smoothed poses of a running site: followed from Python, and streamed to a file."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from tests.live.processes import COMPILE_S, run, up
from tests.live.test_programs import write_site

from e3pose.site.connect import LiveSlot, connect

pytestmark = pytest.mark.live


def test_smoothed_poses_come_later_and_are_streamed(tmp_path: Path, recording: Path) -> None:
    path = write_site(tmp_path, recording)
    path.write_text(path.read_text().replace("fps = 20", "fps = 20\nsmooth_delay_ms = 100"))
    dest = tmp_path / "late.mcap"
    with (
        up(path, signal.SIGINT),
        connect(path, wait_s=COMPILE_S) as now,
        connect(path, wait_s=COMPILE_S, delayed=True) as late,
    ):
        at_once = {slot.slot: slot for slot in (now.next() for _ in range(60)) if slot is not None}
        words = ("stream", str(path), f"mcap:{dest}", "--delayed", "--for", "3")
        code, out, err = run(*words, seconds=60)
        smoothed = [slot for slot in (late.next() for _ in range(40)) if slot is not None]
    assert code == 0 and out.startswith("Streaming smoothed poses of site lab"), err
    shared = [(at_once[slot.slot], slot) for slot in smoothed if slot.slot in at_once]
    assert len(shared) > 20
    for first, later in shared:
        assert (first.delay_ms, later.delay_ms) == (0.0, 100.0)
        assert later.people.track_ids.tolist() == first.people.track_ids.tolist()
    # An edge that catches up publishes several slots at once: the median.
    assert np.median([b.published_ns - a.published_ns for a, b in shared]) > 50_000_000
    moved = [np.abs(b.people.joints_m - a.people.joints_m) for a, b in shared if len(a)]
    assert moved and max(float(np.nanmax(m)) for m in moved) > 1e-4  # not the same again
    assert _sigma([b for _, b in shared]) < _sigma([a for a, _ in shared])
    with dest.open("rb") as file:
        told = [
            json.loads(message.data)
            for _, channel, message in make_reader(file).iter_messages()
            if channel.topic == "/poses"
        ]
    assert told and {slot["delay_ms"] for slot in told} == {100.0}


def _sigma(slots: list[LiveSlot]) -> float:
    return float(np.nanmean(np.concatenate([slot.people.sigma_m.ravel() for slot in slots])))
