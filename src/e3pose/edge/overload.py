"""Load shedding on a machine that is too slow: steps, thresholds, recovery.

An edge that computes longer than a slot lasts falls behind: views wait, orders take longer, the
lead grows, and a longer lead costs more. Before that happens the edge sheds load, one level at a
time, and restores it once there is capacity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from e3pose.base.records import changed
from e3pose.pipeline import Pipeline
from e3pose.select.camera_order import spread_order
from e3pose.select.policies.base import Need, Policy, Selection, Situation, selected_by
from e3pose.select.policies.fixed import RoundRobin

FULL, ROUND_ROBIN, HALF_RATE = 0, 1, 2
WORDS = {
    FULL: "normal operation",
    ROUND_ROBIN: "cameras are selected by round robin",
    HALF_RATE: "round robin, in every second slot only",
}
AVERAGED_S = 1.0  # the load is a running mean over so long
HIGH = 0.8  # of a slot: above it, the next slot starts late
LOW = 0.5  # there is capacity, also for what was shed
SETTLED_S = 2.0  # time until a level takes effect
CALM_S, LONGEST_CALM_S = 20.0, 640.0  # of low load before a level is undone; doubled if that fails
BEHIND_S = 0.2  # a longer backlog than this, and than a slot, delays orders and views
BLAMED_S = 12.0  # after the edge was too slow, cameras still report the delays of that time
FAILED_S = 20.0  # a level that returns so soon was undone too early


@dataclass(frozen=True, slots=True)
class Load:
    """Load of an edge and its level of load shedding; a value.

    Attributes:
        busy: computing time per slot as a share of the slot, a running mean.
        level: what is shed: `FULL` (nothing), `ROUND_ROBIN` or `HALF_RATE`.
        since_s: since the last change of the level.
        eased: whether the last change was to shed less.
        calm_s: how long the load has been low.
        wait_s: how long it must be low before less is shed.
        awake: cameras per slot while a policy selected and nothing was shed, a running mean.
        behind_s: how long after its deadline a slot is begun, a running mean.
        blamed_s: seconds since the edge was last too slow.
    """

    busy: float = 0.0
    level: int = FULL
    since_s: float = 0.0
    eased: bool = False
    calm_s: float = 0.0
    wait_s: float = CALM_S
    awake: float = 1.0
    behind_s: float = 0.0
    blamed_s: float = math.inf

    def overloaded(self) -> bool:
        """Return whether the edge was too slow lately, so that no camera is to blame for delays.

        An edge that sheds load may keep up by that.
        """
        return self.blamed_s < BLAMED_S

    def message(self) -> str:
        """Return the message about an overload and its load shedding; empty without one."""
        if self.level == FULL and self.blamed_s >= BLAMED_S:
            return ""
        if self.level == FULL and self.blamed_s > 0:
            return f"recovered from an overload {self.blamed_s:.0f} s ago: re-checking cameras"
        behind = f", {self.behind_s:.1f} s behind" if self.behind_s >= BEHIND_S else ""
        shed = f": {WORDS[self.level]}" if self.level > FULL else ""
        if behind and self.busy <= HIGH:
            return f"this computer is too busy: poses come {self.behind_s:.1f} s late{shed}"
        return f"edge overloaded, computing takes {self.busy:.0%} of a slot{behind}{shed}"


def after_work(
    load: Load, took_s: float, interval_s: float, awake: float | None, behind_s: float = 0.0
) -> Load:
    """Return the load after one more slot.

    Args:
        load: before it.
        took_s: its computing time.
        interval_s: seconds per slot.
        awake: cameras active in it; None in the warm-up, when no policy selects.
        behind_s: how long after its deadline it was begun.
    """
    kept = math.exp(-interval_s / AVERAGED_S)
    busy = kept * load.busy + (1 - kept) * took_s / interval_s
    behind_s = kept * load.behind_s + (1 - kept) * max(behind_s, 0.0)
    slow = busy > HIGH or behind_s > max(BEHIND_S, interval_s)
    load = changed(
        load,
        busy=busy,
        since_s=load.since_s + interval_s,
        calm_s=load.calm_s + interval_s if busy < LOW else 0.0,
        awake=kept * load.awake + (1 - kept) * awake
        if load.level == FULL and awake is not None
        else load.awake,
        behind_s=behind_s,
        blamed_s=0.0 if slow else load.blamed_s + interval_s,
    )
    if busy > HIGH and load.level < HALF_RATE and load.since_s >= SETTLED_S:
        too_early = load.eased and load.since_s < FAILED_S
        wait_s = min(2 * load.wait_s, LONGEST_CALM_S) if too_early else CALM_S
        level = load.level + 1
        return replace(load, level=level, since_s=0.0, eased=False, calm_s=0.0, wait_s=wait_s)
    if load.level > FULL and load.calm_s >= load.wait_s:
        return replace(load, level=load.level - 1, since_s=0.0, eased=True, calm_s=0.0)
    return load


def level_change(before: Load, after: Load) -> str | None:
    """Return the message of an event for a level that changed; None if it did not."""
    if after.level == before.level:
        return None
    what = "edge overloaded" if after.level > before.level else "edge load is back to normal"
    return f"{what}, computing takes {after.busy:.0%} of a slot: {WORDS[after.level]}"


def shed_load(pipeline: Pipeline, load: Load) -> Pipeline:
    """Return the pipeline without the parts that are shed."""
    if load.level == FULL:
        return pipeline
    rounds = RoundRobin(load.awake, order=spread_order(pipeline.rig))
    policy: Policy = rounds if load.level == ROUND_ROBIN else EveryOther(rounds)
    # Who sleeps comes back by itself; nobody else is sent to rest meanwhile.
    needs = pipeline.needs - {Need.FORESIGHT}
    return replace(pipeline, policy=policy, needs=needs, rests=None)


@dataclass(frozen=True, slots=True)
class EveryOther:
    """Select no camera in every other slot."""

    policy: Policy

    def select(self, situation: Situation) -> Selection:
        """See `Policy.select`."""
        if situation.slot % 2:
            return np.zeros(len(situation.online), dtype=bool)
        return selected_by(self.policy, replace(situation, slot=situation.slot // 2))
