"""Changes between two slots: the pipeline, and the state for another lead or slot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.clock import SlotTimes
from e3pose.base.quantities import plural
from e3pose.edge.consumers import Consumers
from e3pose.edge.lead import Lead
from e3pose.edge.overload import Load, shed_load
from e3pose.energy.site_energy import EnergyEstimate
from e3pose.pipeline import Pipeline, SlotRecord, SlotState

AHEAD_SLOTS = 2  # a state from farther in the future was saved with a wrong clock
LONGEST_AWAY_S = 60.0  # age of a state whose slots and people are still current
Happened = tuple[str, str, str | None]  # kind, message and camera of an event


class PipelineOwner:
    """Holds the pipeline and the lead, each a value that is replaced whole.

    Attributes:
        pipeline: of the next slot.
        lead: of the next slot; the pipeline has its slots.
    """

    def __init__(self, pipeline: Pipeline, lead: Lead | None = None) -> None:
        """Begin with a pipeline, and with its own lead unless there is another."""
        self.pipeline, self.lead = pipeline, lead or Lead(pipeline.lead_slots)
        self.use_lead(self.lead)

    def shed(self, load: Load) -> Pipeline:
        """Return the pipeline without the parts that this load sheds."""
        return shed_load(self.pipeline, load)

    def use_lead(self, lead: Lead) -> str:
        """Change the lead; return an event if it differs, else an empty string."""
        before, self.lead = self.lead.slots, lead
        if lead.slots != self.pipeline.lead_slots:
            self.pipeline = replace(self.pipeline, lead_slots=lead.slots)
        if lead.slots == before:
            return ""
        changed = "raised" if lead.slots > before else "reduced"
        return f"lead {changed} from {before} to {plural(lead.slots, 'slot')}"

    def after_slot(self, consumers: Consumers, record: SlotRecord) -> list[Happened]:
        """Apply changes by operators, ledger, learner and consumers; return events."""
        events: list[Happened] = []
        request = consumers.asks()
        if request != self.pipeline.request:
            self.pipeline = replace(self.pipeline, request=request)
        if consumers.controls is not None:
            asked = consumers.controls.applied()
            if asked.chosen is not None:
                policy, waking = asked.chosen
                self.pipeline = replace(self.pipeline, policy=policy, waking=waking)
            if asked.spending is not None and consumers.ledger is not None:
                consumers.ledger.change(*asked.spending)
            events += [("control", line, None) for line in asked.lines]
        if consumers.watch is not None:
            events += consumers.watch.events()
        if consumers.ledger is not None:
            estimate, changes = consumers.ledger.updated()
            self._charge(estimate)
            for camera, line in changes:
                said = f"{self.pipeline.rig.titles[camera]}: {line}" if camera else line
                events.append(("energy", said, camera))
        if consumers.learner is not None:
            consumers.learner.collect(record)
            if (better := consumers.learner.poll()) is not None:
                self.pipeline = self.pipeline.with_predictor(better)
                line = "another learned predictor is used from now on"
                events.append(("predictor", line, None))
        return events

    def _charge(self, estimate: EnergyEstimate | None) -> None:
        """Use other budgets and costs, and the number of cameras that they pay for."""
        if estimate is None:
            return
        waking, policy = self.pipeline.waking, self.pipeline.policy
        queue = replace(self.pipeline.queue, budget=estimate.budget, cost_j=estimate.cost_j)
        rests = self.pipeline.rests
        self.pipeline = replace(
            self.pipeline,
            queue=queue,
            rests=None if rests is None else rests.with_count(estimate.num_selected),
            policy=policy if waking is None else waking(estimate.num_selected),
        )


def still_true(times: SlotTimes, slot: int, now_ns: int, lead_slots: int) -> tuple[SlotTimes, str]:
    """Return the slot times, and why they were moved; empty if they were not.

    They are moved if the machine's clock was set back, or if so much time seems to have passed
    that it may have been set forward: slot numbers continue with the next one.

    Args:
        times: before.
        slot: the next to compute.
        now_ns: the time.
        lead_slots: slots between an order and the slot it is for.
    """
    away_ns = now_ns - times.middle_ns(slot)
    ahead = slot - times.slot_at(now_ns)
    if ahead <= AHEAD_SLOTS + lead_slots and away_ns <= LONGEST_AWAY_S * 1e9:
        return times, ""
    next_ns = now_ns + (1 + lead_slots) * times.interval_ns
    moved = SlotTimes(next_ns - slot * times.interval_ns, times.interval_ns)
    if away_ns < 0:
        return moved, f"this machine's clock went back by {lasting(-away_ns / 1e9)}"
    return moved, f"{lasting(away_ns / 1e9)} since the last slot, by this machine's clock"


def lasting(seconds: float) -> str:
    """Return a duration in a convenient unit: `3.2 s`, `45 min`, `10.0 years`."""
    for unit, length_s in (("years", 365.25 * 86400), ("days", 86400.0), ("h", 3600.0)):
        if seconds >= 2 * length_s:
            return f"{seconds / length_s:.1f} {unit}"
    return f"{seconds / 60:.0f} min" if seconds >= 600 else f"{seconds:.1f} s"


def with_lead(state: SlotState, lead_slots: int) -> SlotState:
    """Return the state for another lead.

    A longer lead extends the last decision to the slots in between; a shorter one repeats the
    last decisions.

    Args:
        state: before a slot.
        lead_slots: slots between a decision and the slot it is for, at least 1.
    """
    decided = state.selections
    missing = lead_slots - len(decided)
    if missing <= 0:
        return replace(state, selections=decided[:lead_slots])
    return replace(state, selections=np.concatenate([decided, np.repeat(decided[-1:], missing, 0)]))


def skip_to(state: SlotState, slot: int, budget: Floats) -> SlotState:
    """Return the state before a later slot, after slots that were not computed.

    People may have moved, so all cameras that are awake are active in slots without a decision;
    idle cameras have saved energy meanwhile.

    Args:
        state: before the skipped slots.
        slot: the next to compute.
        budget: `(num_cameras,)` share of slots allowed.
    """
    skipped = slot - state.slot
    if skipped <= 0:
        return state
    slots = np.arange(slot, slot + len(state.selections))
    return replace(
        state,
        slot=slot,
        selections=np.asarray(state.asleep_until <= slots[:, None]),
        deficit=np.maximum(state.deficit - skipped * budget, 0.0),
    )
