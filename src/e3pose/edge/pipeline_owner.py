"""The owner of an edge's pipeline: whatever changes it between two slots is applied here alone."""

from __future__ import annotations

from dataclasses import replace

from e3pose.base.quantities import plural
from e3pose.edge.consumers import Chosen, Consumers
from e3pose.edge.lead import Lead
from e3pose.edge.overload import Load, shed_load
from e3pose.energy.site_energy import EnergyEstimate
from e3pose.pipeline import Pipeline, SlotRecord
from e3pose.predict.base import Predictor

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
        self.follow(self.lead)

    def shed(self, load: Load) -> Pipeline:
        """Return the pipeline without what an edge under this load sheds."""
        return shed_load(self.pipeline, load)

    def follow(self, lead: Lead) -> str:
        """Change the lead; return an event if it differs, else an empty string."""
        before, self.lead = self.lead.slots, lead
        if lead.slots != self.pipeline.lead_slots:
            self.pipeline = replace(self.pipeline, lead_slots=lead.slots)
        if lead.slots == before:
            return ""
        changed = "raised" if lead.slots > before else "reduced"
        return f"lead {changed} from {before} to {plural(lead.slots, 'slot')}"

    def after_slot(self, consumers: Consumers, record: SlotRecord) -> list[Happened]:
        """Apply what operators, the ledger, the learner and consumers ask for; return events."""
        events: list[Happened] = []
        request = consumers.asks()
        if request != self.pipeline.request:
            self.pipeline = replace(self.pipeline, request=request)
        if consumers.controls is not None:
            asked = consumers.controls.applied()
            self._select_by(asked.chosen)
            if asked.spending is not None and consumers.ledger is not None:
                consumers.ledger.change(*asked.spending)
            events += [("control", line, None) for line in asked.lines]
        if consumers.watch is not None:
            events += consumers.watch.events()
        if consumers.ledger is not None:
            estimate, changes = consumers.ledger.updated()
            self._charge(estimate)
            events += [("energy", line, camera_id) for camera_id, line in changes]
        if consumers.learner is not None:
            consumers.learner.collect(record)
            events += self._predict_by(consumers.learner.poll())
        return events

    def _select_by(self, chosen: Chosen | None) -> None:
        if chosen is not None:
            self.pipeline = replace(self.pipeline, policy=chosen[0], waking=chosen[1])

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

    def _predict_by(self, better: Predictor | None) -> list[Happened]:
        if better is None:
            return []
        self.pipeline = self.pipeline.with_predictor(better)
        return [("predictor", "another learned predictor is used from now on", None)]
