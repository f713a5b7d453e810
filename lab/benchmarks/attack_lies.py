"""Cameras with valid keys that lie to a live site, and what the others got meanwhile."""

from __future__ import annotations

import math
import re
import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path

from attack_inputs import SECOND, Report, Result
from e3pose.base.clock import WallClock
from e3pose.camera.base import NodeSettings
from e3pose.camera.live import CameraNode
from e3pose.camera.live_source import RecordedSource
from e3pose.camera.pictures import Pictures
from e3pose.edge.camera_state import NEAR_S
from e3pose.edge.inbox import BEAT_S
from e3pose.edge.lead import FAR_S
from e3pose.recording import load_recording
from e3pose.settings.site_file import load_site
from e3pose.site.follow import Follower, viewer_link
from e3pose.site.up import end
from e3pose.site.web.feed import Feed
from e3pose.site.web.pictures import CameraPictures
from e3pose.site.web.program import PICTURE_S
from e3pose.store import Store
from e3pose.wire.access import Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import add_keys, certificates_in
from e3pose.wire.messages import View
from e3pose.wire.network import NetworkTransport, open_network
from e3pose.wire.site_messages import Picture, Poses, Status
from e3pose.wire.topics import of_camera
from lies import (
    HONEST,
    KINDS,
    Lie,
    LyingTransport,
    picture_schemes,
    schemes,
    swept,
)
from live_site import Site, live_site, wait

CAMERAS, FPS = 5, 25.0
DESK, ADMITTED_S, SHOWN_S = "desk", 6.0, 4.0  # an operator, until it is admitted; each lie
LEAST_S = 6.0  # for a lie
NOTICED_S = 3.0  # until the edge has noticed it; what a site gives is measured from then on
PAUSE_S = 1.0  # of honesty between two
DISTRUSTED_S = 60.0  # at most, of cameras that answered no orders
LATENCY_S = 0.02  # more than without lies, on a machine that does other things too
MORE_LEAD = 2  # slots more than without lies
VIEWS_SHARE, POSES_SHARE = 0.8, 0.9  # of those without lies
USUAL_S = 6.0  # in which it is measured what comes without lies
MUST = (
    f"as without the liar: {POSES_SHARE:.0%} of the poses, {VIEWS_SHARE:.0%} of the honest views, "
    f"all people, at most {1000 * LATENCY_S:.0f} ms later, {MORE_LEAD} slots and {FAR_S:g} s ahead"
)


@dataclass
class Seen:
    """Poses and statuses that a viewer received.

    Attributes:
        poses: time of arrival, slot, seconds from the middle of the slot, people, and the cameras
            whose views are in them.
        statuses: time of arrival and status.
    """

    poses: list[tuple[float, int, float, int, tuple[str, ...]]] = field(default_factory=list)
    statuses: list[tuple[float, Status]] = field(default_factory=list)

    def take_poses(self, poses: Poses) -> None:
        late_s = (poses.published_edge_ns - poses.time_edge_ns) / 1e9
        people = poses.track_ids.shape[0]
        self.poses.append((time.monotonic(), poses.slot, late_s, people, poses.arrived))

    def take_status(self, status: Status) -> None:
        self.statuses.append((time.monotonic(), status))


@contextmanager
def viewer(site: Site) -> Iterator[Seen]:
    """Follow a site as a viewer does."""
    seen, follower = Seen(), Follower("bench")
    transport = open_network(viewer_link(load_site(site.folder / "site.toml"), None))
    follower.listen(transport, seen.take_poses, seen.take_status)
    try:
        yield seen
    finally:
        transport.close()


@dataclass(frozen=True)
class Got:
    """Figures of honest cameras over a stretch of time.

    Attributes:
        poses: with a view, per second.
        views: of honest cameras in these.
        latency_s: median from the middle of a slot to its poses.
        people: median.
        lead: the longest.
        deficit: the largest of an honest camera.
    """

    poses: float
    views: float
    latency_s: float
    people: float
    lead: int
    deficit: float

    def or_worse(self, other: Got) -> Got:
        """Return the worse of what came in two whiles, by what a lie may cost."""
        least, most = (
            {name: pick(getattr(self, name), getattr(other, name)) for name in names}
            for pick, names in ((min, ("poses", "views", "people")), (max, ("latency_s", "lead")))
        )
        return replace(self, **least, **most)

    def summary(self) -> str:
        return (
            f"{self.poses:.1f} poses per second with {self.views:.2f} honest views, "
            f"{1000 * self.latency_s:.0f} ms after their slot, {self.people:.0f} people, "
            f"lead {self.lead}, deficit {self.deficit:.0f}"
        )


def got(seen: Seen, honest: set[str], since_s: float, until_s: float) -> Got:
    """Return the figures between two times."""
    poses = [each for each in list(seen.poses) if since_s <= each[0] < until_s]
    statuses = [status for at_s, status in list(seen.statuses) if since_s <= at_s < until_s + 1.0]
    with_views = [each for each in poses if each[4]]
    return Got(
        poses=len(with_views) / (until_s - since_s),
        views=statistics.mean([len(honest & set(each[4])) for each in poses] or [0]),
        latency_s=statistics.median([each[2] for each in poses] or [math.inf]),
        people=statistics.median([each[3] for each in poses] or [0]),
        lead=max((status.lead for status in statuses), default=0),
        deficit=max(
            (c.deficit for s in statuses for c in s.cameras if c.camera_id in honest), default=0.0
        ),
    )


@contextmanager
def liars(site: Site, camera_ids: list[str]) -> Iterator[list[LyingTransport]]:
    """Run cameras of a site in this process, whose words can be changed."""
    recording, clock = load_recording(site.folder / "recording"), WallClock()
    port = load_site(site.folder / "site.toml").link.endpoint.port
    transports, nodes = [], []
    for camera_id in camera_ids:
        files = certificates_in(site.folder / "keys" / "cameras" / camera_id, "camera")
        network: NetworkTransport = open_network(
            Link("camera", "bench", read_endpoint(f"tls/localhost:{port}"), files)
        )
        transport = LyingTransport(network)
        settings = NodeSettings("bench", camera_id, recording.skeleton.joints)
        source = RecordedSource(recording, camera_id, clock)
        pictures = Pictures(camera_id, clock)
        nodes.append(CameraNode(settings, source, None, transport, clock, pictures=pictures))
        transports.append(transport)
    for node in nodes:
        node.start()
    try:
        yield transports
    finally:
        for node in nodes:
            node.stop()


def lies_to_tell(seconds: float) -> list[tuple[Lie, float]]:
    """Return lies, and how long each is told: schemes, and the fields of each message."""
    fields = [swept(kind) for kind in KINDS.values() if kind is not Picture]
    told = schemes()
    each_s = max(LEAST_S, seconds / 2 / (len(told) + 2 * len(fields)) - PAUSE_S)
    # Cameras that bring no views are distrusted for a while, and their next lies without effect.
    first = [(lie, each_s) for lie in told if View not in lie.changes]
    last = [(lie, each_s) for lie in told if View in lie.changes]
    return [*first, *((lie, 2 * each_s) for lie in fields), *last]


def tell(seconds: float, words: str, report: Report) -> None:
    """Tell every lie to a site of five cameras, with one liar and with two.

    Args:
        seconds: for all of them, about.
        words: pattern of the lies to tell.
        report: called with each result.
    """
    with (
        live_site(cameras=CAMERAS, people=3, fps=FPS, spare=2, record=True) as site,
        viewer(site) as seen,
    ):
        ids = [f"cam{index}" for index in range(CAMERAS)]
        with liars(site, ids[-2:]) as transports:
            online_by_s = time.monotonic() + 30.0
            while time.monotonic() < online_by_s and not all(
                camera.online for camera in seen.statuses[-1][1].cameras
            ):
                wait(0.2)
            wait(5.0)
            for number in (1, 2):
                _while_distrusted(seen, set(ids[-2:]))
                honest = set(ids[: CAMERAS - number])
                usual = _while(transports, HONEST, number, USUAL_S, seen, honest)
                silent = Lie("gone", dict.fromkeys(KINDS.values(), lambda message, n, dice: None))
                gone = _while(transports, silent, number, USUAL_S, seen, honest)
                for one, which in ((usual, "honest"), (gone, "gone")):
                    said = f"{number} liars, {which}"
                    report(Result(said, one.summary(), one.poses > 0, "poses come"))
                _while(transports, HONEST, number, 4.0, seen, honest)
                for lie, each_s in lies_to_tell(seconds):
                    if not re.search(words, name := f"{number} liars, {lie.name}"):
                        continue
                    for again in (False, True):
                        before = usual
                        if again:  # other programs may have taken the cores
                            now = _while(transports, HONEST, number, USUAL_S, seen, honest)
                            before = usual.or_worse(now)
                        found = _while(transports, lie, number, each_s, seen, honest)
                        _while(transports, HONEST, number, PAUSE_S, seen, honest)
                        held = _held(found, before, gone.or_worse(before))
                        said = f"{name}{SECOND}" if again else name
                        kept = found.poses / max(before.poses, 1e-9)
                        result = Result(said, found.summary(), held, MUST, kept)
                        report(replace(result, again=not held and not again))
                        if held:
                            break
            show(site, ids[-2:], transports, seen, words, report)
        _kept(site, seen, ids[:3], report)


def show(
    site: Site,
    camera_ids: list[str],
    transports: list[LyingTransport],
    seen: Seen,
    words: str,
    report: Report,
) -> None:
    """Ask two cameras for pictures as the page does, while the second one lies about its own."""
    add_keys(site.folder / "keys", DESK, datetime.now(timezone.utc), kind="operator")
    wait(ADMITTED_S)
    table = load_site(site.folder / "site.toml")
    transport = open_network(viewer_link(table, site.folder / "keys" / "operators" / DESK))
    feed, rig = Feed("bench"), load_recording(site.folder / "recording").rig
    feed.listen(transport)

    def pictures(camera_id: str) -> CameraPictures:
        topic, camera = of_camera("bench", camera_id, "picture"), rig.cameras[rig.index(camera_id)]
        return CameraPictures(
            camera, feed, lambda asked: transport.ask(topic, asked, PICTURE_S), 1 / FPS, 10.0
        )

    must = f"the other camera is shown, the liar never, {POSES_SHARE:.0%} of the poses just before"
    for lie in [*picture_schemes(), swept(Picture)]:
        if not re.search(words, lie.name):
            continue
        usual = _while(transports, HONEST, 1, SHOWN_S, seen, {camera_ids[0]})
        honest, liar = map(pictures, camera_ids)
        transports[-1].lie, begun_s, shown, false = lie, time.monotonic(), 0, 0
        while time.monotonic() < begun_s + SHOWN_S:
            false += bool(liar.newest("", False)["jpeg"])
            shown += bool(honest.newest("", False)["jpeg"])
            wait(0.1)
        found = got(seen, {camera_ids[0]}, begun_s, time.monotonic())
        said = (
            f"{found.poses:.1f} poses per second of {usual.poses:.1f}; the other camera shown "
            f"{shown} times, the liar {false} times, "
            f"{liar.newest('', False)['why'] or 'without a reason'}"
        )
        harmless = lie.name.startswith("every")  # some extremes are what honest cameras say
        held = found.poses > POSES_SHARE * usual.poses and shown > 0 and (harmless or not false)
        report(Result(lie.name, said, held, must, found.poses / max(usual.poses, 1e-9)))
    transports[-1].lie = HONEST
    transport.close()


def _while_distrusted(seen: Seen, camera_ids: set[str]) -> None:
    """Wait until the views of some cameras are used, as those of honest ones are."""
    end_s = time.monotonic() + DISTRUSTED_S
    while time.monotonic() < end_s:
        used = [used for at_s, *_, used in seen.poses[-250:] if at_s > time.monotonic() - 2.0]
        if camera_ids <= {camera_id for each in used for camera_id in each}:
            return
        wait(0.5)


def _while(
    transports: list[LyingTransport],
    lie: Lie,
    number: int,
    seconds: float,
    seen: Seen,
    honest: set[str],
) -> Got:
    for transport in transports[-number:]:
        transport.lie = lie
    begun_s = time.monotonic()
    wait(seconds)
    found = got(seen, honest, begun_s + min(NOTICED_S, seconds / 2), time.monotonic())
    for transport in transports:
        transport.lie = HONEST
    return found


def _held(found: Got, usual: Got, gone: Got) -> bool:
    """Return whether a lie costs no more than the liar's absence; a slow link may be tried."""
    more = MORE_LEAD + math.ceil(FAR_S * FPS)
    return (
        found.poses >= POSES_SHARE * min(usual.poses, gone.poses)
        and found.views >= VIEWS_SHARE * min(usual.views, gone.views)
        and found.latency_s <= max(usual.latency_s, gone.latency_s) + LATENCY_S
        and found.people >= min(usual.people, gone.people)
        and found.lead <= max(usual.lead, gone.lead) + more
    )


def _kept(site: Site, seen: Seen, honest: list[str], report: Report) -> None:
    """Look at what the site has kept: store and recordings."""
    slots = [slot for _, slot, _, _, _ in seen.poses]
    wait(2.0)
    store = Store(site.folder / "poses.db")
    stored = [row["slot"] for row in store.rows("slots")]
    span = max(stored) - min(stored) + 1
    lost = seen.statuses[-1][1].slots_lost
    words = f"{len(stored)} of {span} slots stored, {lost} skipped by the edge"
    held = len(stored) + lost >= 0.99 * span and max(stored) >= slots[-1]
    report(Result("store of a site with liars", words, held, "99 % of all slots stored"))
    rows = list(store.rows("energy"))
    times = [row["time_ns"] for row in store.rows("slots")]
    away_s = max(((row["time_ns"] - max(times)) / 1e9 for row in rows), default=0.0)
    most = CAMERAS * (max(times) - min(times)) / 1e9 / BEAT_S
    words = f"{len(rows)} rows of energy, the newest {away_s:+.1f} s from the newest slot"
    held, must = away_s <= 2 * NEAR_S and len(rows) <= most, f"at most {most:.0f} rows, none ahead"
    report(Result("store of energy with liars", words, held, must))
    end(site.programs[:1])  # which finishes the recording
    views = {camera_id: 0 for camera_id in honest}
    for part in sorted((site.folder / "recordings").glob("*/recording.toml")):
        recording = load_recording(Path(part).parent)
        for camera_id in honest:
            views[camera_id] += len(recording.views[recording.rig.index(camera_id)].slots)
    arrived = sum(len(set(honest) & set(each[4])) for each in seen.poses)
    words = f"{sum(views.values())} views of honest cameras recorded, {arrived} seen in poses"
    held = sum(views.values()) >= arrived > 0
    report(Result("recordings with liars", words, held, "every view that arrived"))
