"""The edge server: four kinds of threads around the one `pipeline.step`.

    receiving (the transport's threads -> Inbox -> Gather)
    fusion and selection (`_run_slots`: close a slot, step, pass on)
    sending (SendQueue)
    housekeeping (Housekeeping: status, checkpoint, events, watchdog)

It contains no mathematics: it owns the clock, the threads and the counters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.base.clock import Clock, SlotTimes
from e3pose.base.kernel import INTERPRETING
from e3pose.base.quantities import plural
from e3pose.base.records import changed
from e3pose.base.threads import ThreadGroup
from e3pose.edge.camera_state import (
    Answers,
    State,
    Turn,
    after_slot,
    claimed_wakes_s,
    excused,
    followed,
    impairments,
    shortages,
    states_of,
    tried,
    waits_s,
)
from e3pose.edge.consumers import NO_CONSUMERS, Consumers
from e3pose.edge.counters import Counts, Durations
from e3pose.edge.events import EventLog
from e3pose.edge.gather import Arrival, Gather
from e3pose.edge.housekeeping import Housekeeping
from e3pose.edge.inbox import Inbox
from e3pose.edge.lead import (
    USUAL_WAKE_S,
    Lead,
    adapt,
    believed_wakes_s,
    cautious,
    lead_for,
    starting,
    with_claims,
    with_edge_delay,
)
from e3pose.edge.membership import Membership
from e3pose.edge.orders import Orders
from e3pose.edge.overload import Load, after_work, level_change
from e3pose.edge.pipeline_owner import PipelineOwner, lasting, skip_to, still_true, with_lead
from e3pose.edge.precompile import Beside, warm_up, without_extras
from e3pose.edge.publisher import Publisher
from e3pose.edge.reports import site_status
from e3pose.edge.send_queue import SendQueue
from e3pose.edge.state_file import StateFile
from e3pose.estimate.base import Estimate
from e3pose.estimate.smooth.delayed import Delayed
from e3pose.model.blind_slot import no_choice
from e3pose.pipeline import Pipeline, SlotRecord, SlotState, initial_state, step
from e3pose.select.failure_detector import Silence, acknowledge_late
from e3pose.settings.edge import EdgeSettings
from e3pose.wire import topics
from e3pose.wire.site_messages import Status
from e3pose.wire.transport import Transport

BACKLOG_S = 2.0  # an edge that is farther behind skips slots
IDS_LEFT_OUT = 100  # ids given after the last checkpoint of a killed edge
END_S = 5.0  # to end a thread


class EdgeServer:
    """Runs a site until stopped. Use as a context manager, or `start` and `stop` it."""

    def __init__(
        self,
        pipeline: Pipeline,
        transport: Transport,
        settings: EdgeSettings,
        clock: Clock,
        state_file: StateFile | None = None,
        event_log: EventLog | None = None,
        consumers: Consumers = NO_CONSUMERS,
    ) -> None:
        """Resume from the checkpoint, if there is one that fits.

        Args:
            pipeline: the parts of the loop.
            transport: how to reach the cameras; the server closes it.
            settings: see `EdgeSettings`.
            clock: the edge's time.
            state_file: saves the state, and holds that of an earlier run; None saves none.
            event_log: logs and stores events.
            consumers: of slots and heartbeats.
        """
        self.settings, self.clock = settings, clock
        self.consumers, self.event_log = consumers, event_log or EventLog(clock)
        self.membership = Membership(transport, clock, self._listen)
        self.interval_ns = round(pipeline.interval_s / settings.pace * 1e9)
        interval_s = self.interval_ns / 1e9
        self.started_ns, num_cameras = clock.now_ns(), len(pipeline.rig)
        self.counts, self.gather = Counts(num_cameras, interval_s), Gather(num_cameras)
        self.answers, self.load = Answers.none(num_cameras), Load()
        self.inbox = Inbox(
            settings.site,
            pipeline.rig,
            settings.skeleton.joints,
            interval_s,
            self.gather,
            clock,
            consumers.take,
            consumers.paused,
            wakes_s=settings.wakes_s,
            known=settings.known,
        )
        self.send_queue = SendQueue()
        self.orders = Orders(
            settings.site,
            pipeline.rig.camera_ids,
            settings.idle_modes,
            clock.now_ns() // 1000,  # larger than that of any edge before
            self.send_queue,
            clock,
            self.inbox,
        )
        self.state_file = state_file or StateFile(pipeline, None, self.event_log.report)
        lead = cautious(settings.deadline_s, interval_s) if settings.adaptive_lead else None
        self.owner = PipelineOwner(pipeline, lead)
        self.state: SlotState = initial_state(self.pipeline)
        self.times: SlotTimes | None = None  # until the first slot
        self.newest: SlotRecord | None = None
        self._resume()
        self.ready = False  # whether all kernels are compiled
        self.compiling: Beside | None = None  # meanwhile they are interpreted
        self.publisher = Publisher(settings, pipeline.rig, interval_s, self.send_queue, clock)
        self.threads = ThreadGroup(self._wake)
        self.housekeeping = Housekeeping(self)

    def __enter__(self) -> EdgeServer:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def pipeline(self) -> Pipeline:
        """The parts of the loop in the next slot."""
        return self.owner.pipeline

    @property
    def lead(self) -> Lead:
        """The lead of the next slot."""
        return self.owner.lead

    def start(self) -> None:
        """Start to receive, and to compute slots once cameras are connected."""
        if self.consumers.sink is not None:
            self.event_log.attach(self.consumers.sink)
        self.membership.join()  # cameras connect while it gets ready
        self.start_sending()
        self.threads.start("keeping", self.housekeeping.run)  # tells how long that takes
        self.compiling = Beside.start(*self._compiled())
        if self.compiling is None:
            warm_up(*self._compiled())
            self.ready = True
        self.threads.start("fusion", self._run_slots)

    def stop(self) -> None:
        """Finish the current slot, save the state, leave the site."""
        if not self.threads.stop():
            return
        self.gather.wake()
        self.threads.join(END_S, without="sending")
        if self.compiling is not None:
            self.compiling.leave()
        self.housekeeping.keep_checkpoint()
        self.send_queue.close()
        self.threads.join(END_S)
        self.membership.leave()

    def _listen(self, transport: Transport) -> None:
        self.inbox.listen(transport)
        self.consumers.listen(transport, self.settings.site)
        transport.be_present(topics.of_site(self.settings.site, "alive"))

    def start_sending(self) -> None:
        """Start the thread that sends; it takes over from one that hangs."""
        self.threads.start("sending", lambda: self.send_queue.run(self._publish))

    def _publish(self, topic: str, payload: bytes, slot: int) -> None:
        self.membership.publish(topic, payload)
        if (latency_ns := self.publisher.latency_ns(topic, slot)) is not None:
            self.counts.latency.add(latency_ns)

    def _wake(self) -> None:
        self.gather.wake()
        self.send_queue.close()

    def running(self) -> bool:
        """Return whether all threads are running."""
        return self.threads.running()

    def impairments(self) -> tuple[list[str], list[str]]:
        """Return why each camera is useless, and why it brings too few views; else empty."""
        cameras, late_by_s = self.inbox.cameras, self.gather.late_by_s(self.settings.deadline_s)
        if self.load.overloaded():  # no camera is to blame
            return [""] * len(cameras), [""] * len(cameras)
        useless = impairments(
            self.answers,
            self.state.silence,
            self.lead,
            late_by_s,
            self.gather.newest_late,
            self.pipeline.interval_s,
        )
        slots_hz, pace = 1e9 / self.interval_ns, self.settings.pace
        return useless, shortages(self.answers, cameras, slots_hz, pace)

    def status(self) -> Status:
        """Return the status of the site."""
        return site_status(self)

    # The fusion thread.

    def _run_slots(self) -> None:
        stopping, wait_s = self.threads.stopping, self.settings.start_wait_s
        if not self.inbox.wait_for_cameras(stopping, wait_s, resumes=self.times is not None):
            return
        times = self.times = self._begin()
        INTERPRETING.on = not self.ready
        while not self.threads.stopping.is_set():
            if self.compiling is not None:
                self._compile(times, self.compiling)
            self._catch_up(times)
            self._forgive()
            slot = self.state.slot
            if not self._wait_for_views(times, slot):
                return
            self._compute(times, slot, self.gather.close())

    def _compiled(self) -> tuple[Pipeline, Sequence[str], Delayed | None]:
        """Return the loop to compile, as `warm_up` takes it."""
        return self.pipeline, self.settings.skeleton.joints, self.publisher.delayed

    def _compile(self, times: SlotTimes, beside: Beside) -> None:
        """Go on to a slot that can be ordered in time; compute as usual once all is compiled."""
        if beside.ended():
            INTERPRETING.on = False
            warm_up(*self._compiled())  # from disk
            beside.leave()
            self.ready, self.compiling = True, None
            self.counts.stepping, self.counts.latency = Durations(), Durations()
        self._skip(times.slot_at(self.clock.now_ns()) + 1 + self.lead.slots)
        self._order_ahead(times, 0)

    def _begin(self) -> SlotTimes:
        now_ns = self.clock.now_ns()
        if self.times is None:
            ahead = (1 + self.lead.slots) * self.interval_ns
            times = SlotTimes(now_ns + ahead, self.interval_ns)
        else:
            times, moved = still_true(self.times, self.state.slot, now_ns, self.lead.slots)
            if moved:
                self.event_log.report("clock", f"{moved}: slot numbers continue, all tracks end")
                memory = self.pipeline.estimator.forget_people(self.state.memory)
                self.state = replace(self.state, memory=memory)
            self._skip(max(self.state.slot, times.slot_at(now_ns) + 1))
        self._order_ahead(times, 0)
        return times

    def _order_ahead(self, times: SlotTimes, start: int) -> None:
        """Send the orders of future slots, from `start` slots ahead."""
        for ahead in range(start, self.lead.slots if self.ready else 1):
            decision, until = self.state.selections[ahead], self.state.asleep_until
            slot = self.state.slot + ahead
            self.orders.give(times, slot, decision, ahead + 1, asleep_until=until)

    def _catch_up(self, times: SlotTimes) -> None:
        behind_ns = self.clock.now_ns() - self._deadline_ns(times, self.state.slot)
        if behind_ns < BACKLOG_S * 1e9:
            return
        lost = behind_ns // self.interval_ns
        self.counts.skip(lost)
        self.event_log.report("slots-lost", f"skipped {plural(lost, 'slot')}: the edge was behind")
        self._skip(self.state.slot + lost)
        self.inbox.excuse()

    def _forgive(self) -> None:
        """Presume that all cameras answer after a fault of the edge."""
        if self.housekeeping.rejoined.is_set():
            self.housekeeping.rejoined.clear()
            self.state = replace(self.state, silence=Silence.none(len(self.pipeline.rig)))
            self.answers = self.answers.forgiven()

    def _skip(self, slot: int) -> None:
        self.state = skip_to(self.state, slot, self.pipeline.queue.budget)
        self.gather.skip_to(slot)

    def _deadline_ns(self, times: SlotTimes, slot: int) -> int:
        return times.middle_ns(slot) + round(self.settings.deadline_s * 1e9)

    def _wait_for_views(self, times: SlotTimes, slot: int) -> bool:
        """Wait for all views or the deadline; return False when the edge stops."""

        def awaited(missing: Sequence[int]) -> list[int]:
            found = self.inbox.standings(missing)
            return [c for c, (state, _) in zip(missing, found, strict=True) if state == State.READY]

        longest_s = waits_s(self.answers, self._ordered(times, slot), self.settings.deadline_s)
        middle_ns = times.middle_ns(slot)
        until_ns = {c: middle_ns + round(s * 1e9) for c, s in enumerate(longest_s.tolist()) if s}
        return self.gather.wait(self.clock, self.threads.stopping, middle_ns, until_ns, awaited)

    def _turn(self, times: SlotTimes, slot: int, arrivals: Mapping[int, Arrival]) -> Turn:
        """Return the cameras' part in a slot that was just closed."""
        ordered = self._ordered(times, slot)
        ages_s, late = np.full(len(ordered), np.nan), self.gather.late.copy()
        for camera, arrival in arrivals.items():
            if ordered[camera]:
                ages_s[camera] = (arrival.arrived_ns - times.middle_ns(slot)) / 1e9
        answering = self.state.silence.answering(slot)
        return Turn(
            states=states_of(self.inbox.states(), self.answers, answering),
            ordered=ordered,
            ages_s=ages_s,
            views=self.gather.views.copy(),
            late=late,
            views_late=late > self.answers.late,
            orders_late=excused(self.answers, self.inbox.orders_late()),
        )

    def _compute(self, times: SlotTimes, slot: int, arrivals: Mapping[int, Arrival]) -> None:
        begun_ns = self.clock.now_ns()
        behind_s = (begun_ns - self._deadline_ns(times, slot)) / 1e9
        turn, newest_late = self._turn(times, slot, arrivals), self.gather.newest_late
        state, interval_s, decided = self.state, self.pipeline.interval_s, self.state.selections
        state = changed(
            state,
            silence=acknowledge_late(state.silence, turn.views_late, turn.orders_late, interval_s),
            selections=np.concatenate([turn.ordered[None], decided[1:]]),
        )
        views = {camera: arrival.poses for camera, arrival in arrivals.items()}
        used = {
            camera: arrivals[camera].arrived_ns for camera in np.flatnonzero(turn.arrived).tolist()
        }
        time_ns = times.middle_ns(slot)
        blind = "" if used else self.orders.why_blind(times, slot, decided[0], turn, newest_late)

        def publish(estimate: Estimate) -> None:
            selected, stored = turn.ordered & turn.reached, self.consumers.stored()
            self.publisher.publish(slot, time_ns, estimate, used, selected, blind, stored)

        pipeline = self.owner.shed(self.load) if self.ready else without_extras(self.pipeline)
        try:
            with nullcontext() if self.ready else np.errstate(all="ignore"):
                self.state, record = step(pipeline, state, views, turn.usable, publish)
        except (ArithmeticError, ValueError):  # where a compiled kernel goes on with NaN
            if self.ready:
                raise
            return
        if blind:
            record = changed(record, blind=blind)
        took_ns = self.clock.now_ns() - begun_ns
        if self.ready:
            self._order_next(times, slot, record, turn, newest_late)
        self.orders.forget_before(slot)
        self.newest = record
        self.counts.count_slot(len(used), turn.ordered & turn.online, record, begun_ns, took_ns)
        self.consumers.observe(record, time_ns, arrivals)
        self.consumers.keep(record, time_ns, arrivals)
        took_ns += self.publisher.publish_delayed(
            record, time_ns, busy=self.load.level > 0 or not self.ready
        )
        self._judge(turn, record, took_ns / 1e9, behind_s)
        self._update_pipeline(times, record, turn.online)
        self.housekeeping.quiet.set()

    def _order_next(
        self, times: SlotTimes, slot: int, record: SlotRecord, turn: Turn, newest_late: Flags
    ) -> None:
        """Give the orders that were decided in a slot."""
        lead = self.pipeline.lead_slots
        none = no_choice(turn.expected, self.state.silence.answering(slot + lead), newest_late)
        decision = self._with_trial(times, slot, record.next_selection, turn.states)
        until = record.asleep_until
        self.orders.give(times, slot + lead, decision, lead, record.expected, none, until)
        late_s = (self.clock.now_ns() - self._deadline_ns(times, slot)) / 1e9
        self.owner.use_lead(with_edge_delay(self.lead, late_s, self.interval_ns / 1e9))

    def _judge(self, turn: Turn, record: SlotRecord, took_s: float, behind_s: float) -> None:
        """Note whether the edge keeps up, and if it does, how its cameras answer."""
        before, slot_s = self.load, self.interval_ns / 1e9
        awake = int(record.selected.sum()) if record.slot >= self.pipeline.warmup_slots else None
        if self.ready:
            self.load = after_work(before, took_s, slot_s, awake, behind_s)
        if said := level_change(before, self.load):
            self.event_log.report("overload", said)
        given_up = self.state.silence.failures > 0
        fair = self.ready and not self.load.overloaded()
        self.answers = after_slot(self.answers, turn, given_up, slot_s, fair)

    def _with_trial(self, times: SlotTimes, slot: int, decision: Flags, states: Integers) -> Flags:
        """Return a decision with the tried camera; order a slow one earlier."""
        on_trial = np.flatnonzero(states == int(State.ON_TRIAL)).tolist()
        if not on_trial:
            return decision
        lead, interval_s = self.pipeline.lead_slots, self.interval_ns / 1e9
        wakes_s = self._wakes_s(np.ones(len(decision), dtype=bool))
        for camera in on_trial:
            ahead = lead_for(self.lead, camera, interval_s, float(wakes_s[camera]))
            if ahead > lead and tried(self.answers, states, slot + ahead, interval_s)[camera]:
                self.orders.give_early(times, slot, camera, ahead)
        trial = tried(self.answers, states, slot + lead, interval_s) & ~decision
        decision, deficit = decision | trial, self.state.deficit + trial
        selections = np.concatenate([self.state.selections[:-1], decision[None]])
        self.state = replace(self.state, selections=selections, deficit=deficit)
        return decision

    def _wakes_s(self, counted: Flags) -> Floats:
        """Return `(num_cameras,)`: wake-up times of cameras that sleep between slots, else 0.

        Args:
            counted: `(num_cameras,)` cameras whose word counts.
        """
        found_s = claimed_wakes_s(self.inbox.cameras, self.settings.idle_modes)
        claims_s = [s if counts else None for s, counts in zip(found_s, counted, strict=True)]
        configured_s = self.settings.wakes_s or [USUAL_WAKE_S] * len(claims_s)
        return believed_wakes_s(claims_s, configured_s, self.answers.share)

    def _ordered(self, times: SlotTimes, slot: int) -> Flags:
        """Return `(num_cameras,)`: cameras selected for a slot by an order in time."""
        return np.asarray(self.state.selections[0] & self.orders.in_time(times, slot))

    def _update_pipeline(self, times: SlotTimes, record: SlotRecord, online: Flags) -> None:
        """Update lead, predictor and budgets between two slots."""
        if self.state.asleep_until.any():
            until = np.where(self.inbox.can_sleep(), self.state.asleep_until, 0)
            self.state = changed(self.state, asleep_until=until)
        while self.inbox.overslept:
            name, said = self.inbox.overslept.popleft()
            self.event_log.report("camera-overslept", said, name)
        for kind, line, camera_id in self.owner.after_slot(self.consumers, record):
            self.event_log.report(kind, line, camera_id)
        if not (self.settings.adaptive_lead and self.ready):
            return
        counted = followed(self.answers, self.state.silence) & online
        wake_s = float(self._wakes_s(counted).max())
        claims = [self.inbox.delays.popleft() for _ in range(len(self.inbox.delays))]
        slot_s, before = self.interval_ns / 1e9, self.lead.slots
        counts = counted.tolist()
        lead = with_claims(self.lead, claims, self.answers.share, slot_s, wake_s, counts)
        lead = adapt(lead, slot_s, wake_s, online.tolist(), counts)
        if change := self.owner.use_lead(lead):
            self.event_log.report("lead", change)
            self.state = with_lead(self.state, self.lead.slots)
            self._order_ahead(times, before)  # slots without orders yet

    def _resume(self) -> None:
        found = self.state_file.take_up()
        if found is None:
            return
        self.times = SlotTimes(found.origin_ns, self.interval_ns)
        if self.settings.adaptive_lead:
            self.owner.use_lead(starting(found.lead_slots))
        memory = self.pipeline.estimator.leave_out_ids(found.state.memory, IDS_LEFT_OUT)
        self.state = with_lead(replace(found.state, memory=memory), self.lead.slots)
        self.inbox.order_sleep(self.times, self.state.asleep_until, self.state.slot, 1)
        away_s = (self.clock.now_ns() - found.made_ns) / 1e9
        when = f"{lasting(abs(away_s))} {'later' if away_s >= 0 else 'before the state was saved'}"
        self.event_log.report("resumed", f"resumed after slot {self.state.slot - 1}, {when}")
