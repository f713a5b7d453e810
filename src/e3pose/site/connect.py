"""Follow a running site from Python, slot by slot as arrays."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from e3pose.base.errors import MISSING, InputError
from e3pose.events.people import Seen
from e3pose.events.watch import Watch, advance, begin_watch
from e3pose.model.people import People
from e3pose.model.person_event import PersonEvent
from e3pose.model.skeleton import skeleton_of_joints
from e3pose.model.take import Take, motions_of
from e3pose.settings.events_table import EventsTable
from e3pose.settings.site_file import SiteTable, ZoneTable, load_site
from e3pose.site.follow import Follower, viewer_link
from e3pose.wire.access import Link
from e3pose.wire.arrays import people_of
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import valid_certificates
from e3pose.wire.site_messages import Poses, Status
from e3pose.wire.transport import Transport

MAX_WAITING = 1000  # slots that nobody has taken yet; older ones are dropped
WAIT_S = 10.0
EVERY_KIND = EventsTable()
Names = Callable[[int], str]  # of people, by track; empty where one has none


def no_name(track: int) -> str:
    """Return no name."""
    return ""


@dataclass(frozen=True, slots=True, eq=False)
class LiveSlot(Seen):
    """The people of one slot, as an edge published them.

    Attributes:
        joints: `(num_joints,)` names of the joint axis.
        selected: cameras that were ordered to be active.
        arrived: those whose views the poses are made from.
        published_ns: when the edge sent it, by the same clock as `time_ns`, the middle of the slot.
        blind: why no view arrived although one was due, such as `orders-late`; empty otherwise.
        stored_from: oldest slot of this edge program that its store holds or is to hold; -1 where
            nothing is stored yet.
        stored_to: the store holds all slots from there to this one; none while it is smaller.
        store_shed: records that the store gave up since the edge was started.
        delay_ms: how much later it was published, smoothed with the slots in between; 0 at once.
    """

    joints: tuple[str, ...]
    selected: tuple[str, ...]
    arrived: tuple[str, ...]
    published_ns: int
    blind: str = ""
    stored_from: int = -1
    stored_to: int = -1
    store_shed: int = 0
    delay_ms: float = 0.0

    def __len__(self) -> int:
        """Return how many people there are."""
        return len(self.people)


def live_slot(poses: Poses) -> LiveSlot:
    """Return a message of the edge as arrays; it must have been checked by `decode`."""
    return LiveSlot(
        poses.slot,
        poses.time_edge_ns,
        people_of(poses),
        poses.joints,
        poses.selected,
        poses.arrived,
        poses.published_edge_ns,
        poses.blind,
        poses.stored_from,
        poses.stored_to,
        poses.store_shed,
        poses.delay_ms,
    )


def take_of_slots(slots: Sequence[LiveSlot], interval_s: float, name: str = "live") -> Take:
    """Return slots as a take, in which each person has arrays over time.

    Args:
        slots: in any order, each once, with the same joints; one at least.
        interval_s: seconds per slot.
        name: of the take.

    Raises:
        InputError: without slots, or for a slot that comes twice.
    """
    if not slots:
        raise InputError("slots", "none", "one at least")
    first, skeleton = slots[0], skeleton_of_joints(slots[0].joints)
    numbers = np.repeat([slot.slot for slot in slots], [len(slot) for slot in slots])
    people = People.joined([slot.people for slot in slots], len(skeleton))
    started_ns = first.time_ns - round(first.slot * interval_s * 1e9)
    return Take(name, skeleton, interval_s, motions_of(numbers, people), started_ns)


class Connection:
    """A site that is followed; use it as a context manager, and iterate over it for its slots.

    Attributes:
        site: its name.
        dropped: slots that came while `MAX_WAITING` waited to be taken.
    """

    def __init__(
        self,
        site: str,
        transport: Transport,
        wait_s: float = WAIT_S,
        delayed: bool = False,
        told: EventsTable = EVERY_KIND,
        zones: Sequence[ZoneTable] = (),
        names: Names = no_name,
    ) -> None:
        """Follow a site.

        Args:
            site: its name.
            transport: how to reach its edge; closed with the connection.
            wait_s: how long to wait for the edge at most; it may be away for less.
            delayed: follow the smoothed poses that come later, in place of those at once.
            told: which events of people `events` yields.
            zones: of the site, for these events.
            names: of people, for these events.
        """
        self._told, self._zones, self._names = told, tuple(zones), names
        self.site, self.dropped = site, 0
        self._transport, self._wait_s = transport, wait_s
        self._follower = Follower(site, delayed=delayed)
        self._slots: queue.Queue[LiveSlot | None] = queue.Queue(MAX_WAITING)
        self._follower.listen(transport, lambda poses: self._keep(live_slot(poses)))

    def __enter__(self) -> Connection:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _keep(self, slot: LiveSlot | None) -> None:
        while True:
            try:
                return self._slots.put_nowait(slot)
            except queue.Full:
                with suppress(queue.Empty):
                    self._slots.get_nowait()
                    self.dropped += slot is not None

    def __iter__(self) -> Iterator[LiveSlot]:
        """Yield slots in order as they arrive, until the connection is closed.

        Raises:
            InputError: when none comes for `wait_s` seconds.
        """
        while (slot := self.next()) is not None:
            yield slot

    def next(self) -> LiveSlot | None:
        """Wait for the next slot; None once the connection is closed.

        Raises:
            InputError: when none comes in time, naming why where that is known.
        """
        try:
            return self._slots.get(timeout=self._wait_s)
        except queue.Empty:
            said = self._follower.problem
            why = f" ({said})" if said else ""
            if self._follower.delayed:
                why += ": the edge smooths none, unless smooth_delay_ms or --delay says so"
            raise InputError(
                f"site {self.site}: no slot for {self._wait_s:g} s{why}: check that the edge runs "
                "and cameras are online (`e3pose top`), the endpoint, the site name and the keys"
            ) from None

    def events(self) -> Iterator[PersonEvent]:
        """Yield events of people as they happen, until the connection is closed.

        What `[events]` and the zones of the site file say, where the connection was made with one;
        otherwise events of every kind, with their usual settings. It takes the slots.

        Raises:
            InputError: when no slot comes for `wait_s` seconds.
        """
        watch: Watch | None = None
        for slot in self:
            watch = watch or begin_watch(self._told, slot.joints, self._zones)
            watch, events = advance(watch, slot)
            yield from (called(event, self._names) for event in events)

    def newest(self) -> LiveSlot:
        """Return the newest slot and skip older ones; wait for one if there is none."""
        slot = self.next()
        while not self._slots.empty():
            slot = self.next()
        if slot is None:
            raise InputError(f"site {self.site}", "a closed connection", "an open one")
        return slot

    @property
    def newest_status(self) -> Status | None:
        """The newest status of the site; None before the first."""
        return self._follower.status

    def status(self) -> Status:
        """Return how the site is, as `e3pose top` shows it; waits for the first status.

        Raises:
            InputError: when none comes in time.
        """
        if not self._follower.fresh.wait(self._wait_s) or self._follower.status is None:
            raise InputError(f"site {self.site}", f"no status in {self._wait_s:g} s", "an edge")
        return self._follower.status

    def take(self, seconds: float) -> Take:
        """Record for `seconds`; return the people with arrays over time.

        Args:
            seconds: of the edge's time.

        Raises:
            InputError: when slots stop to come.
        """
        slots: list[LiveSlot] = []
        for slot in self:
            slots.append(slot)
            if slot.time_ns - slots[0].time_ns >= seconds * 1e9:
                break
        if len(slots) < 2:
            raise InputError("seconds", f"{seconds:g}", "more than one slot")
        spans = (slots[-1].time_ns - slots[0].time_ns, slots[-1].slot - slots[0].slot)
        return take_of_slots(slots, spans[0] / max(spans[1], 1) / 1e9, self.site)

    def close(self) -> None:
        """Leave the site; waiting calls return None."""
        self._transport.close()
        self._keep(None)


def connect(
    place: str | Path,
    *,
    site: str | None = None,
    keys: Path | str | None = None,
    wait_s: float = WAIT_S,
    delayed: bool = False,
) -> Connection:
    """Follow a running site: iterate over the connection for its slots.

        with e3pose.connect("tls/edge.local:7447", keys="wall") as site:
            for slot in site:
                print(slot.slot, slot.people.track_ids, slot.people.joints_m[:, 0])

    Args:
        place: `tls/HOST:PORT` or `tcp/HOST:PORT` of the edge; or a site file or its folder.
        site: name of the site; with `tls` that of the certificate by default.
        keys: folder from `e3pose keys add NAME --viewer`, for `tls`.
        wait_s: how long to wait for a slot before an error.
        delayed: follow the smoothed poses that the edge publishes later (`smooth_delay_ms`), in
            place of those at once.

    Raises:
        InputError: for an endpoint, a name or certificates that cannot be used.
    """
    from e3pose.wire.network import open_network

    folder = None if keys is None else Path(keys)
    if Path(place).exists():
        table = load_site(Path(place))
        link, told = viewer_link(table, folder), table.events or EVERY_KIND
        names = names_for(table, "python")
        return Connection(link.site, open_network(link), wait_s, delayed, told, table.zone, names)
    endpoint, certificates = read_endpoint(str(place), "endpoint"), None
    if endpoint.encrypted:
        if folder is None:
            wanted = 'keys="NAME", the folder of `e3pose keys add NAME --viewer`'
            raise InputError("keys", MISSING, wanted)
        certificates = valid_certificates(folder, "viewer")
        site = site or certified_site(certificates.authority)
    if site is None:
        raise InputError("site", MISSING, 'site="NAME", as `name` in the site file')
    link = Link("viewer", site, endpoint, certificates)
    return Connection(site, open_network(link), wait_s, delayed)


def certified_site(authority: Path) -> str:
    """Return the site whose authority signed a certificate.

    Raises:
        InputError: when the certificate does not say it in full.
    """
    from e3pose.wire.keys.authority import SUBJECT, UNREADABLE, common_name

    try:
        name = common_name(authority.read_bytes())
    except UNREADABLE:
        raise InputError(str(authority), "no certificate", "that of the site's authority") from None
    if len(name) >= 64:  # it may have been cut
        raise InputError("site", MISSING, 'site="NAME", as `name` in the site file')
    return name.removeprefix(SUBJECT)


def called(event: PersonEvent, names: Names) -> PersonEvent:
    """Return an event with the name of its person, also where the number has changed since."""
    return replace(event, name=names(event.track) or names(event.first))


def names_for(site: SiteTable, where: str) -> Names:
    """Return the names of a site's people, as its store has them at each moment.

    Nobody's where `[events]` does not list `where` in its `names`, or the site has no store.
    """
    if site.events is None or where not in site.events.names or site.store is None:
        return no_name
    from e3pose.store.names import StoredNames

    return StoredNames(site.store.place, site.name)
