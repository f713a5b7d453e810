"""Measure how often cameras are left out while their views and orders come late or not at all.

Three cameras and an edge in one process, 20 slots a second, all selected; after a quiet time every
message takes 50 to 150 ms and 5 % are lost. Run as

    PYTHONPATH=. python lab/benchmarks/late_views.py
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.append(str(Path(__file__).resolve().parents[2]))  # scenes of the tests

from tests.edge.one_process import site_at_work

QUIET_S = 20.0  # so that the lead remembers quick orders


def measure(deadline_s: float, seconds: float) -> str:
    rng = random.Random(3)
    with (
        tempfile.TemporaryDirectory() as folder,
        site_at_work(Path(folder), deadline_s, num_selected=3) as site,
    ):
        edge = site.edge
        assert edge is not None
        time.sleep(QUIET_S)
        site.hub.delay_s = lambda topic: rng.uniform(0.05, 0.15)
        site.hub.fault = lambda topic, payload: None if rng.random() < 0.05 else payload
        views, slots, end_s = edge.counts.views, edge.counts.slots, time.monotonic() + seconds
        answering: dict[int, NDArray[np.bool_]] = {}
        while time.monotonic() < end_s:
            state = edge.state
            answering[state.slot] = state.silence.answering(state.slot)
            time.sleep(0.01)
        slots = edge.counts.slots - slots
        left_out = 1 - np.mean(list(answering.values()))
        return (
            f"{deadline_s * 1e3:8.0f}  {left_out:8.1%}  {(edge.counts.views - views) / slots:12.2f}"
            f"  {edge.lead.slots:4d}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0)
    options = parser.parse_args()
    print("deadline  left out  views per slot  lead")
    for deadline_s in (0.1, 0.15):
        print(measure(deadline_s, options.seconds), flush=True)


if __name__ == "__main__":
    main()
