"""The Protocol of a stream: slots and zone events in, messages out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from e3pose.base.errors import InputError
from e3pose.events.watch import Watch
from e3pose.model.person_event import PersonEvent
from e3pose.model.skeleton import Skeleton
from e3pose.model.zone_event import ZoneEvent
from e3pose.settings.events_table import EventsTable
from e3pose.site.connect import LiveSlot, Names, no_name
from e3pose.wire.endpoint import read_host_port
from e3pose.wire.site_messages import Status


@dataclass(frozen=True, slots=True)
class Source:
    """The site, joints and names that a stream sends.

    Attributes:
        site: name of the site.
        skeleton: of the joints.
        fps: slots per second.
        report: called with lines for operators.
        cameras: their names.
        zones: names of the zones.
        kinds: of the events that are told.
        told: what the site file says of them.
        titles: what people call cameras, by name; its name where one is not there.
        names: of people, by track; nobody's where the stream may not tell them.
    """

    site: str
    skeleton: Skeleton
    fps: float
    report: Callable[[str], object] = lambda line: None
    cameras: tuple[str, ...] = ()
    zones: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    told: EventsTable = field(default_factory=EventsTable)
    titles: Mapping[str, str] = field(default_factory=dict)
    names: Names = no_name


@runtime_checkable
class TellsPeople(Protocol):
    """A stream that also takes states and events of people."""

    def people(self, watch: Watch, events: Sequence[PersonEvent]) -> None:
        """Take the states of people after a slot, and its events."""
        ...


@runtime_checkable
class TellsCameras(Protocol):
    """A stream that also takes the status of cameras."""

    def cameras(self, status: Status) -> None:
        """Take a new status of the site."""
        ...


class Unavailable(InputError):
    """A target that is well named and cannot be had now: a broker that is away, a port in use."""


class Stream(Protocol):
    """Send slots and zone events. Data that cannot be sent now are lost; nothing queues."""

    def slot(self, slot: LiveSlot) -> None:
        """Send the people of a slot."""
        ...

    def zone(self, event: ZoneEvent) -> None:
        """Send a zone event."""
        ...

    def close(self) -> None:
        """End; a file is complete then."""
        ...


def host_port(place: str, usual_port: int) -> tuple[str, int]:
    """Return host and port of `HOST[:PORT]`.

    Raises:
        InputError: for anything else.
    """
    words = place if ":" in place.rpartition("]")[2] else f"{place}:{usual_port}"
    return read_host_port(words, "target", f"127.0.0.1:{usual_port}").address
