"""A webhook: one signed HTTP POST for each event of people, tried again until it is delivered.

Body: the record of the event as JSON, with the name of the site and an `id` that the notice keeps
when it is tried again. Header: `E3pose-Signature: t=SECONDS,v1=HEX`, where HEX is the HMAC-SHA256
of `SECONDS.BODY` by the secret in the file that `E3POSE_WEBHOOK_SECRET_FILE` names.
"""

from __future__ import annotations

import hashlib
import hmac
import http.client
import json
import math
import os
import random
import secrets
import socket
import ssl
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from urllib.parse import SplitResult, urlsplit

from e3pose.base.errors import MISSING, InputError
from e3pose.base.private import read_secret
from e3pose.base.quantities import plural
from e3pose.events.watch import Watch
from e3pose.model.person_event import PersonEvent
from e3pose.model.zone_event import ZoneEvent
from e3pose.site.connect import LiveSlot
from e3pose.site.streams.as_json import event_words
from e3pose.site.streams.base import Source
from e3pose.wire.endpoint import is_loopback

SECRET = "E3POSE_WEBHOOK_SECRET_FILE"
LEAST_SECRET = 16  # characters
SIGNATURE = "E3pose-Signature"
MAX_WAITING = 100
MAX_POSTS = 2 * MAX_WAITING  # at once: also of notices that were given up meanwhile
SOON_S = 0.2
END_S = 5.0  # for what waits when the stream ends
AGAIN = (408, 425, 429)  # of the answers below 500, those that may be others later


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """Limits of the attempts to deliver a notice.

    Attributes:
        answer_s: one attempt may take, from its connection to the status of its answer.
        first_s: until the second attempt; each further one waits twice as long.
        most_s: between two attempts.
        give_up_s: after which a notice is given up.
    """

    answer_s: float = 10.0
    first_s: float = 1.0
    most_s: float = 60.0
    give_up_s: float = 900.0

    def wait_s(self, attempts: int) -> float:
        """Return the wait after a number of attempts, half of it random."""
        longest_s = min(self.first_s * 2.0 ** min(attempts - 1, 20), self.most_s)
        return longest_s * random.uniform(0.5, 1.0)


@dataclass(slots=True, eq=False)
class Notice:
    """One event to send; its times are monotonic.

    Attributes:
        event: to tell.
        urgent: whether it goes before others.
        since_s: when it was reported.
        due_s: when to try it next; infinite while an attempt goes on.
        attempts: that have begun.
        failed: whether the last one did.
    """

    event: PersonEvent
    urgent: bool
    since_s: float
    due_s: float
    attempts: int = 0
    failed: bool = False


class Notices:
    """The notices that wait, each with a clock of its own: none waits for another.

    Attributes:
        waiting: in the order in which they were reported, also those being tried.
        retry: limits of the attempts.
    """

    def __init__(self, retry: RetryPolicy) -> None:
        """Begin without any."""
        self.waiting: list[Notice] = []
        self.retry = retry

    def add(self, event: PersonEvent, urgent: bool, now_s: float) -> Notice | None:
        """Let a notice wait; return the one without room: the oldest of the least urgent."""
        self.waiting.append(Notice(event, urgent, now_s, now_s))
        if len(self.waiting) <= MAX_WAITING:
            return None
        out = min(self.waiting, key=lambda one: one.urgent)
        self.waiting.remove(out)
        return out

    def due(self, now_s: float, room: int = MAX_POSTS) -> list[Notice]:
        """Return those to try now, urgent and new ones first; each until `tried` is called."""
        due = [one for one in self.waiting if one.due_s <= now_s]
        due = sorted(due, key=lambda one: (not one.urgent, one.attempts))[:room]
        for one in due:
            one.due_s, one.attempts = math.inf, one.attempts + 1
        return due

    def tried(self, notice: Notice, failed: bool, again: bool, now_s: float) -> bool:
        """Take the end of an attempt; return whether the notice waits for another one."""
        notice.failed = failed
        if failed and again and now_s - notice.since_s < self.retry.give_up_s:
            notice.due_s = now_s + self.retry.wait_s(notice.attempts)
            return True
        self.waiting.remove(notice)
        return False

    def hurry(self, now_s: float) -> None:
        """Try all that wait now, and shortly after each attempt."""
        self.retry = replace(self.retry, first_s=SOON_S, most_s=SOON_S)
        for one in self.waiting:
            one.due_s = now_s if one.due_s < math.inf else math.inf


def open_stream(place: str, source: Source) -> WebhookStream:
    """Return a stream that posts to an address; the secret is in the file that `SECRET` names.

    Raises:
        InputError: for what is no address, or a secret that others can read or that is too short.
    """
    url = address(place)
    file = os.environ.get(SECRET)
    if not file:
        raise InputError(SECRET, MISSING, "the file with the secret that signs notices")
    secret = read_secret(Path(file), SECRET)
    if len(secret) < LEAST_SECRET:
        raise InputError(SECRET, f"{plural(len(secret), 'character')}", f"{LEAST_SECRET} at least")
    if not source.kinds:
        raise InputError("target", "no [events] in the site file", "[events] with kinds")
    if url.scheme == "http" and not is_loopback(str(url.hostname)):
        source.report(f"webhook {url.netloc}: signed, but anybody on the way can read it")
    return WebhookStream(url, secret.encode(), source)


def address(place: str) -> SplitResult:
    """Return where to post to.

    Raises:
        InputError: for anything but `https://HOST[:PORT]/PATH` or the same with `http`.
    """
    wanted = "webhook:https://HOST/PATH"
    try:
        url = urlsplit(place)
        url.port  # noqa: B018 - raises for one that is no number
    except ValueError:
        raise InputError("target", repr(place[:80]), wanted) from None
    if "@" in url.netloc:
        raise InputError("target", "a user or password in it", wanted)
    plain = place.isascii() and place.isprintable() and " " not in place
    if url.scheme not in ("http", "https") or not url.hostname or not plain:
        raise InputError("target", repr(place[:80]), wanted)
    return url


def signature(secret: bytes, body: bytes, time_s: int) -> str:
    """Return the value of the header `SIGNATURE`."""
    signed = hmac.new(secret, b"%d.%s" % (time_s, body), hashlib.sha256)
    return f"t={time_s},v1={signed.hexdigest()}"


def body_of(event: PersonEvent, source: Source) -> bytes:
    """Return the body of an event's notice, with the name that the person has now."""
    named = f"{source.site}\n{event.kind}\n{event.track}\n{event.start_ns}"
    key = hashlib.sha256(named.encode()).hexdigest()[:32]
    words = {"id": key, "site": source.site, **event_words(event, source.names)}
    return json.dumps(words).encode()


class WebhookStream:
    """See `Stream`, `TellsPeople` and `CanTest`. Each attempt has a thread of its own.

    Attributes:
        delivered, given_up, silent: notices.
    """

    def __init__(
        self, url: SplitResult, secret: bytes, source: Source, retry: RetryPolicy | None = None
    ) -> None:
        """Post to an address."""
        self.delivered = self.given_up = self.silent = 0
        self._url, self._secret, self._source = url, secret, source
        self._notices, self._posts = Notices(retry or RetryPolicy()), 0
        self._secure = ssl.create_default_context() if url.scheme == "https" else None
        self._problem = ""
        self._ends_s = math.inf
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="webhook", daemon=True)
        self._thread.start()

    @property
    def problem(self) -> str:
        """See `stream_problems`: waiting and given-up notices."""
        count = plural(len(self._notices.waiting), "notice")
        waits = f"cannot deliver ({self._problem}), {count} waiting"
        lost = f"{plural(self.given_up, 'notice')} given up"
        parts = [waits] * bool(self._problem) + [lost] * bool(self.given_up)
        return f"webhook {self._url.netloc}: {', '.join(parts)}" if parts else ""

    def slot(self, slot: LiveSlot) -> None:
        """See `Stream.slot`: poses do not leave."""

    def zone(self, event: ZoneEvent) -> None:
        """See `Stream.zone`: zones do not leave."""

    def people(self, watch: Watch, events: Sequence[PersonEvent]) -> None:
        """See `TellsPeople.people`: one notice for each event, when it is told first."""
        told, now = self._source.told, datetime.now()
        for event in events:
            if not event.is_news:
                continue
            if told.is_quiet(now.hour, now.minute) and event.kind not in told.urgent:
                self.silent += 1
                continue
            with self._changed:
                out = self._notices.add(event, event.kind in told.urgent, time.monotonic())
                if out is not None:
                    self._give_up(out, f"{MAX_WAITING} others wait")
                self._changed.notify()

    def test(self) -> str:
        """See `CanTest.test`: posted once, before the waiting ones, also in quiet hours."""
        sentence = f"Test notice of {self._source.site}: nothing happened"
        words = {
            "id": secrets.token_hex(16), "site": self._source.site, "kind": "test",
            "sentence": sentence,
        }  # fmt: skip
        problem, _ = self._post(json.dumps(words).encode())
        how = f"test notice not delivered ({problem})" if problem else "test notice delivered"
        return f"webhook {self._url.netloc}: {how}"

    def close(self) -> None:
        """See `Stream.close`: tries waiting notices for some seconds, then reports their loss."""
        with self._changed:
            self._ends_s = time.monotonic() + END_S
            self._notices.hurry(time.monotonic())
            self._changed.notify()
        self._thread.join(END_S + 1.0)
        with self._changed:
            while self._notices.waiting:
                self._give_up(self._notices.waiting.pop(0), self._problem or "the stream ended")
        counts = [f"{plural(self.delivered, 'notice')} delivered"]
        counts += [f"{self.given_up} not delivered"] * (self.given_up > 0)
        counts += [f"{self.silent} not sent in quiet hours"] * (self.silent > 0)
        self._say(", ".join(counts))

    def _say(self, line: str) -> None:
        self._source.report(f"webhook {self._url.netloc}: {line}")

    def _give_up(self, notice: Notice, why: str) -> None:
        self.given_up += 1
        said = event_words(notice.event)["sentence"]  # lines are kept: without the name
        self._say(f"not delivered ({why}): {said} ({plural(notice.attempts, 'attempt')})")

    def _run(self) -> None:
        """Begin the attempts that are due."""
        with self._changed:
            while self._notices.waiting or self._ends_s == math.inf:
                now_s = time.monotonic()
                if now_s >= self._ends_s:
                    return
                for notice in self._notices.due(now_s, MAX_POSTS - self._posts):
                    self._posts += 1
                    threading.Thread(target=self._try, args=(notice,), daemon=True).start()
                next_s = min((one.due_s for one in self._notices.waiting), default=math.inf)
                rest_s = min(next_s, self._ends_s) - now_s
                self._changed.wait(max(rest_s, 0.01) if rest_s < math.inf else None)

    def _try(self, notice: Notice) -> None:
        """Try a notice once."""
        problem, again = self._post(body_of(notice.event, self._source))
        with self._changed:
            self._posts -= 1
            self._changed.notify()
            if notice not in self._notices.waiting:
                return  # given up meanwhile, for others
            waits = self._notices.tried(notice, bool(problem), again, time.monotonic())
            if waits:
                self._set_problem(problem)
            elif problem:
                self._give_up(notice, problem)
            else:
                self.delivered += 1
                if not any(one.failed for one in self._notices.waiting):
                    self._set_problem("")

    def _set_problem(self, problem: str) -> None:
        """Say once that deliveries fail, and once that they succeed again."""
        before, self._problem = self._problem, problem
        if problem and not before:
            self._say(f"cannot deliver ({problem}): trying again")
        elif before and not problem:
            self._say("delivers again")

    def _post(self, body: bytes) -> tuple[str, bool]:
        """Post once; return the problem, empty without one, and whether to try again.

        Redirects are answers like others: a signed notice goes nowhere else. Of an answer the
        status alone is read.
        """
        url, seconds = self._url, self._notices.retry.answer_s
        host, port = str(url.hostname), url.port
        if self._secure is None:
            connection = http.client.HTTPConnection(host, port, timeout=seconds)
        else:
            connection = http.client.HTTPSConnection(
                host, port, timeout=seconds, context=self._secure
            )
        # A timeout of the socket is one of each read; an answer may come byte by byte.
        watchdog = threading.Timer(seconds, _cut, (connection,))
        watchdog.daemon = True
        watchdog.start()
        try:
            target = f"{url.path or '/'}{'?' * bool(url.query)}{url.query}"
            signed = signature(self._secret, body, int(time.time()))
            headers = {"Content-Type": "application/json", SIGNATURE: signed}
            connection.request("POST", target, body, headers)
            status = connection.getresponse().status
        except (OSError, ValueError, http.client.HTTPException) as error:
            return str(error) or type(error).__name__, True
        finally:
            watchdog.cancel()
            connection.close()
        if 200 <= status < 300:
            return "", False
        return f"status {status}", status >= 500 or status in AGAIN


def _cut(connection: http.client.HTTPConnection) -> None:
    """End a connection that another thread reads from."""
    with suppress(OSError):  # it ended by itself
        if connection.sock is not None:
            connection.sock.shutdown(socket.SHUT_RDWR)
