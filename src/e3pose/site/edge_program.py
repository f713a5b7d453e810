"""The program on the edge server: a site file in, a running `EdgeServer` out."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

from e3pose import __version__
from e3pose.clock import Clock
from e3pose.edge.server import EdgeServer
from e3pose.errors import InputError
from e3pose.files.lock import hold
from e3pose.files.private import make_folder
from e3pose.geometry.camera import Rig
from e3pose.model.noises import DEFAULT, SHIPPED
from e3pose.model.skeleton import Skeleton, skeleton_by_name
from e3pose.settings.edge import EdgeSettings
from e3pose.settings.loop import ReplaySettings, make_pipeline
from e3pose.settings.site_file import SiteTable, beside, cameras_of, store_place
from e3pose.store.rows import Event, Run
from e3pose.wire.access import Link, check_link, split_endpoint
from e3pose.wire.keys.folder import Roll, certificates_in, check_certificates, read_roll
from e3pose.wire.transport import Transport


@dataclass(frozen=True, slots=True)
class LivePlace:
    """Where a live loop runs; see `settings.loop.Place`."""

    rig: Rig
    skeleton: Skeleton
    interval_s: float
    detector: str
    source: str = ""


def edge_link(path: Path, site: SiteTable) -> tuple[Link, Roll | None]:
    """Return how the edge of a site joins, and who may join it.

    Raises:
        InputError: for an endpoint that is not safe, or certificates that cannot be used.
    """
    table, roll, certificates = site.link, None, None
    if split_endpoint(table.endpoint)[0] == "tls" and table.keys is not None:
        folder = beside(path, table.keys)
        roll = read_roll(folder)
        certificates = certificates_in(folder, "edge")
        check_certificates(certificates, datetime.datetime.now(datetime.timezone.utc))
    link = Link(
        "edge", site.name, table.endpoint, certificates, table.upstream, insecure=table.insecure
    )
    check_link(link)
    return link, roll


def place_of(path: Path, site: SiteTable, rig: Rig) -> LivePlace:
    """Return the place that a site file describes."""
    cameras = cameras_of(path, site, rig)
    detectors = {camera.detector for camera in cameras.values() if camera.detector}
    known = [name for name in SHIPPED if name in detectors]  # one noise serves all cameras
    return LivePlace(
        rig, skeleton_by_name(site.skeleton), 1 / site.fps, known[0] if known else DEFAULT
    )


def make_edge(
    path: Path,
    site: SiteTable,
    place: LivePlace,
    settings: ReplaySettings,
    transport: Transport,
    clock: Clock,
    tell: Callable[[Event], None],
    stack: ExitStack,
) -> EdgeServer:
    """Return the edge of a site, not yet started, with its store and its trainer.

    Args:
        path: of the site file.
        site: what it says.
        place: the cameras.
        settings: of the loop.
        transport: how to reach the cameras.
        clock: the edge's.
        tell: called with what a person should know.
        stack: closes what is opened here.
    """
    cameras = cameras_of(path, site, place.rig)
    checkpoint = beside(path, site.state) if site.state else None
    if checkpoint is not None:
        with suppress(OSError):  # told when the state is kept
            make_folder(checkpoint.parent)
        stack.enter_context(hold(checkpoint))
    edge_settings = EdgeSettings(
        site=site.name,
        joints=place.skeleton.joints,
        deadline_s=site.deadline_ms / 1e3,
        idle_modes=[camera.idle_mode for camera in cameras.values()],
        adaptive_lead=site.lead == "adaptive",
        checkpoint=checkpoint,
        pace=site.pace,
        smooth_delay_s=site.smooth_delay_ms / 1e3,
    )
    edge = EdgeServer(make_pipeline(place, settings), transport, edge_settings, clock, tell=tell)
    if site.store is not None:
        from e3pose.store import Retention, StoreWriter, WriterSettings, parse_age, parse_size
        from e3pose.store.database import database_path, database_url

        run = Run(
            site=site.name,
            name=site.name,
            started_ns=edge.run_ns,  # a state that goes on belongs to the run that it came from
            interval_s=place.interval_s,
            skeleton=place.skeleton.name,
            joints=place.skeleton.joints,
            cameras=place.rig.camera_ids,
            software=f"e3pose {__version__}",
        )
        retention = Retention(
            max_age_s=None if site.store.keep is None else parse_age(site.store.keep),
            max_bytes=None if site.store.max_size is None else parse_size(site.store.max_size),
        )
        store = store_place(path, site.store)
        if (file := database_path(database_url(store))) is not None:
            stack.enter_context(hold(file, site.name))  # other sites may share it

        def tell_of_store(event: Event) -> None:
            edge.events.append(event)  # the writer keeps it itself
            tell(event)

        edge.sink = stack.enter_context(
            StoreWriter(store, run, WriterSettings(retention=retention), tell=tell_of_store)
        )
    if site.learn is not None:
        from e3pose.learn.online import LearningSettings, OnlineTrainer

        trainer = OnlineTrainer(
            beside(path, site.learn), place.skeleton, LearningSettings(place.interval_s), clock
        )
        stack.callback(trainer.close)
        edge.learner = trainer
    return edge


@dataclass(slots=True, eq=False)
class Admission:
    """Lets in who was added and shuts out who was revoked, while the edge runs.

    Attributes:
        path: of the site file.
        site: what it says.
        server: of the edge.
        join: opens the network by the rules of a list.
        tell: called with a line that a person should know.
    """

    path: Path
    site: SiteTable
    server: EdgeServer
    join: Callable[[Link, Roll | None], Transport]
    tell: Callable[[str], None]
    _seen: tuple[int, int] = (0, 0)
    _refused: str = ""

    def __post_init__(self) -> None:
        self._seen = self._look()

    def look(self) -> None:
        """Join anew if the list of certificates is another one than at the last look."""
        seen = self._look()
        if seen == self._seen:
            return
        try:
            link, roll = edge_link(self.path, self.site)
            self.server.rejoin(lambda: self.join(link, roll))
        except InputError as error:  # tried again: the edge goes on by the rules it has
            if str(error) != self._refused:
                self.tell(f"the list of certificates changed, but: {error}")
            self._refused = str(error)
            return
        self._seen, self._refused = seen, ""
        self.tell("the list of certificates changed: joined anew")

    def _look(self) -> tuple[int, int]:
        if self.site.link.keys is None:
            return 0, 0
        try:
            status = (beside(self.path, self.site.link.keys) / "keys.toml").stat()
        except OSError:
            return self._seen  # being replaced
        return status.st_mtime_ns, status.st_ino
