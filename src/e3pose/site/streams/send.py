"""The thread that forwards slots from a connection to streams."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import TypeVar

from e3pose.base.errors import InputError, reason_of
from e3pose.events import watch as watching
from e3pose.events.watch import Watch
from e3pose.model.person_event import PersonEvent
from e3pose.model.zone_event import ZoneEvent
from e3pose.site.connect import Connection, LiveSlot
from e3pose.site.streams.base import Stream, TellsCameras, TellsPeople, Unavailable
from e3pose.site.zones import Zones, advance
from e3pose.wire.site_messages import Status

END_S = 5.0
RETRY_S = 10.0  # between two tries to open a stream
# What opening a stream raises where its target cannot be had now; RuntimeError is LSL's.
UNAVAILABLE = (Unavailable, OSError, RuntimeError)
T = TypeVar("T")


def _send(slot: LiveSlot, events: Sequence[ZoneEvent], stream: Stream) -> None:
    stream.slot(slot)
    for event in events:
        stream.zone(event)


class Awaited:
    """A stream whose target cannot be had yet, and is tried again until it can; see `Stream`.

    Attributes:
        reason: why it could not be opened at first.
    """

    def __init__(
        self, open_stream: Callable[[], Stream], reason: str, report: Callable[[str], object]
    ) -> None:
        """Try on a thread.

        Args:
            open_stream: opens it; raises one of `UNAVAILABLE`.
            reason: why it could not be opened.
            report: called with a line once it is.
        """
        self.reason = reason
        self._open, self._report = open_stream, report
        self._stream: Stream | None = None
        self._lock, self._closed = threading.Lock(), threading.Event()
        threading.Thread(target=self._try, name="stream-open", daemon=True).start()

    @property
    def problem(self) -> str:
        """Why it sends nothing, or the problem of the stream once there is one."""
        stream = self._stream
        return self.reason if stream is None else getattr(stream, "problem", "")

    def slot(self, slot: LiveSlot) -> None:
        """See `Stream.slot`."""
        if self._stream is not None:
            self._stream.slot(slot)

    def zone(self, event: ZoneEvent) -> None:
        """See `Stream.zone`."""
        if self._stream is not None:
            self._stream.zone(event)

    def people(self, watch: Watch, events: Sequence[PersonEvent]) -> None:
        """See `TellsPeople.people`."""
        if isinstance(self._stream, TellsPeople):
            self._stream.people(watch, events)

    def cameras(self, status: Status) -> None:
        """See `TellsCameras.cameras`."""
        if isinstance(self._stream, TellsCameras):
            self._stream.cameras(status)

    def close(self) -> None:
        """See `Stream.close`."""
        with self._lock:
            self._closed.set()
        if self._stream is not None:
            self._stream.close()

    def _try(self) -> None:
        while not self._closed.wait(RETRY_S):
            with suppress(*UNAVAILABLE):
                opened = self._open()
                with self._lock:
                    if self._closed.is_set():
                        opened.close()
                    else:
                        self._stream = opened
                        self._report(f"open now: {self.reason}")
                return


class Sender:
    """Sends until it is closed; use it as a context manager.

    Attributes:
        sent: slots.
        first_s: when the first was sent, monotonic time; None before.
        failure: what ended it.
        report: called with why nothing comes.
    """

    def __init__(
        self,
        connection: Connection,
        streams: Sequence[Stream],
        zones: Zones,
        report: Callable[[str], object] = lambda line: None,
        watch: Watch | None = None,
    ) -> None:
        """Prepare to send.

        Args:
            connection: whose slots to send; closed to end it.
            streams: where to.
            zones: of the site, empty.
            report: called with why nothing comes, once each time it ceases to come.
            watch: follows what people do, for streams that tell it.
        """
        self.report = report
        self.sent = 0
        self.first_s: float | None = None
        self.failure: BaseException | None = None
        self._connection, self._streams, self._zones = connection, streams, zones
        self._telling = [stream for stream in streams if isinstance(stream, TellsPeople)]
        self._about_cameras = [stream for stream in streams if isinstance(stream, TellsCameras)]
        self._status: Status | None = None
        self._watch = watch if self._telling else None
        self._faults = set[object]()  # of streams and rules that fail at present
        self._thread = threading.Thread(target=self._run, name="stream", daemon=True)

    def __enter__(self) -> Sender:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()
        self._thread.join(END_S)

    @property
    def site(self) -> str:
        """Name of the site."""
        return self._connection.site

    def running(self) -> bool:
        """Return whether it still sends, or waits for the edge."""
        return self._thread.is_alive()

    def _tell(self, slot: LiveSlot) -> None:
        """Hand states and events of people to the streams."""
        if self._watch is None:
            return
        self._watch, events = watching.advance(self._watch, slot)
        for kind in self._watch.rules:
            self._note(kind, f"event {kind}", self._watch.faults.get(kind, ""))
        watch = self._watch
        self._each(self._telling, "people", lambda stream: stream.people(watch, events))

    def _tell_cameras(self) -> None:
        """Tell how cameras are, when that is new."""
        status = self._connection.newest_status
        if status is not None and status is not self._status:
            self._status = status
            self._each(self._about_cameras, "cameras", lambda stream: stream.cameras(status))

    def _each(self, streams: Sequence[T], what: str, send: Callable[[T], object]) -> None:
        """Send to each stream: where there are several, one that fails does not end the others."""
        for stream in streams:
            why = ""
            try:
                send(stream)
            except Exception as error:
                if len(self._streams) == 1:
                    raise  # the program ends with it
                why = f"{type(error).__name__}: {reason_of(error)[:200]}"
            self._note((stream, what), type(stream).__name__, why)

    def _note(self, who: object, name: str, why: str) -> None:
        """Report a fault once, as long as it lasts."""
        if why and who not in self._faults:
            self.report(f"{name}: left out ({why}), the others go on")
        (self._faults.add if why else self._faults.discard)(who)

    def _run(self) -> None:
        silent = False
        while True:
            try:
                for slot in self._connection:
                    silent = False
                    self._zones, events = advance(self._zones, slot)
                    self._each(self._streams, "slots", partial(_send, slot, events))
                    self._tell_cameras()
                    self._tell(slot)
                    self.sent += 1
                    self.first_s = self.first_s or time.monotonic()
                return
            except InputError as error:  # the edge is away: it comes back
                if not silent:
                    self.report(str(error))
                silent = True
            except BaseException as error:  # the program must end with it
                self.failure = error
                return
