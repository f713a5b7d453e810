"""The edge program: from a site file to a running edge."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from e3pose import __version__
from e3pose.base.atomic import check_file_free
from e3pose.base.clock import Clock, WallClock
from e3pose.base.errors import InputError
from e3pose.base.lock import hold_all
from e3pose.edge.consumers import Consumers
from e3pose.edge.displacement import DisplacementWatch, WorldCheck
from e3pose.edge.energy_ledger import EnergyLedger
from e3pose.edge.events import EventLog
from e3pose.edge.learn import LearningSettings, OnlineTrainer
from e3pose.edge.learn.versions import check_learning_folder
from e3pose.edge.metrics import serve_metrics
from e3pose.edge.recorder import Recorder, RecorderSettings
from e3pose.edge.server import EdgeServer
from e3pose.edge.state_file import StateFile
from e3pose.energy.budgets import Budget
from e3pose.estimate.base import Estimator
from e3pose.events.watch import Watch, site_watch
from e3pose.model.noises import load_noise
from e3pose.model.skeleton import own_file
from e3pose.pipeline import Pipeline
from e3pose.predict.base import Predictor
from e3pose.recording.videos import MAX_BYTES, PART_S
from e3pose.select.policies.base import Policy
from e3pose.settings.edge import EdgeSettings
from e3pose.settings.parts import warnings_of
from e3pose.settings.resolved import ResolvedSite, resolve
from e3pose.settings.site_file import SiteTable, load_site
from e3pose.site.admission import Admission, ExpiryWatch, edge_link
from e3pose.site.check.finding import report as report_findings
from e3pose.site.check.parts import start_problems
from e3pose.site.control import SiteControls
from e3pose.site.event_sink import EventSink
from e3pose.site.program_log import NO_LOG, Log
from e3pose.site.run import reduce_pauses, run_until_stopped
from e3pose.site.web.tokens import hub_tokens
from e3pose.site.zones import Zones
from e3pose.store.rows import Event, Run
from e3pose.wire.keys.folder import not_admitted
from e3pose.wire.network import open_network
from e3pose.wire.site_messages import Status
from e3pose.wire.transport import Transport

if TYPE_CHECKING:
    from e3pose.store import StoreWriter

WH_J = 3600.0


@dataclass(slots=True, eq=False)
class Edge:
    """An edge at work, until it is closed. Use it as a context manager.

    Attributes:
        server: what computes the slots.
        admission: who may join.
        expiry: tells when certificates end.
        stack: of what is closed after the server.
    """

    server: EdgeServer
    admission: Admission
    expiry: ExpiryWatch
    stack: ExitStack

    @property
    def site(self) -> SiteTable:
        """The site's settings."""
        return self.admission.site

    def __enter__(self) -> Edge:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """See `close`."""
        self.close()

    def status(self) -> Status:
        """Return how the site is."""
        return self.server.status()

    def running(self) -> bool:
        """Return whether it is running; also applies new certificates, so call it often."""
        self.admission.update()
        self.expiry.update()
        return self.server.running()

    def run(self, for_s: float | None = None) -> None:
        """Run until Ctrl-C, SIGTERM, or for a number of seconds.

        To be called on the main thread.

        Raises:
            Fault: when a thread of the edge failed.
        """
        reduce_pauses()
        run_until_stopped(self.running, for_s)
        self.server.stop()
        self.server.threads.check()

    def close(self) -> None:
        """Finish the current slot, save the state, leave the site."""
        self.stack.close()


def open_edge(
    site: Path | str,
    log: Log | None = None,
    *,
    policy: str | Policy | None = None,
    predictor: str | Predictor | None = None,
    estimator: Estimator[Any] | None = None,
    clock: Clock | None = None,
) -> Edge:
    """Start the edge of a site, which then works by itself until it is closed.

    The very first time this compiles for a minute or two.

    Args:
        site: the site file, or the folder that has it as `site.toml`.
        log: gets messages for operators; by default they are discarded.
        policy: in place of the file's, a name or an object.
        predictor: likewise.
        estimator: in place of that of the file's pipeline.
        clock: the edge's.

    Raises:
        InputError: naming the file, the key, what was found and what was expected.
    """
    table = load_site(Path(site))
    loop = replace(
        table.loop,
        policy=table.loop.policy if policy is None else policy,
        predictor=table.loop.predictor if predictor is None else predictor,
        estimator=estimator,
    )
    return start_edge(resolve(replace(table, loop=loop)), log or NO_LOG, clock or WallClock())


@dataclass(frozen=True, slots=True, eq=False)
class EdgeParts:
    """The checked parts of an edge.

    Attributes:
        pipeline: the parts of its loop.
        budgets: `(num_cameras,)` what the site file lets each camera spend; None where it does not
            say.
        watch: what follows the people; None where the site does not ask for it.
        written: the files that it alone may write, each with what of it.
    """

    pipeline: Pipeline
    budgets: Sequence[Budget | None]
    watch: Watch | None
    written: Sequence[tuple[Path, str]]


def check_edge(site: ResolvedSite) -> EdgeParts:
    """Return the parts of the edge of a site, after checking all that it needs to start.

    Raises:
        InputError: for what is wrong in the file or in its places.
    """
    written = list[tuple[Path, str]]()
    try:
        if site.file.learn is not None:
            check_learning_folder(site.file.learn)
        watch = site_watch(site)
        if site.file.store is not None:
            from e3pose.store.database import check_place, database_path, database_url

            url = database_url(site.file.store.place)
            check_place(url)
            if (file := database_path(url)) is not None:
                written.append((file, site.file.name))  # other sites may share it
        budgets, pipeline = site.budgets(), site.pipeline()
        if site.file.state is not None:
            check_file_free(site.file.state)
            written.insert(0, (site.file.state, ""))
    except InputError as error:
        raise error.at(site.file.path) from None
    return EdgeParts(pipeline, budgets, watch, written)


def start_edge(site: ResolvedSite, log: Log, clock: Clock) -> Edge:
    """Start the edge of a site; see `open_edge`."""
    parts = check_edge(site)
    for warning in warnings_of(site, site.loop):
        log.warning(warning)

    def report(event: Event) -> None:
        log.info(event.message, kind=event.kind, camera=event.camera_id)

    with ExitStack() as stack:
        hold_all(parts.written, stack)
        link, roll = edge_link(site.file)
        report_findings(start_problems(site), log.warning)  # once nothing is to be refused
        refused = not_admitted(roll, site.rig.camera_ids)
        transport = open_network(link, roll)
        stack.callback(transport.close)
        server = make_edge(site, parts, transport, clock, report, stack)
        server.inbox.not_admitted = refused
        if site.file.metrics_port is not None:
            stack.callback(serve_metrics(server, site.file.metrics_port).close)
        stack.callback(server.stop)
        admission = Admission(site.file, server, open_network, log.info)
        watchdog = server.housekeeping.watchdog
        watchdog.prepare, watchdog.folder = admission.prepare, site.file.folder / "logs"
        log.info("getting ready; the very first time this compiles for a minute or two")
        server.start()
        log.info("waiting for cameras", endpoint=str(link.endpoint), cameras=len(site.rig))
        expiry = ExpiryWatch(site.file.link.keys, server.event_log.report)
        return Edge(server, admission, expiry, stack.pop_all())
    raise AssertionError("an exit stack lets no error pass")


def make_edge(
    site: ResolvedSite,
    parts: EdgeParts,
    transport: Transport,
    clock: Clock,
    report: Callable[[Event], None],
    stack: ExitStack,
) -> EdgeServer:
    """Return the edge of a site, not yet started, with its store, its ledger and its trainer.

    Args:
        site: what its file says.
        parts: what it is made of.
        transport: how to reach the cameras.
        clock: the edge's.
        report: called with messages for operators.
        stack: closes what is opened here.
    """
    outbox = None
    if site.file.store is not None:
        from e3pose.site.outbox_answers import OutboxAnswers

        box = OutboxAnswers(site.file.store.place, site.file.name, tokens=hub_tokens(site.file))
        outbox = box.answer
    pipeline, event_log = parts.pipeline, EventLog(clock, report)
    state_file = StateFile(pipeline, site.file.state, event_log.report, clock.now_ns())
    state_file.take_up()
    sink = open_store(site, state_file.run_ns, event_log, stack)
    kept = None if sink is None else EventSink(sink, Zones(site.file.zone), parts.watch)
    controls = SiteControls(site, kept)
    recorder = open_recorder(site, event_log, stack)
    learner = None
    if site.file.learn is not None:
        learner = OnlineTrainer(
            site.file.learn, site.skeleton, LearningSettings(site.interval_s), clock
        )
        stack.callback(learner.close)
    idle_modes = [camera.idle_mode for camera in site.cameras.values()]
    budgets = zip(parts.budgets, pipeline.queue.budget.tolist(), strict=True)
    ledger = EnergyLedger(
        site.rig.camera_ids,
        site.plan.profiles,
        idle_modes,
        [own or Budget("duty", share) for own, share in budgets],
        site.interval_s,
        site.loop.num_selected or 0.0,
        clock.now_ns,
        None if sink is None else sink.energy,
        [WH_J * (camera.battery_wh or np.inf) for camera in site.cameras.values()],
    )
    settings = EdgeSettings(
        site=site.file.name,
        skeleton=site.skeleton,
        known=site.known_joints,
        deadline_s=site.file.deadline_ms / 1e3,
        idle_modes=idle_modes,
        adaptive_lead=site.file.lead == "adaptive",
        pace=site.file.pace,
        smooth_delay_s=site.file.smooth_delay_ms / 1e3,
        publish_stored=site.file.store is not None and site.file.store.publish == "stored",
        wakes_s=[camera.wake_s for camera in site.cameras.values()],
    )
    noise = load_noise(site.loop.noise or site.detector)
    world = WorldCheck(site.rig, site.skeleton, noise, site.file.calibration)
    watch = DisplacementWatch(site.rig, world)
    consumers = Consumers(kept, learner, ledger, controls, recorder, watch, outbox)
    if kept is not None:
        consumers = replace(consumers, asks=kept.request)
    return EdgeServer(pipeline, transport, settings, clock, state_file, event_log, consumers)


def open_store(
    site: ResolvedSite, started_ns: int, event_log: EventLog, stack: ExitStack
) -> StoreWriter | None:
    """Return the store of a site; None if none is configured.

    Args:
        site: what its file says.
        started_ns: when the run began that its slots belong to.
        event_log: called with events of saving.
        stack: closes it.
    """
    if site.file.store is None:
        return None
    from e3pose.store import Retention, StoreWriter, WriterSettings
    from e3pose.store.writer import COMMIT_S, COMMIT_SOON_S

    run = Run(
        site=site.file.name,
        name=site.file.name,
        started_ns=started_ns,
        interval_s=site.interval_s,
        skeleton=site.skeleton.name,
        joints=site.skeleton.joints,
        cameras=site.rig.camera_ids,
        software=f"e3pose {__version__}",
        own_skeleton=own_file(site.skeleton),
    )
    keeping = WriterSettings(
        commit_s=COMMIT_S if site.file.store.publish == "at-once" else COMMIT_SOON_S,
        retention=Retention(site.file.store.keep_s, site.file.store.max_bytes),
        spool_bytes=site.file.store.spool_bytes,
        spool_beside=site.file.folder / site.file.name,
        one_writer=True,
        summaries=round(site.file.store.outbox_s / 60),
        titles=site.rig.titles,
    )
    return stack.enter_context(
        StoreWriter(site.file.store.place, run, keeping, report=event_log.add)
    )


def open_recorder(site: ResolvedSite, event_log: EventLog, stack: ExitStack) -> Recorder | None:
    """Return the recorder of a site; None if none is configured.

    Args:
        site: what its file says.
        event_log: called with reasons that it cannot record.
        stack: closes it.
    """
    cameras = [camera.record in ("keypoints", "both") for camera in site.cameras.values()]
    if not any(cameras):
        return None
    settings = RecorderSettings(
        folder=site.file.record.path,
        site=site.file.name,
        cameras=cameras,
        fps=site.file.fps,
        pace=site.file.pace,
        skeleton=site.skeleton,
        detector=site.named_detector,
        part_s=site.file.record.part_s or PART_S,
        max_bytes=site.file.record.max_bytes or MAX_BYTES,
        filmed=[name for name, camera in site.cameras.items() if camera.record == "both"],
        rotations=site.rotations,
    )
    recorder = Recorder(settings, site.rig, event_log.report)
    stack.callback(recorder.close)
    return recorder
