"""An edge that lets cameras sleep by turns: `sleepy_edge.py SITE`.

In place of a planner: each camera but the first is awake for a while and then asleep.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np

import e3pose.edge.server as server
from e3pose.cli import main

FPS = 20
AWAKE_SLOTS = 4 * FPS
SLEEP_SLOTS = 6 * FPS
usual_step = server.step  # type: ignore[attr-defined]


def sleepy_step(pipeline: Any, state: Any, views: Any, online: Any, *more: Any) -> Any:
    until, target = state.asleep_until.copy(), state.slot + pipeline.lead_slots
    if state.slot > AWAKE_SLOTS:
        for camera in range(1, len(online)):
            others = np.delete(until, camera)[1:]
            if until[camera] + AWAKE_SLOTS < target and not (others > target).any():
                until[camera] = target + SLEEP_SLOTS
    return usual_step(pipeline, replace(state, asleep_until=until), views, online, *more)


server.step = sleepy_step  # type: ignore[attr-defined, assignment]
main(["edge", *sys.argv[1:], "--json-logs"])
